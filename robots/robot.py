"""Robot: kinematics, inertias, limits, gravity and effects of an arm; immutable."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
import pinocchio as pin

from excitant.exceptions import UnknownName
from excitant.robots.limits import Limits
from excitant.robots.motion import Array, Mask, read_only
from excitant.robots.parameters import STANDARD, BaseEstimate, inertia
from excitant.robots.shown import Shown, Table

if TYPE_CHECKING:
    import pandas as pd

    from excitant.robots.effects import Effect
    from excitant.robots.urdf_shapes import UrdfFormat


@dataclass(frozen=True, eq=False, repr=False)
class Robot(Shown):
    """A serial arm with one degree of freedom per joint.

    Attributes:
        name: Name of the arm.
        model: Pinocchio's model of the moving joints; never edited (``data`` is made per call).
        links: Name of the link that each joint carries, with everything fixed to it.
        revolute: Whether each joint turns (or slides), shape (nv,).
        limits: Limits of the joints.
        description: URDF text the arm was read from, with exact angles; `urdf` is that of the arm
            as it is now.
        format: Format of the description.
        locked: Positions of the joints that are held.
        unchosen: Those of them that are held because others were chosen, in the model's order.
        effects: What makes torque beyond rigid-body inertia, with values.
        source: File or name the arm was loaded from.
        tool: Link of the tool, where one was named.
        notes: Defaults applied while loading it, one sentence each.
    """

    name: str
    model: Any
    links: tuple[str, ...]
    revolute: Mask
    limits: Limits
    description: str
    format: UrdfFormat
    locked: tuple[tuple[str, float], ...]
    unchosen: tuple[str, ...]
    source: str
    tool: str
    notes: tuple[str, ...]
    # folders, beside its own, in which its meshes may lie
    packages: tuple[str, ...]
    effects: tuple[Effect, ...] = ()
    # angles added to the readings of joints [rad]
    zeros: tuple[tuple[str, float], ...] = ()
    described: bool = (
        True  # whether the description states its inertias and friction
    )
    # of its base parameters, where it was identified
    estimate: BaseEstimate | None = None

    @cached_property
    def urdf(self) -> str:
        """URDF text of the arm as it is now: inertias, dry and viscous friction, held joints."""
        return self.format.written(self)

    @property
    def nv(self) -> int:
        """Number of joints."""
        return int(self.model.nv)

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, in order."""
        return tuple(str(name) for name in list(self.model.names)[1:])

    @property
    def gravity(self) -> Array:
        """Gravity in the base frame, shape (3,) [m/s²]."""
        return read_only(self.model.gravity.linear)

    @property
    def phi(self) -> Array:
        """Standard parameters of all links, shape (10 nv,)."""
        bodies = list(self.model.inertias)[1:]
        return read_only([body.toDynamicParameters() for body in bodies]).ravel()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the standard parameters, ``link.m`` to ``link.Izz`` for each link."""
        return tuple(f"{link}.{name}" for link in self.links for name in STANDARD)

    @property
    def tip(self) -> int:
        """Pinocchio's frame of the tool: the link named so, or the last that the last joint has."""
        bodies = {
            k: frame
            for k, frame in enumerate(self.model.frames)
            if frame.type == pin.FrameType.BODY
        }
        named = [k for k, frame in bodies.items() if frame.name == self.tool]
        last = [k for k, f in bodies.items() if f.parentJoint == self.nv]
        return named[0] if named else last[-1]

    def torque_unit(self, measured: str = "N·m", joint: int | None = None) -> str:
        """Unit of torque measured in N·m (or A) at a joint, or at all: slides have N."""
        turns = self.revolute if joint is None else self.revolute[[joint]]
        units = ["N·m"] * bool(turns.any()) + ["N"] * (not turns.all())
        return " or ".join(units) if measured == "N·m" else measured

    def joint_index(self, joint: str) -> int:
        """Position of a joint in the order of this robot; UnknownName if it has none such."""
        UnknownName.refuse("joint", [joint], self.joints)
        return self.joints.index(joint)

    def with_parameters(self, phi: npt.ArrayLike) -> Robot:
        """The same arm with other standard parameters, shape (10 nv,)."""
        model = self.model.copy()
        for j, values in enumerate(np.reshape(phi, (self.nv, 10)), start=1):
            model.inertias[j] = inertia(values)
        return replace(self, model=model, described=False, estimate=None)

    def with_gravity(self, gravity: npt.ArrayLike) -> Robot:
        """The same arm under another gravity vector in the base frame, shape (3,) [m/s²]."""
        model = self.model.copy()
        model.gravity.linear = np.asarray(gravity, float)
        return replace(self, model=model)

    def with_zero(self, joint: str, angle: float) -> Robot:
        """The same arm where a turning joint's true angle is the reading plus an angle [rad]."""
        model = self.model.copy()
        j = self.joint_index(joint) + 1
        turn = model.joints[j].createData()
        model.joints[j].calc(turn, np.full(model.nq, angle))
        model.jointPlacements[j] = model.jointPlacements[j] * turn.M
        zeros = dict(self.zeros)
        zeros[joint] = zeros.get(joint, 0.0) + angle
        return replace(
            self,
            model=model,
            zeros=tuple(zeros.items()),
            described=False,
            estimate=None,
        )

    def with_effects(self, effects: Iterable[Effect]) -> Robot:
        """The same arm with these effects instead of its own."""
        return replace(self, effects=tuple(effects), described=False, estimate=None)

    def with_limits(self, limits: Limits) -> Robot:
        """The same arm with other limits."""
        return replace(self, limits=limits)

    def random_motion(
        self, rng: np.random.Generator | int, n: int
    ) -> tuple[Array, Array, Array]:
        """Random positions, velocities and accelerations inside the limits, each (n, nv).

        A number instead of a generator is the seed of one.
        Unlimited quantities are drawn within one turn, 3 rad/s and 10 rad/s².
        """
        rng = np.random.default_rng(rng)
        limits = self.limits
        low, high = np.clip(limits.position, -2 * np.pi, 2 * np.pi).T
        speed = limits.usual_speed
        acceleration = limits.usual_acceleration
        shape = (n, self.nv)
        q = rng.uniform(low, high, shape)
        dq = rng.uniform(-speed, speed, shape)
        return q, dq, rng.uniform(-acceleration, acceleration, shape)

    def to_frame(self) -> pd.DataFrame:
        """Standard parameters of the links, a row each."""
        import pandas as pd

        rows = self.phi.reshape(-1, 10)
        links = pd.Index(self.links, name="link")
        return pd.DataFrame(rows, links, columns=list(STANDARD))

    def _lines(self) -> list[str]:
        held = [f"{joint} at {q:.4g}" for joint, q in self.locked]
        effects = dict.fromkeys(effect.label for effect in self.effects)
        return [
            f"Robot {self.name}: {self.nv} joints, SI units",
            f"joints: {', '.join(self.joints)}",
            f"moving mass {self.phi[::10].sum():.4g} kg; effects: {', '.join(effects) or 'none'}"
            + f"; held: {', '.join(held)}" * bool(held),
        ]

    def _table(self) -> Table:
        limits = self.limits
        columns = (
            self.joints,
            self.links,
            *limits.position.T.tolist(),
            limits.velocity.tolist(),
            limits.torque.tolist(),
            self.phi[::10].tolist(),
        )
        heads = ("joint", "link", "from", "to", "speed", "torque", "mass [kg]")
        return heads, list(zip(*columns, strict=True))


def own_axes(robot: Robot) -> Array:
    """Axis of each joint in its own frame, shape (nv, 3)."""
    joints = list(robot.model.joints)[1:]
    motions = np.array([np.reshape(joint.createData().S, 6) for joint in joints])
    return np.where(robot.revolute[:, None], motions[:, 3:], motions[:, :3])


def spans(robot: Robot) -> list[float]:
    """Distance of each joint's frame from that of the joint before, nv of them [m]."""
    places = list(robot.model.jointPlacements)[1:]
    return [float(np.linalg.norm(place.translation)) for place in places]
