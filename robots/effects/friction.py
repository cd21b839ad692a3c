"""Friction at the joints, of shafts that turn with two of them, and with a memory."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from excitant.robots.effects import experiments as by
from excitant.robots.effects.base import (
    Effect,
    Export,
    JointEffect,
    JointwiseEffect,
    PairEffect,
    Parameter,
    Physics,
    Size,
    Words,
    registered,
)
from excitant.robots.effects.search import (
    BOUND_STDS,
    JointFacts,
    Search,
    Shape,
    above,
    effect_values,
)
from excitant.robots.motion import Array, Motion
from excitant.robots.regressor import rigid_torque
from excitant.robots.robot import Robot

STRIBECK_SPEED = (
    0.4  # of a joint's highest: beyond it Stribeck friction is Coulomb's
)
PRESLIDING_REACH = 0.1  # of a joint's range: beyond it such friction is a spring
LEAST_PRESLIDING = 0.25  # of dry friction: less is a blurred reversal
REVERSAL_DISTANCES = (
    8.0  # break-away distances from a reversal that show hysteresis
)


class _Friction:
    family = "friction"


class _StandardFriction(_Friction, JointEffect):
    search = Search("standard")


@registered
class ViscousFriction(_StandardFriction):
    """τ = F_v q̇."""

    name = "viscous_friction"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0),)
    export = Export(
        "viscous", dict.fromkeys(("urdf", "mjcf", "sdf", "ros2_control"), "")
    )
    words = Words(
        "velocity",
        {
            "coulomb_friction stribeck_friction": by.LADDER,
            "nonlinear_viscous_friction asymmetric_friction": by.LADDER,
            "thermal_friction_drift": by.WARM,
            "torque_gain": by.CURRENT,
            "load_dependent_friction": by.LOADS,
            "friction_coupling": by.HOLD_OTHER,
            "encoder_scale": by.KINEMATICS,
        },
    )

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (dq,)


@registered
class CoulombFriction(_StandardFriction):
    """τ = F_c sign(q̇), or F_c tanh(q̇ / v), which turns over a range of speeds.

    Source: Andersson, Söderberg, Björklund 2007, for the smooth law.
    """

    name = "coulomb_friction"
    terms = (Parameter("Fc", "N·m", 0.0),)
    physics = Physics("motion", dry=True)
    export = Export(
        "coulomb",
        {
            "urdf": "",
            "mjcf": "frictionloss is a constraint, as stiff as a step of 2 ms allows: it has its "
            "full value, against the motion, once a joint slides, and turns with the velocity "
            "within 2 ms",
            "sdf": "",
            "ros2_control": "",
        },
    )
    words = Words(
        "velocity",
        {
            "stribeck_friction nonlinear_viscous_friction": by.LADDER,
            "asymmetric_friction": by.AT_REST,
            "presliding_hysteresis backlash": by.REVERSALS,
            "load_dependent_friction": by.LOADS,
            "friction_coupling": by.HOLD_OTHER,
            "thermal_friction_drift": by.WARM,
        },
    )

    turning_speed: float = 0.0  # v; 0: friction turns at once [rad/s or m/s]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        v = self.turning_speed
        return (np.tanh(dq / v) if v > 0 else np.sign(dq),)


def _brakes(
    effect: AsymmetricFriction, robot: Robot, values: Array, std: Array
) -> bool:
    """Whether friction, with that of the robot, brakes in both directions."""
    present = effect_values(robot)
    joint = effect.joints[0]
    usual = [present.get(f"{joint}.{symbol}", 0.0) for symbol in ("Fc", "Fv")]
    return above(values + np.repeat(usual, 2)[: len(values)], 0.0, std)


@registered
class AsymmetricFriction(_Friction, JointEffect):
    """τ = F_c± sign(q̇) + F_v± q̇: friction that differs with the direction."""

    name = "asymmetric_friction"
    physics = Physics("motion", dry=True)
    search = Search(
        contains=("torque_offset", "coulomb_friction", "viscous_friction"),
        imitates=("torque_offset",),
        candidates=lambda effect, facts: (replace(effect, viscous=False), effect),
        feasible=_brakes,
    )
    terms = (
        Parameter("Fc_plus", "N·m"),
        Parameter("Fc_minus", "N·m"),
        Parameter("Fv_plus", "N·m·s/rad"),
        Parameter("Fv_minus", "N·m·s/rad"),
    )
    words = Words(
        "velocity",
        {
            "torque_offset": f"{by.AT_REST}, and once with the motor unpowered",
            "stribeck_friction nonlinear_viscous_friction": by.LADDER,
            "load_dependent_friction": by.LOADS,
            "thermal_friction_drift": by.WARM,
            "friction_coupling": by.HOLD_OTHER,
        },
    )

    viscous: bool = True  # whether viscous friction differs too

    @property
    def own_terms(self) -> tuple[Parameter, ...]:
        return self.terms[: 2 + 2 * self.viscous]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        ahead = np.maximum(dq, 0.0)
        back = np.minimum(dq, 0.0)
        return (np.sign(ahead), np.sign(back), ahead, back)[: 2 + 2 * self.viscous]


@registered
class StribeckFriction(_Friction, JointEffect):
    """τ = F_s exp(−|q̇ / v_s|²) sign(q̇), on top of Coulomb friction (Armstrong-Hélouvry 1991)."""

    name = "stribeck_friction"
    physics = Physics("motion", dry=True)
    terms = (Parameter("Fs", "N·m", 0.0),)
    search = Search(
        shapes=(
            Shape(
                "velocity",
                "rad/s",
                grid=lambda facts: (
                    facts.speed * np.geomspace(0.01, STRIBECK_SPEED, 8)
                ),
                most=lambda facts: STRIBECK_SPEED * facts.speed,
            ),
        )
    )
    words = Words(
        "velocity",
        {
            "nonlinear_viscous_friction": by.LADDER,
            "presliding_hysteresis backlash": by.REVERSALS,
            "load_dependent_friction": f"{by.LADDER}, at two payloads",
            "friction_coupling": by.HOLD_OTHER,
            "thermal_friction_drift": by.WARM,
        },
    )

    velocity: float = 0.1  # v_s [rad/s]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.sign(dq) * np.exp(-((dq / self.velocity) ** 2)),)


@registered
class NonlinearViscousFriction(_Friction, JointEffect):
    """τ = F_n |q̇|^a sign(q̇), on top of viscous friction."""

    name = "nonlinear_viscous_friction"
    terms = (Parameter("Fn", "N·m·(s/rad)^a"),)
    search = Search(
        shapes=(
            Shape(
                "exponent", "1", grid=lambda facts: (0.3, 0.5, 0.7, 1.5, 2.0, 3.0)
            ),
        ),
        contains=("viscous_friction",),  # exponent one
    )
    words = Words("velocity")

    exponent: float = 2.0  # a, not one

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.sign(dq) * np.abs(dq) ** self.exponent,)


@registered
class LoadDependentFriction(_Friction, JointwiseEffect):
    """τ = F_l |τ_load| sign(q̇) with the torque of the bodies as load."""

    name = "load_dependent_friction"
    terms = (Parameter("Fl", "1", 0.0),)
    words = Words(
        "load",
        {
            "torque_gain": f"{by.BACKWARDS}, a gain does not; then with a known payload",
            "presliding_hysteresis": f"{by.REVERSALS}, at two payloads",
            "backlash": by.REVERSALS,
            "nonlinear_viscous_friction": f"{by.LADDER}, at two payloads",
            "friction_coupling": by.HOLD_OTHER,
        },
    )

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return (
            np.abs(rigid_torque(robot, motion)[:, j]) * np.sign(motion.dq[:, j]),
        )


def _is_dry(
    effect: PreslidingHysteresis | GradualReversal,
    robot: Robot,
    values: Array,
    std: Array,
) -> bool:
    """Whether it is a good part of the joint's dry friction; less is a blurred reversal."""
    coulomb = effect_values(robot).get(f"{effect.joints[0]}.Fc", 0.0)
    return bool(values[0] + BOUND_STDS * std[0] > LEAST_PRESLIDING * coulomb)


@registered
class PreslidingHysteresis(_Friction, JointwiseEffect):
    """τ = F_h (z − sign q̇): dry friction that builds up over a distance instead of at once.

    z follows Dahl's law dz/dq = (1 − z sign q̇) / δ (Dahl 1968), so that Coulomb friction F_c
    with F_h = F_c is F_c z; its motion must come in the order of time.
    """

    name = "presliding_hysteresis"
    terms = (Parameter("Fh", "N·m", 0.0),)
    physics = Physics("motion")
    search = Search(
        shapes=(
            Shape(
                "distance",
                "rad",
                grid=lambda facts: (
                    facts.reach * np.geomspace(3e-4, PRESLIDING_REACH, 8)
                ),
                most=lambda facts: PRESLIDING_REACH * facts.reach,
                least=lambda facts: facts.blur,
            ),
        ),
        feasible=_is_dry,
    )
    words = Words(
        "reversal",
        {
            "backlash": by.REVERSALS,
        },
        drawn=lambda effect, label, x: (label, _near_reversals(effect, x)),
    )

    distance: float = 0.01  # δ, over which friction builds up [rad]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        return (bristles(motion.q[:, j], self.distance) - np.sign(motion.dq[:, j]),)


def _within(
    effect: GradualReversal,
    robot: Robot,
    joints: Sequence[str],
    sizes: Sequence[Size],
) -> str:
    """Statement on friction that turns over a range of speeds."""
    unit = effect.shape_unit(robot, effect.search.shapes[0])
    spread = f" ± {effect.std:.1g}" if effect.std else ""
    within = f"within {effect.speed:.2g}{spread} {unit}"
    if len(joints) == 1:
        return (
            f"{joints[0]}: dry friction turns over gradually at reversals, {within}"
        )
    several = (
        f"Dry friction of {len(joints)} joints turns over gradually at reversals"
    )
    return f"{several}, that of {joints[0]} {within}"


def _near_reversals(effect: PreslidingHysteresis, x: Array) -> Array:
    """Distances since a reversal, NaN where hysteresis has faded, if some are near."""
    far = np.abs(x) > REVERSAL_DISTANCES * effect.distance
    return np.where(far & (far.mean() < 1), np.nan, x)


@dataclass(frozen=True)
class GradualReversal(_Friction, JointEffect):
    """τ = F_c (tanh(q̇ / v) − sign q̇): what Coulomb friction has less while it turns.

    A cause of errors only: a model that has it holds a `CoulombFriction` of that turning speed.
    """

    name = "gradual_reversal"
    terms = (Parameter("Fc", "N·m", 0.0),)
    physics = Physics("motion", amends=True)
    search = Search(shapes=(Shape("speed", "rad/s"),), feasible=_is_dry)
    words = Words(
        "velocity",
        {
            "presliding_hysteresis backlash": by.REVERSALS,
            "stribeck_friction nonlinear_viscous_friction": by.LADDER,
        },
        sentence=_within,
        noun=lambda effect, robot: f"gradual reversal of {effect.joints[0]}",
    )

    speed: float = 0.1  # v [rad/s]
    std: float = 0.0  # of v; 0: not known [rad/s]

    def of_state(self, q: Array, dq: Array, ddq: Array) -> Sequence[Array]:
        return (np.tanh(dq / self.speed) - np.sign(dq),)

    @property
    def turned(self) -> CoulombFriction:
        """Coulomb friction of the joint that turns so, without values."""
        return CoulombFriction(self.joints, turning_speed=self.speed)


def turned(
    effects: Iterable[Effect], reversals: Iterable[GradualReversal]
) -> list[Effect]:
    """Effects with Coulomb friction that turns over a range of speeds at some joints.

    A joint without it gets it, without a value.
    """
    laws = {reversal.joints: reversal.turned for reversal in reversals}
    found = list[Effect]()
    for effect in effects:
        rubbing = isinstance(effect, CoulombFriction)
        if not rubbing or laws.keys().isdisjoint((j,) for j in effect.joints):
            found.append(effect)
            continue
        for joint in effect.joints:
            own = effect.among((joint,)) or effect
            law = laws.pop((joint,), own)
            found.append(replace(law, values=own.values))
    return [*found, *laws.values()]


def amended(
    effects: Sequence[Effect], amends: Sequence[Effect], hidden: Sequence[Effect]
) -> list[Effect]:
    """Effects of a model with the laws that some causes amend.

    ``hidden`` ones, no causes, hold at joints with Coulomb friction and no finer law of reversals.
    """
    rubbing = {
        j for e in effects if isinstance(e, CoulombFriction) for j in e.joints
    }
    finer = {
        j
        for e in (*effects, *amends)
        if e.physics.amends or e.words.abscissa == "reversal"
        for j in e.joints
    }
    fitting = (e for e in hidden if {*e.joints} <= rubbing - finer)
    laws = (e for e in (*amends, *fitting) if isinstance(e, GradualReversal))
    return turned(effects, laws)


def bristles(q: Array, distance: float) -> Array:
    """Dahl's state z along a motion, from z = 0, shape (n,).

    In each run of one direction z decays towards it: only runs are gone through one by one.
    """
    steps = np.diff(q)
    moves = np.flatnonzero(steps)
    way = np.append(0.0, np.cumsum(np.abs(steps))) / distance
    first = moves[np.flatnonzero(np.diff(np.sign(steps[moves]), prepend=0.0))]
    signs = np.append(0.0, np.sign(steps[first]))
    starts = np.append(0.0, way[first])
    kept = np.exp(-np.diff(starts)).tolist()
    # at the start of each run, the first of which is before any motion
    states = [0.0]
    for sign, keeps in zip(signs[:-1].tolist(), kept, strict=True):
        states.append(sign + (states[-1] - sign) * keeps)
    run = np.append(0, np.searchsorted(first, np.arange(len(steps)), "right"))
    fading = np.exp(starts[run] - way)
    return signs[run] + (np.array(states)[run] - signs[run]) * fading


@registered
class FrictionCoupling(_Friction, PairEffect):
    """Friction of a shaft that turns with both joints, at speed w = q̇_i + ρ q̇_k.

    τ_i = F_v w + F_c sign(w), τ_k = ρ τ_i, as in wrists whose motors sit in the forearm
    (Gautier, Janot, Vandanjon 2013, Stäubli TX40).
    """

    name = "friction_coupling"
    terms = (Parameter("Fv", "N·m·s/rad", 0.0), Parameter("Fc", "N·m", 0.0))
    search = Search(
        shapes=(Shape("ratio", "1", positive=False),),
        candidates=lambda effect, facts: [
            replace(effect, ratio=ratio) for ratio in (1.0, -1.0)
        ],
    )
    words = Words(
        "other velocity",
        {
            "inertia_coupling": by.HOLD_OTHER,
        },
    )

    ratio: float = 1.0  # ρ

    def columns(self, robot: Robot, motion: Motion) -> Array:
        i, k = self.rows(robot)
        speed = motion.dq[:, i] + self.ratio * motion.dq[:, k]
        columns = np.zeros((len(motion), robot.nv, 2))
        columns[:, i] = np.column_stack([speed, np.sign(speed)])
        columns[:, k] = self.ratio * columns[:, i]
        return columns


def _warming(effect: ThermalFrictionDrift, facts: JointFacts) -> list[Effect]:
    """Time constants up to the recording's length; longer ones look like a ramp."""
    times = facts.duration * np.array([0.15, 0.4, 1.0])
    return [replace(effect, time=float(time), start=facts.start) for time in times]


def _gaining(
    effect: ThermalFrictionDrift, robot: Robot, values: Array, std: Array
) -> str:
    """Why a drift is another one: a start from rest, say, whose law is not known."""
    if above(values, 0.0, std):
        return ""
    return "a joint that warms up would gain friction at some speed"


@registered
class ThermalFrictionDrift(_Friction, JointwiseEffect):
    """τ = e^{−(t − t_0)/T} (F_v q̇ + F_c sign q̇): what friction loses while the joint warms up."""

    name = "thermal_friction_drift"
    terms = (Parameter("Fv_cold", "N·m·s/rad"), Parameter("Fc_cold", "N·m"))
    physics = Physics("motion")
    search = Search(
        shapes=(Shape("time", "s", most=lambda facts: facts.duration),),
        contains=("viscous_friction", "coulomb_friction"),
        candidates=_warming,
        doubt=_gaining,
    )
    words = Words("time")

    time: float = 60.0  # T [s]
    start: float = 0.0  # t_0, when the arm was cold [s]

    def at(self, robot: Robot, motion: Motion, j: int) -> Sequence[Array]:
        fading = np.exp(-np.maximum(motion.t - self.start, 0.0) / self.time)
        return fading * motion.dq[:, j], fading * np.sign(motion.dq[:, j])
