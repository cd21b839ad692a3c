"""Inverse dynamics written down: recursive Newton-Euler without loops, numbers put in.

For body i with parent p, all vectors in frames whose z axis is the joint's (Luh, Walker, Paul
1980; parameters about the joint frame, so that torque stays linear in them):

    ω = Rᵀω_p + z q̇,    α = Rᵀα_p + z q̈ + Rᵀω_p × z q̇,    a = Rᵀ(a_p + α_p × r + ω_p × (ω_p × r)),
    f = m a + α × mc + ω × (ω × mc) + Σ R_c f_c,
    n = I α + ω × I ω + mc × a + Σ (R_c n_c + r_c × R_c f_c),    τ = n_z,

with a = −g at the base; a sliding joint adds z q̈ + 2 ω × z q̇ to a, and τ = f_z.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.exceptions import BadInput
from excitant.identify.export.bodies import Body, Tree
from excitant.identify.export.expression import (
    Expression,
    Program,
    Statement,
    call,
    constant,
    lifted,
    variable,
)
from excitant.robots.dh import moved_parameters
from excitant.robots.effects.base import Law
from excitant.robots.motion import Array

Vector = tuple[Expression, Expression, Expression]
_NOUGHT: Vector = (constant(0.0),) * 3
_ROUNDING = 1e-15  # of rotations and metres: what cosines of right angles leave


@dataclass(frozen=True)
class StraightLine:
    """Inverse dynamics as statements.

    Attributes:
        statements: In order; they use ``q1..``, ``dq1..`` and ``ddq1..``.
        tau: Torque of each joint.
    """

    statements: tuple[Statement, ...]
    tau: tuple[Expression, ...]

    @property
    def names(self) -> frozenset[str]:
        """Variables that occur."""
        parts = [*(s.expression for s in self.statements), *self.tau]
        return frozenset[str]().union(*(part.names for part in parts))

    @property
    def functions(self) -> tuple[str, ...]:
        """Functions that occur, sorted."""
        parts = [*(s.expression for s in self.statements), *self.tau]
        return tuple(sorted(frozenset[str]().union(*(part.functions for part in parts))))


@dataclass(frozen=True)
class _Step:
    """From a body to one that hangs on it, in z frames: constant turn, place, cos q and sin q."""

    P: Array
    place: Vector
    cosine: Expression
    sine: Expression

    def into(self, v: Vector) -> Vector:
        """A vector of the parent before the joint's own turn."""
        return _apply(self.P.T, v)

    def turned(self, v: Vector) -> Vector:
        """The same after the joint's own turn."""
        c, s = self.cosine, self.sine
        return (c * v[0] + s * v[1], c * v[1] - s * v[0], v[2])

    def back(self, v: Vector) -> Vector:
        """A vector of the body before the joint's own turn."""
        c, s = self.cosine, self.sine
        return (c * v[0] - s * v[1], s * v[0] + c * v[1], v[2])


def inverse_dynamics(arm: Tree) -> StraightLine:
    """Torque of every joint as straight-line code.

    Raises:
        BadInput: An effect that is not a formula of one joint's own motion.
    """
    program, steps, wrenches = Program(), [], []
    turns = [_turn_to_z(body.axis) for body in arm.bodies]
    motions: list[tuple[Vector, Vector, Vector]] = []
    start = (_NOUGHT, _NOUGHT, _lifted(-arm.gravity))
    for i, body in enumerate(arm.bodies):
        program.heading = f"{body.joint}: motion and load of {body.link}"
        above = turns[body.parent] if body.parent >= 0 else np.eye(3)
        steps.append(_step(program, i, body, above, turns[i]))
        parent = motions[body.parent] if body.parent >= 0 else start
        motions.append(_motion(program, i, body, steps[i], parent))
        pose = np.eye(4)
        pose[:3, :3] = turns[i].T
        wrenches.append(_wrench(program, i, moved_parameters(body.phi, pose), motions[i]))
    tau = [constant(0.0)] * len(arm.bodies)
    for i in reversed(range(len(arm.bodies))):
        body, (f, n) = arm.bodies[i], wrenches[i]
        program.heading = f"{body.joint}: torque"
        tau[i] = program.let(f"tau{i + 1}", (n if body.revolute else f)[2] + _own(arm, i))
        if body.parent >= 0:
            wrenches[body.parent] = _handed_on(program, i, steps[i], f, n, wrenches[body.parent])
    return StraightLine(program.needed(tuple(tau)), tuple(tau))


def _step(program: Program, i: int, body: Body, above: Array, turn: Array) -> _Step:
    P = _clean(above.T @ body.placement[:3, :3] @ turn)
    place = _apply(P.T, _lifted(_clean(above.T @ body.placement[:3, 3])))
    q = variable(f"q{i + 1}")
    if not body.revolute:
        slid = program.let(f"r{i + 1}", place[2] + q)
        return _Step(P, (*place[:2], slid), constant(1.0), constant(0.0))
    c, s = (program.let(f"{name[0]}{i + 1}", call(name, q)) for name in ("cos", "sin"))
    return _Step(P, place, c, s)


def _motion(
    program: Program, i: int, body: Body, step: _Step, parent: tuple[Vector, Vector, Vector]
) -> tuple[Vector, Vector, Vector]:
    """Angular velocity, angular acceleration, and acceleration of the origin less gravity."""
    k, zero = i + 1, constant(0.0)
    speed, acceleration = (zero, zero, variable(f"dq{k}")), (zero, zero, variable(f"ddq{k}"))
    w, dw = (_let(program, f"{name}{k}p", step.into(v))
             for name, v in zip(("w", "b"), parent, strict=False))  # fmt: skip
    around = _let(program, f"v{k}", _cross(w, step.place))
    a = _plus(step.into(parent[2]), _cross(dw, step.place), _cross(w, around))
    a = _let(program, f"a{k}p", a)
    if not body.revolute:
        twice = tuple(2 * x for x in _cross(w, speed))
        return w, dw, _let(program, f"a{k}", _plus(a, acceleration, twice))
    w, dw = _let(program, f"t{k}", step.turned(w)), step.turned(dw)
    return (
        _let(program, f"w{k}", _plus(w, speed)),
        _let(program, f"b{k}", _plus(dw, acceleration, _cross(w, speed))),
        _let(program, f"a{k}", step.turned(a)),
    )


def _wrench(
    program: Program, i: int, phi: Array, motion: tuple[Vector, Vector, Vector]
) -> tuple[Vector, Vector]:
    """Force and moment about the origin that the body itself needs."""
    w, dw, a = motion
    mc, k = _lifted(phi[1:4]), i + 1
    xx, xy, yy, xz, yz, zz = phi[4:]
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    swept = _let(program, f"u{k}", _cross(w, mc))
    spin = _let(program, f"h{k}", _apply(inertia, w))
    mass = tuple(float(phi[0]) * x for x in a)
    f = _plus(mass, _cross(dw, mc), _cross(w, swept))
    n = _plus(_apply(inertia, dw), _cross(w, spin), _cross(mc, a))
    return _let(program, f"f{k}", f), _let(program, f"n{k}", n)


def _handed_on(
    program: Program, i: int, step: _Step, f: Vector, n: Vector, load: tuple[Vector, Vector]
) -> tuple[Vector, Vector]:
    """Load of the parent with what the body hands on to it."""
    k = i + 1
    f, n = step.back(f), step.back(n)
    f = _let(program, f"f{k}p", f)
    n = _let(program, f"n{k}p", _plus(n, _cross(step.place, f)))
    force = _let(program, f"f{k}s", _plus(load[0], _apply(step.P, f)))
    return force, _let(program, f"n{k}s", _plus(load[1], _apply(step.P, n)))


def _own(arm: Tree, i: int) -> Expression:
    """Torque of the joint's own friction, rotor inertia, offset and other effects."""
    body, k = arm.bodies[i], i + 1
    q, dq, ddq = (variable(f"{name}{k}") for name in ("q", "dq", "ddq"))
    total = body.viscous * dq + body.rotor * ddq + body.offset
    if body.coulomb:
        total = total + body.coulomb * call("sign", dq)
    for effect in arm.others:
        if effect.law is None:
            raise BadInput(
                f"effect {effect.name} acts across joints, which Python and C code of excitant "
                "cannot say; leave 'python' and 'c' out of --formats"
            )
        if body.joint in effect.joints:
            row = effect.joints.index(body.joint)
            values = np.reshape(effect.values or (), (len(effect.joints), -1))[row]
            for value, term in zip(
                values, _terms(effect.name, effect.law, q, dq, ddq), strict=True
            ):
                total = total + lifted(term) * float(value)
    return total


def _terms(name: str, law: Law, *motion: Any) -> Sequence[Any]:
    try:
        return law(*motion)
    except (TypeError, ValueError, AttributeError):
        raise BadInput(
            f"effect {name} is no formula that Python and C code of excitant can say; "
            "leave 'python' and 'c' out of --formats"
        ) from None


def _turn_to_z(axis: Array) -> Array:
    """A rotation whose third column is the axis; a permutation where the axis is one of three."""
    k = int(np.argmax(np.abs(axis)))
    first = np.eye(3)[(k + 1) % 3]
    first = first - axis * (axis @ first)
    first /= np.linalg.norm(first)
    return _clean(np.column_stack([first, np.cross(axis, first), axis]))


def _clean(values: Array) -> Array:
    """Numbers with what rounding left of 0, 1 and −1 taken off."""
    whole = np.clip(np.round(values), -1.0, 1.0)
    return np.where(np.abs(values - whole) < _ROUNDING, whole, values)


def _lifted(values: Array) -> Vector:
    x, y, z = (constant(value) for value in values)
    return x, y, z


def _let(program: Program, name: str, v: Any) -> Vector:
    x, y, z = (program.let(name + axis, value) for axis, value in zip("xyz", v, strict=True))
    return x, y, z


def _apply(M: Array, v: Vector) -> Vector:
    x, y, z = (float(row[0]) * v[0] + float(row[1]) * v[1] + float(row[2]) * v[2] for row in M)
    return x, y, z


def _cross(u: Vector, v: Vector) -> Vector:
    return (
        u[1] * v[2] - u[2] * v[1],
        u[2] * v[0] - u[0] * v[2],
        u[0] * v[1] - u[1] * v[0],
    )


def _plus(*vectors: Any) -> Vector:
    x, y, z = (sum(parts, constant(0.0)) for parts in zip(*vectors, strict=True))
    return x, y, z
