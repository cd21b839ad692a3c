"""Rows of a window: filtered columns of the base parameters with the torque, joint by joint."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from excitant.identify.preprocessing import Segment
from excitant.identify.streaming.filtering import Response
from excitant.identify.streaming.windows import Window
from excitant.robots.base_parameters import BaseParameters
from excitant.robots.effects import Effect
from excitant.robots.motion import Array, Motion
from excitant.robots.robot import Robot
from excitant.robots.torque import observation_columns

GIVEN, ONE, TAU, RAW = range(-4, 0)
"""Last columns of a joint's rows: effects of the given robot, ones, torque, unfiltered torque."""

Indices = npt.NDArray[np.intp]
_AT_ONCE = 1000  # instants whose columns of all joints are there at once
_STATES = 200  # random ones: a column that is zero at all of them is zero


@dataclass(frozen=True, eq=False)
class Layout:
    """Which base columns a joint's rows hold: those that its torque contains.

    Attributes:
        robot: The arm.
        smooth: Effects that, as the links, are known from every few instants.
        jumping: All others that are estimated, each with the place of its first column among all.
        effects: Both in the order of the columns.
        base: Base parameters of links and effects, r of them.
        used: Base columns of each joint, as positions among the r, nv arrays of shape (u,).
        source: Position of base columns among those of links and smooth effects; −1 where they
            are of a jumping one, shape (r,).
    """

    robot: Robot
    smooth: tuple[Effect, ...]
    jumping: tuple[tuple[int, Effect], ...]
    effects: tuple[Effect, ...]
    base: BaseParameters
    used: tuple[Indices, ...]
    source: Indices


def layout(robot: Robot, effects: Sequence[Effect], base: BaseParameters) -> Layout:
    """Layout of the rows of an arm with effects."""
    states = robot.random_motion(np.random.default_rng(0), _STATES)
    W = observation_columns(robot, effects, Motion(np.arange(float(_STATES)), *states))
    W = W[:, :, list(base.columns)]
    used = tuple(np.flatnonzero((W[:, j] != 0).any(axis=0)) for j in range(robot.nv))
    smooth: list[Effect] = []
    jumping: list[tuple[int, Effect]] = []
    source = list(range(10 * robot.nv))
    for effect in effects:
        count = len(effect.parameters(robot))
        if effect.link(robot) is not None:
            start = 10 * robot.nv + sum(len(e.parameters(robot)) for e in smooth)
            smooth.append(effect)
            source += range(start, start + count)
        else:
            jumping.append((len(source), effect))
            source += [-1] * count
    places = np.array(source)[list(base.columns)]
    return Layout(robot, tuple(smooth), tuple(jumping), tuple(effects), base, used, places)


def window_rows(layout: Layout, window: Window, filters: Sequence[Response]) -> list[Array]:
    """Rows of every joint: its used base columns and the last four columns, (n, u + 4) each.

    Rows whose filter reaches over the edge of a part of the log are those of `Segment.rows`.

    Args:
        layout: Which columns they hold.
        window: The window.
        filters: Response of each joint's filter, all of one length.
    """
    segment, half = window.segment, filters[0].half
    n = len(segment.motion)
    own = np.arange(n)[segment.keep]
    left = (own < half) & window.first
    right = (own >= n - half) & window.last & ~left
    parts = (
        _at_edge(layout, segment, own[left], slice(0, 2 * half)),
        _inside(layout, segment, own[~left & ~right], filters),
        _at_edge(layout, segment, own[right], slice(max(0, n - 2 * half), n)),
    )
    tau, raw, ones = segment.tau[own], segment.tau_raw[own], np.ones(len(own))
    return [
        np.column_stack([np.concatenate([part[j] for part in parts]), ones, tau[:, j], raw[:, j]])
        for j in range(layout.robot.nv)
    ]


def _none(layout: Layout) -> list[Array]:
    return [np.empty((0, len(used) + 1)) for used in layout.used]


def _at_edge(layout: Layout, segment: Segment, own: Indices, cut: slice) -> list[Array]:
    """Rows by the filter of the segment itself, which knows what to do at its ends."""
    if not len(own):
        return _none(layout)
    part = replace(
        segment,
        motion=segment.motion[cut],
        tau=segment.tau[cut],
        tau_raw=segment.tau_raw[cut],
        silent=None if segment.silent is None else segment.silent[cut],
        keep=slice(int(own[0]) - cut.start, int(own[-1]) - cut.start + 1, segment.keep.step),
    )
    columns = list(layout.base.columns)
    W = part.rows(
        lambda motion: observation_columns(layout.robot, layout.effects, motion)[:, :, columns]
    )
    given = part.rows(lambda motion: _given(layout.robot, motion))
    return [np.column_stack([W[:, j, used], given[:, j]]) for j, used in enumerate(layout.used)]


def _given(robot: Robot, motion: Motion) -> Array:
    """Torque of the given robot's own effects, shape (n, nv) [N·m]."""
    own = [effect.torque(robot, motion) for effect in robot.effects]
    return np.sum(own, axis=0) if own else np.zeros_like(motion.q)


def _inside(
    layout: Layout, segment: Segment, own: Indices, filters: Sequence[Response]
) -> list[Array]:
    """Rows whose filter sees nothing but this window."""
    if not len(own):
        return _none(layout)
    half, every = filters[0].half, filters[0].every
    motion = segment.motion[int(own[0]) - half : int(own[-1]) + half + 1]
    soft = [layout.source[used] >= 0 for used in layout.used]
    smooth, jumping = _smooth_columns(layout, motion[::every]), _jumping_columns(layout, motion)
    joints = np.arange(layout.robot.nv)
    smooth_of = np.repeat(joints, [mask.sum() for mask in soft])
    jumping_of = np.append(np.repeat(joints, [(~mask).sum() for mask in soft]), joints)
    found = [np.empty((len(own), len(used) + 1)) for used in layout.used]
    for each in dict.fromkeys(filters):
        alike = np.array([other is each for other in filters])
        soft_columns, hard_columns = smooth, jumping
        if not alike.all():
            soft_columns, hard_columns = smooth[:, alike[smooth_of]], jumping[:, alike[jumping_of]]
        passed = each.rows(soft_columns, len(own), every)
        jumped = each.rows(hard_columns, len(own))
        ends = [0, 0]
        for i, j in enumerate(np.flatnonzero(alike).tolist()):
            for kind, (values, mask) in enumerate(((passed, soft[j]), (jumped, ~soft[j]))):
                start, ends[kind] = ends[kind], ends[kind] + int(mask.sum())
                found[j][:, :-1][:, mask] = values[:, start : ends[kind]]
            found[j][:, -1] = jumped[:, i - int(alike.sum())]
    if segment.silent is not None:
        for j, rows in enumerate(found):
            rows[segment.silent[own, j]] = 0.0
    return found


def _smooth_columns(layout: Layout, motion: Motion) -> Array:
    """Used base columns of links and smooth effects, joint after joint, shape (n, k)."""
    sources = [layout.source[used] for used in layout.used]
    wanted = [source[source >= 0] for source in sources]
    joints = np.repeat(np.arange(len(wanted)), [len(columns) for columns in wanted])
    columns = np.concatenate(wanted)
    found = np.empty((len(motion), len(columns)))
    for start in range(0, len(motion), _AT_ONCE):
        rows = slice(start, start + _AT_ONCE)
        W = observation_columns(layout.robot, layout.smooth, motion[rows])
        found[rows] = W[:, joints, columns]
    return found


def _jumping_columns(layout: Layout, motion: Motion) -> Array:
    """Used base columns of jumping effects, joint after joint, then the given torque, (n, k)."""
    wanted = [
        (j, int(i)) for j, used in enumerate(layout.used) for i in used if layout.source[i] < 0
    ]
    position = {column: i for i, column in enumerate(layout.base.columns)}
    places = {pair: k for k, pair in enumerate(wanted)}
    found = np.zeros((len(motion), len(wanted) + layout.robot.nv))
    if layout.robot.effects:
        found[:, len(wanted) :] = _given(layout.robot, motion)
    for first, effect in layout.jumping:
        for j, column, values in _channels(layout.robot, effect, motion):
            place = places.get((j, position.get(first + column, -1)))
            if place is not None:
                found[:, place] = values
    return found


def _channels(robot: Robot, effect: Effect, motion: Motion) -> Iterator[tuple[int, int, Array]]:
    """An effect's columns that may differ from zero: joint, number of the column, values (n,)."""
    if effect.law is None:
        columns = effect.columns(robot, motion)
        for j, k in np.ndindex(columns.shape[1:]):
            yield j, k, columns[:, j, k]
        return
    column = 0
    for j in effect.rows(robot):
        for values in effect.law(motion.q[:, j], motion.dq[:, j], motion.ddq[:, j]):
            yield j, column, values
            column += 1
