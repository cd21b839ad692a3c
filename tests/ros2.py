"""A stand-in of ROS 2 for one client: messages as strict as its own, and an arm that follows goals.

Names and types of fields come from rosbags, those of control_msgs from its published definitions.
The controller takes quintic splines between points, as joint_trajectory_controller does; time is
what its node has spun.
"""

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.interpolate import BPoly

STATE = "float64 position\nfloat64 velocity\nfloat64 acceleration\n"
CONTROL = {
    "msg/JointTolerance": f"string name\n{STATE}",
    "msg/JointComponentTolerance": f"uint16 X_AXIS=1\nstring joint_name\nuint16 component\n{STATE}",
    "action/Goal": """trajectory_msgs/JointTrajectory trajectory
        trajectory_msgs/MultiDOFJointTrajectory multi_dof_trajectory
        control_msgs/JointTolerance[] path_tolerance
        control_msgs/JointComponentTolerance[] component_path_tolerance
        control_msgs/JointTolerance[] goal_tolerance
        control_msgs/JointComponentTolerance[] component_goal_tolerance
        builtin_interfaces/Duration goal_time_tolerance""",
    "action/Result": """int32 error_code\nint32 SUCCESSFUL=0\nint32 PATH_TOLERANCE_VIOLATED=-4
        string error_string""",
}
DEFINED = dict(get_typestore(Stores.ROS2_HUMBLE).fielddefs)
for _name, _text in CONTROL.items():
    DEFINED |= get_types_from_msg(_text.replace(" " * 8, ""), f"control_msgs/{_name}")
RANGES = {"int32": (-(2**31), 2**31), "uint32": (0, 2**32), "uint16": (0, 2**16)}
LATE = 0.05  # s between states


def require(kind: Any, value: Any, where: str) -> None:
    """Assert what the setters of generated messages assert."""
    node, detail = kind[0].name, kind[1]
    if node == "NAME":
        assert type(value) is made(detail), f"{where}: {value!r} is no {detail}"
    elif node == "SEQUENCE":
        assert isinstance(value, list | tuple), f"{where}: {value!r}"
        for each in value:
            require(detail[0], each, where)
    elif detail[0] == "float64":
        assert isinstance(value, float), f"{where}: {value!r} is no float"
    elif detail[0] == "string":
        assert isinstance(value, str), f"{where}: {value!r} is no text"
    else:
        low, high = RANGES[detail[0]]
        assert type(value) is int, f"{where}: {value!r} is no integer"
        assert low <= value < high, f"{where}: {value}"


def empty(kind: Any) -> Any:
    node, detail = kind[0].name, kind[1]
    if node == "NAME":
        return made(detail)()
    return [] if node == "SEQUENCE" else {"float64": 0.0, "string": ""}.get(detail[0], 0)


CLASSES: dict[str, type] = {}


def made(name: str) -> type:
    """The class of a message; a field that it does not have is refused."""
    if name not in CLASSES:
        constants, fields = DEFINED[name]
        kinds = dict(fields)

        def begin(self: Any, **values: Any) -> None:
            assert values.keys() <= kinds.keys(), f"{name} has no {values.keys() - kinds.keys()}"
            for key, kind in kinds.items():
                setattr(self, key, values[key] if key in values else empty(kind))

        def keep(self: Any, key: str, value: Any) -> None:
            require(kinds[key], value, f"{name}.{key}")
            object.__setattr__(self, key, value)

        held = {"__init__": begin, "__setattr__": keep}
        CLASSES[name] = type(name, (), held | {key: value for key, _, value in constants})
    return CLASSES[name]


class Future:
    def __init__(self, value: Any, ready: Callable[[], bool] = lambda: True) -> None:
        self.value, self.done = value, ready

    def result(self) -> Any:
        assert self.done(), "asked for before it was there"
        return self.value


@dataclass
class Arm:
    """An arm at a pose, its controller, and what came of the goals."""

    joints: tuple[str, ...]
    q: np.ndarray
    now: float = 0.0
    here: bool = True  # whether its controller is
    accepts: bool = True
    error: int = 0  # with which a goal ends
    interrupt: float = np.inf  # s at which Ctrl-C is pressed
    goals: list[Any] = field(default_factory=list)
    sent: list[float] = field(default_factory=list)  # s
    trace: list[tuple[float, np.ndarray]] = field(default_factory=list)
    cancelled: bool = False
    closed: bool = False
    path: Any = None
    end: float = 0.0
    listener: Any = None

    def spin(self, node: Any, timeout_sec: float) -> None:
        """Let some time pass; the arm moves, and says where it is, in an order of its own."""
        if self.now >= self.interrupt:
            self.interrupt = np.inf
            raise KeyboardInterrupt
        self.now += min(timeout_sec, LATE)
        speed = np.zeros(len(self.q))
        if self.path is not None:
            at = min(self.now, self.end) - self.sent[-1]
            self.q, speed = self.path(at), self.path(at, 1)
            self.trace.append((self.now, self.q))
            if self.now >= self.end:
                self.path, speed = None, 0 * speed
        order = range(len(self.joints))[::-1]
        names = ["finger", *(self.joints[j] for j in order)]
        state = {"position": [0.0, *self.q[order].tolist()], "velocity": [0.0, *speed[order]]}
        self.listener(made("sensor_msgs/msg/JointState")(name=names, **plain(state)))

    def take(self, goal: Any) -> Future:
        assert type(goal) is made("control_msgs/action/Goal")
        points = goal.trajectory.points
        times = [p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points]
        assert np.all(np.diff(times) > 0)
        assert tuple(goal.trajectory.joint_names) == self.joints
        rest = np.abs(points[-1].velocities).max() <= np.finfo("f4").eps
        assert rest, "JTC wants rest at its end"
        self.goals.append(goal)
        self.sent.append(self.now)
        if self.accepts:
            rest = [self.q, 0 * self.q, 0 * self.q]
            knots = [[p.positions, p.velocities, p.accelerations] for p in points]
            self.path = BPoly.from_derivatives([0.0, *times], np.array([rest, *knots]))
            self.end = self.now + times[-1]
        handle = SimpleNamespace(accepted=self.accepts)
        result = made("control_msgs/action/Result")(error_code=self.error, error_string="why")
        ended = Future(SimpleNamespace(result=result), lambda: self.path is None)
        handle.get_result_async = lambda: ended
        handle.cancel_goal_async = self.cancel
        return Future(handle)

    def cancel(self) -> Future:
        self.cancelled, self.path = True, None
        return Future(None)


def plain(values: dict[str, Sequence[Any]]) -> dict[str, list[float]]:
    return {key: [float(x) for x in each] for key, each in values.items()}


def install(arm: Arm, patch: pytest.MonkeyPatch) -> None:
    """Modules that a client imports, for as long as a test runs."""

    def subscribe(kind: type, topic: str, heard: Any, qos: Any) -> None:
        assert (kind, topic, qos) == (made("sensor_msgs/msg/JointState"), "/joint_states", "best")
        arm.listener = heard

    def client(node: Any, kind: Any, name: str) -> Any:
        assert kind is modules["control_msgs.action"].FollowJointTrajectory
        assert name == "/joint_trajectory_controller/follow_joint_trajectory"
        return SimpleNamespace(
            send_goal_async=arm.take, wait_for_server=lambda timeout_sec: arm.here
        )

    def init(*, signal_handler_options: object) -> None:
        assert signal_handler_options == "none"

    def close() -> None:
        arm.closed = True

    node = SimpleNamespace(create_subscription=subscribe, destroy_node=lambda: None)
    parts = {name: made(f"control_msgs/action/{name}") for name in ("Goal", "Result")}
    action = SimpleNamespace(**parts)
    modules: dict[str, Any] = {
        "rclpy": {
            "init": init, "create_node": lambda name: node,
            "shutdown": close, "spin_once": arm.spin,
        },
        "rclpy.action": {"ActionClient": client},
        "rclpy.qos": {"qos_profile_sensor_data": "best"},
        "rclpy.signals": {"SignalHandlerOptions": SimpleNamespace(NO="none")},
        "control_msgs.action": {"FollowJointTrajectory": action},
    }  # fmt: skip
    for name in ("control_msgs", "trajectory_msgs", "sensor_msgs", "builtin_interfaces"):
        kinds = [each.split("/")[-1] for each in DEFINED if each.startswith(f"{name}/msg/")]
        modules[f"{name}.msg"] = {kind: made(f"{name}/msg/{kind}") for kind in kinds}
    for name, content in modules.items():
        modules[name] = module = ModuleType(name)
        vars(module).update(content)
        patch.setitem(sys.modules, name.partition(".")[0], ModuleType(name.partition(".")[0]))
        patch.setitem(sys.modules, name, module)
    patch.setitem(sys.modules, "rclpy", modules["rclpy"])
