#!/usr/bin/env python3
"""Runs motions designed by excitant on an arm under ros2_control, slowly unless told otherwise.

    python3 ros2_client.py                say what would be sent, and send nothing
    python3 ros2_client.py --go           run at a fifth of the speed
    python3 ros2_client.py --go --scale 1 run as designed, after that went well

Each motion is a goal of the action FollowJointTrajectory. It begins a second after it was sent,
and is sent only if the arm stands still where it begins; Ctrl-C cancels it. Record meanwhile:

    ros2 bag record --storage mcap /joint_states

Needs ROS 2 Humble or newer (rclpy, control_msgs, trajectory_msgs, sensor_msgs), nothing else.
"""

import argparse
import sys
import time
from typing import Any

JOINTS: list[str] = []
# rows t [s], positions, velocities, accelerations; the designer writes both lines
MOTIONS: dict[str, list[list[float]]] = {}

LEAD = 1.0  # s from where the arm stands to where a motion begins
START = 0.02  # rad or m off where a motion begins: farther away it is not sent
STILL = 0.05  # rad/s or m/s: slower joints rest
PATIENCE = 10.0  # s for a controller or joint states to appear


class Refused(Exception):
    """What keeps a motion from being sent or finished, in one line."""


def goal(rows: list[list[float]], scale: float, tolerance: float) -> Any:
    """A goal: the rows at a share of their speed, within a tolerance [rad or m]."""
    from builtin_interfaces.msg import Duration
    from control_msgs.action import FollowJointTrajectory
    from control_msgs.msg import JointTolerance
    from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

    n = len(JOINTS)
    points = []
    for t, *values in rows:
        sec, nanosec = divmod(round(1e9 * (LEAD + (t - rows[0][0]) / scale)), 10**9)
        points.append(
            JointTrajectoryPoint(
                positions=values[:n],
                velocities=[scale * v for v in values[n : 2 * n]],
                accelerations=[scale**2 * a for a in values[2 * n :]],
                time_from_start=Duration(sec=sec, nanosec=nanosec),
            )
        )
    allowed = [JointTolerance(name=joint, position=tolerance) for joint in JOINTS]
    return FollowJointTrajectory.Goal(
        trajectory=JointTrajectory(joint_names=JOINTS, points=points),
        path_tolerance=allowed,
        goal_tolerance=allowed,
        goal_time_tolerance=Duration(sec=2, nanosec=0),
    )


class Client:
    """A node that knows where the arm stands and sends motions to its controller."""

    def __init__(self, node: Any, controller: str, states: str) -> None:
        from control_msgs.action import FollowJointTrajectory
        from rclpy.action import ActionClient
        from rclpy.qos import qos_profile_sensor_data
        from sensor_msgs.msg import JointState

        self.node = node
        self.state: Any = None
        self.name = f"{controller.rstrip('/')}/follow_joint_trajectory"
        self.action = ActionClient(node, FollowJointTrajectory, self.name)
        self.states = states
        node.create_subscription(
            JointState, states, self.heard, qos_profile_sensor_data
        )

    def heard(self, message: Any) -> None:
        """Keep a message that holds all joints; others on the topic are of other parts."""
        if set(JOINTS) <= set(message.name):
            self.state = message

    def rests(self) -> bool:
        """Whether no joint moves, as far as the last state says; some have no velocities."""
        speeds = dict(zip(self.state.name, self.state.velocity, strict=False))
        return all(abs(speeds.get(joint, 0.0)) <= STILL for joint in JOINTS)

    def wait(self, done: Any, patience: float, missing: str) -> None:
        """Spin until something is done; in short turns, so that Ctrl-C is heard."""
        import rclpy

        end = time.monotonic() + patience
        while not done():
            if time.monotonic() > end:
                raise Refused(missing)
            rclpy.spin_once(self.node, timeout_sec=0.05)

    def require_start(self, name: str, row: list[float]) -> None:
        """Refuse unless the arm rests where a motion begins, by a state that comes from now on."""
        self.state = None
        missing = (
            f"no message on {self.states} within {PATIENCE:g} s that holds {JOINTS}"
        )
        self.wait(lambda: self.state is not None, PATIENCE, missing)
        self.wait(
            self.rests, PATIENCE, f"the arm still moves; {name} begins at rest"
        )
        stands = dict(zip(self.state.name, self.state.position, strict=False))
        for joint, wanted in zip(JOINTS, row[1:], strict=False):
            if not abs(stands[joint] - wanted) <= START:
                raise Refused(
                    f"{name} begins with {joint} at {wanted:.4f}, which stands at "
                    f"{stands[joint]:.4f}; move the arm there first"
                )

    def run(self, name: str, scale: float, tolerance: float) -> None:
        """Send a motion and wait for its end; cancel it on Ctrl-C."""
        rows = MOTIONS[name]
        self.require_start(name, rows[0])
        sent = self.action.send_goal_async(goal(rows, scale, tolerance))
        self.wait(sent.done, PATIENCE, f"{self.name} does not answer")
        handle = sent.result()
        if not handle.accepted:
            raise Refused(f"{self.name} does not accept {name}; its log says why")
        result = handle.get_result_async()
        lasts = LEAD + (rows[-1][0] - rows[0][0]) / scale
        try:
            self.wait(
                result.done,
                2 * lasts + PATIENCE,
                f"{name} does not come to its end",
            )
        except (KeyboardInterrupt, Refused):
            cancelled = handle.cancel_goal_async()
            self.wait(
                cancelled.done,
                PATIENCE,
                f"{name} cannot be cancelled; stop the arm by hand",
            )
            raise
        outcome = result.result().result
        if outcome.error_code != outcome.SUCCESSFUL:
            raise Refused(
                f"{name} ended with error {outcome.error_code}: {outcome.error_string}"
            )
        print(f"{name}: done", flush=True)


def share(text: str) -> float:
    """A share of the speed, above 0 and up to 1."""
    value = float(text)
    if not 0 < value <= 1:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and up to 1")
    return value


def main() -> int:
    """Say what would be sent, or send it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--go", action="store_true", help="move the arm")
    parser.add_argument(
        "--scale", type=share, default=0.2, help="share of the speed (0.2)"
    )
    parser.add_argument(
        "--motions", nargs="+", choices=MOTIONS, default=list(MOTIONS)
    )
    parser.add_argument("--controller", default="/joint_trajectory_controller")
    parser.add_argument(
        "--states", default="/joint_states", help="topic of JointState messages"
    )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=0.1,
        help="how far the arm may lag [rad or m] (0.1)",
    )
    given = parser.parse_args()
    for name in given.motions:
        rows = MOTIONS[name]
        duration = (rows[-1][0] - rows[0][0]) / given.scale
        print(
            f"{name}: {len(rows)} points, {duration:.1f} s at {given.scale:g} of the speed"
        )
    if not given.go:
        print("nothing was sent; with --go it will be")
        return 0
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    # rclpy's own handler would close the connection before a motion is cancelled
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    node = rclpy.create_node("excitant_client")
    try:
        client = Client(node, given.controller, given.states)
        if not client.action.wait_for_server(timeout_sec=PATIENCE):
            raise Refused(f"no action server {client.name}; see: ros2 action list")
        for name in given.motions:
            client.run(name, given.scale, given.tolerance)
    except Refused as why:
        print(f"stopped: {why}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(
            "stopped: interrupted; what was running is cancelled", file=sys.stderr
        )
        return 130
    finally:
        node.destroy_node()
        rclpy.shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
