"""The player of a motion: the arm in 3D with its limits and what comes close to it."""

from base64 import b64encode
from collections.abc import Sequence
from typing import Any

import msgspec
import numpy as np
import numpy.typing as npt

from excitant.reports import page as p
from excitant.reports import values as v
from excitant.reports.figure import AMBER, FITTED, GIVEN, GREEN, PURPLE, Key
from excitant.reports.page import Moment, Player
from excitant.reports.values import Series
from excitant.results import Appearance, Motion, Robots
from excitant.robots.limits import LIMIT_NAMES, TOUCHED

FULL = 1 + 1e-9  # share of a limit that holds, up to rounding
_QUANTITIES = LIMIT_NAMES[:4]
_SHARE = 1e-4  # step in which shares are written
_CAPTION = (
    "The arm as it moves, with the path of its tool; at the base the axes of its frame, x red, "
    "y green, z blue. Drag or use the arrow keys with Shift to turn it, the arrow keys to move it, "
    "and the wheel, once it was clicked, to come closer."
)
_KINDS = {"t": "<f8", "shares": "<u2", "pair": "<u2"}  # of frames; others are <f4
_USED = "The table has the share of each limit that is used at this instant."
_ONE_BY_ONE = (
    "Each joint in turn moves to one side and back, from zero or as near to it as its range "
    "allows: compare the arm, and the way each joint goes, with the maker's drawing."
)


def player(result: Motion, series: Series) -> Player | None:
    """The motion to play; None of results that have none."""
    look = result.appearance
    frames = _frames(series, len(result.joints))
    if frames is None:
        return None
    legend = [
        Key("box", AMBER, f"joint at {v.percent(TOUCHED)} of a limit or more"),
        Key("box", GIVEN, "limit exceeded"),
        *[Key("line", GREEN, "shortest distance of two bodies")]
        * ("distance" in frames),
        Key("line", FITTED, "path of the tool"),
        *[Key("box", PURPLE, "obstacle, workspace")]
        * any(obstacle.name != "floor" for obstacle in result.obstacles),
    ]
    return Player(
        data=_drawn(look, frames, series)
        | {
            "bodies": result.bodies,
            "obstacles": msgspec.to_builtins(result.obstacles),
            "touched": TOUCHED / _SHARE,
            "share": _SHARE,
        },
        joints=_units(result.joints, look),
        quantities=_QUANTITIES,
        moments=moments(result),
        caption=" ".join([_CAPTION, _USED, *map(v.sentence, look.notes)]),
        legend=legend,
    )


def arm_player(result: Robots, series: Series) -> Player | None:
    """An arm whose joints move one after the other; None without frames."""
    names = [joint.name for joint in result.joints]
    look = result.appearance
    frames = _whole(series, {"t": (), "q": (len(names),), "dq": (len(names),)})
    if not frames:
        return None
    return Player(
        data=_drawn(look, frames, series) | {"obstacles": []},
        joints=_units(names, look),
        quantities=(),
        moments=(),
        caption=" ".join([_ONE_BY_ONE, _CAPTION, *map(v.sentence, look.notes)]),
        legend=[Key("line", FITTED, "path of the tool")],
    )


def _units(joints: Sequence[str], look: Appearance) -> list[tuple[str, str]]:
    """Each joint with the unit of its position."""
    units = ["m" if joint.slides else "rad" for joint in look.joints]
    return list(zip(joints, units, strict=True))


def _drawn(
    look: Appearance, frames: dict[str, npt.NDArray[Any]], series: Series
) -> dict[str, Any]:
    """An arm and its frames as the script reads them."""
    shapes = [
        msgspec.to_builtins(shape) | _mesh(series, k)
        for k, shape in enumerate(look.shapes)
    ]
    return {
        "joints": msgspec.to_builtins(look.joints),
        "tool": msgspec.to_builtins(look.tool),
        "shapes": shapes,
        "frames": {
            name: _packed(values.astype(_KINDS.get(name, "<f4")))
            for name, values in frames.items()
        },
    }


def moments(result: Motion) -> list[Moment]:
    """The instants at which limits are touched, and that of the least distance, in their order."""
    instants = []
    for quantity, rows in (result.certified or {}).items():
        for joint, row in zip(result.joints, rows, strict=True):
            if row is not None and row.ratio >= TOUCHED:
                words = (
                    f"{joint}: {v.percent(row.ratio, 4)} of its {quantity} limit"
                )
                tone = p.FAIR if row.ratio <= FULL else p.POOR
                instants.append(Moment(row.t, words, tone))
    if (closest := result.closest) is not None:
        bodies = " and ".join(closest.bodies)
        size = v.quantity(1e3 * abs(closest.distance_m), "mm")
        words = f"{bodies} are nearest, {size} apart"
        tone = p.PLAIN
        if closest.distance_m < 0:
            words = f"{bodies} overlap by {size}"
            tone = p.POOR
        instants.append(Moment(closest.t, words, tone))
    return sorted(instants, key=lambda moment: moment.t)


def _frames(series: Series, nv: int) -> dict[str, npt.NDArray[Any]] | None:
    """Arrays of the frames, shares in steps; None unless they are whole."""
    joints = {"q": (nv,), "dq": (nv,), "shares": (len(_QUANTITIES), nv)}
    frames = _whole(series, {"t": (), **joints})
    if not frames or len(frames["t"]) < 2:
        return None
    shares = np.round(frames["shares"] / _SHARE)
    # exceeded by less than a step
    shares += (frames["shares"] > FULL) & (shares * _SHARE <= 1)
    frames["shares"] = np.minimum(shares, 65535)
    frames |= _whole(series, {"pair": (), "distance": (), "points": (2, 3)})
    return frames


def _whole(
    series: Series, shapes: dict[str, tuple[int, ...]]
) -> dict[str, npt.NDArray[Any]]:
    """Arrays of all frames by name; none of them unless all are there and finite."""
    n = len(np.atleast_1d(series.get("play_t", ())))
    arrays = {}
    for name, shape in shapes.items():
        x = v.array(series, f"play_{name}", n, *shape)
        if x is None or not np.isfinite(x).all():
            return {}
        arrays[name] = x
    return arrays


def _mesh(series: Series, k: int) -> dict[str, Any]:
    points = v.array(series, f"mesh{k}_points", None, 3)
    faces = v.array(series, f"mesh{k}_faces", None, 3)
    if points is None or faces is None:
        return {}
    return {
        "points": _packed(points.astype("<f4")),
        "faces": _packed(faces.astype("<u4")),
    }


def _packed(values: npt.NDArray[Any]) -> dict[str, str]:
    """A little-endian array as the script reads it: kind (``f4``, ``u2``, ...) and bytes."""
    kind = values.dtype.str[1:]
    return {"kind": kind, "bytes": b64encode(values.tobytes()).decode()}
