"""Verdicts as lines of text."""

from __future__ import annotations

from collections.abc import Sequence

from noise import DRAWS, ParameterError
from verdict import NOISE, Verdict

_KINDS = {"equal": "{:g} N·m on every joint", "limit": "{:.0%} of each joint's torque limit"}
_OURS = "excitant"
_ALL_OURS = (_OURS, "a-optimal", "spline")


def reference(row: Verdict, verdicts: Sequence[Verdict]) -> Verdict | None:
    """Our row that a row is compared with, if there is one.

    That of as many harmonics; for a motion that is no Fourier series, the best of all ours that
    accelerate no harder, or else the one that accelerates least.
    """
    if row.method != "figaroh":
        same = (v for v in verdicts if v.method == _OURS and v.setting == row.setting)
        return next((v for v in same if v.samples), None)
    ours = [v for v in verdicts if v.method in _ALL_OURS and v.samples]
    gentle = [v for v in ours if v.peak_ddq <= row.peak_ddq]
    if gentle:
        return min(gentle, key=lambda v: v.left)
    return min(ours, key=lambda v: v.peak_ddq, default=None)


def conditioning_table(verdicts: Sequence[Verdict]) -> list[str]:
    """κ, use of the limits and time of every run, and its ratios to ours."""
    lines = [
        f"{'':20}{'κ left':>9}{'κ proj':>9}{'worst limit':>13}{'rest':>6}{'ddq':>7}"
        f"{'wall s':>8}{'CPU s':>8}   other : excitant (κ, wall, CPU)",
    ]
    for row in verdicts:
        times = f"{row.wall_s:8.1f}{row.cpu_s:8.1f}"
        if not row.samples:
            lines.append(f"{row.label:20}{'no motion':>44}{times}   {row.note}")
            continue
        lines.append(
            f"{row.label:20}{row.left:9.2f}{row.proj:9.2f}{row.worst:13.4f}"
            f"{'yes' if row.at_rest else 'no':>6}{row.peak_ddq:7.1f}{times}"
            f"{_against(row, reference(row, verdicts))}   {row.note}; closest: {row.worst_where}"
        )
    return lines


def _against(row: Verdict, ours: Verdict | None) -> str:
    if ours is None or row.method == _OURS:
        return " " * 33
    ratios = (row.left / ours.left, row.wall_s / ours.wall_s, row.cpu_s / ours.cpu_s)
    return "".join(f"{ratio:6.2f}" for ratio in ratios) + f" {ours.label:<14}"


def noise_table(verdicts: Sequence[Verdict]) -> list[str]:
    """Parameter errors of every run with a motion, and the ratio of ours to them."""
    lines = [
        f"Base parameters fitted to {DRAWS} draws of torque noise: rms error scaled to torque, rms "
        "error of torque on random states [N·m], std of the worst direction [SI]"
    ]
    for kind, size in NOISE:
        name = _KINDS[kind].format(size)
        lines.append(f"{'noise ' + name:50}   excitant : other")
        for row in verdicts:
            if row.errors:
                lines.append(_noise_line(row, reference(row, verdicts), kind))
    return lines


def _noise_line(row: Verdict, ours: Verdict | None, kind: str) -> str:
    figures = _figures(row, kind)
    line = f"{row.label:20}" + "".join(f"{figure:10.4g}" for figure in figures)
    if ours is None or row.method == _OURS:
        return line
    pairs = zip(_figures(ours, kind), figures, strict=True)
    return line + "   " + "".join(f"{a / b:7.2f}" for a, b in pairs) + f" {ours.label}"


def _figures(row: Verdict, kind: str) -> tuple[float, float, float]:
    error: ParameterError = (row.errors or {})[kind]
    return error.scaled, error.predicted, error.worst
