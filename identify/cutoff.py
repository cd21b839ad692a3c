"""Cut-off of each joint's rows, chosen from the training data; the default where nothing is gained.

Two opinions, both on training data alone and judged at one common cut-off:

* Cross-validation between blocks of time, for all joints alike: it sees everything a cut-off does,
  bias too, but only differences larger than the noise of the blocks left out.
* Spectra (`excitant.identify.cutoff_spectra`), joint by joint: what a filter does to the
  uncertainty of the predicted torque, given the noise at each frequency. Cross-validation may veto.

Where the motion's harmonics are known (`excitant.identify.cutoff_harmonics`), no cut-off that would
take their torque away is tried. Another cut-off is taken only where it is better by more than
chance allows, with all that were tried accounted for; among those no worse than one standard error,
the one nearest the default. Rows at which noise decides the sign of a velocity are left out by the
same test.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.stats

from excitant.identify.cutoff_harmonics import Harmonics
from excitant.identify.cutoff_rows import Bank, squared_errors, weighted_fit
from excitant.identify.cutoff_spectra import ColumnSpectra, column_spectra
from excitant.identify.preprocessing import Tuning
from excitant.robots.motion import Array, freeze

_STEPS = 5  # cut-offs tried: the default, and half an octave lower each
LOWEST = 2.0 ** (-(_STEPS - 1) / 2)  # of the default
_CHANCE = 0.05  # that anything at all is taken up where nothing is better
_FEWEST = 4  # blocks, below which differences have no known uncertainty


@dataclass(frozen=True, eq=False)
class CutoffChoice:
    """How rows are to be fitted, and why.

    Attributes:
        cutoffs_hz: Cut-off of each joint's rows, shape (nv,) [Hz].
        reasons: Why, one sentence per joint.
        explained_hz: Frequency up to which the model explains more of each joint's torque than it
            leaves, shape (nv,) [Hz].
        noise_hz: Where the power of each joint's noise is densest, shape (nv,) [Hz].
        slowest: Speed below which the sign of each velocity is not known, shape (nv,) [rad/s].
        left_out: Share of each joint's rows that lies below it, shape (nv,).
        dead_zone: Whether those rows are left out of the fit.
        notes: What the user should know, as sentences.
        harmonics: Those of the motion where they are known.
    """

    cutoffs_hz: Array
    reasons: tuple[str, ...]
    explained_hz: Array
    noise_hz: Array
    slowest: Array
    left_out: Array
    dead_zone: bool
    notes: tuple[str, ...]
    harmonics: Harmonics | None = None

    def __post_init__(self) -> None:
        freeze(self, "cutoffs_hz", "explained_hz", "noise_hz", "slowest", "left_out")

    def tuning(self, default_hz: float) -> Tuning | None:
        """What is to be done other than by default; None for nothing."""
        if not self.dead_zone and bool((self.cutoffs_hz == default_hz).all()):
            return None
        none = np.full_like(self.slowest, -1.0)
        return Tuning(self.cutoffs_hz, self.slowest if self.dead_zone else none)


def choose_cutoffs(
    rows: Bank,
    joints: tuple[str, ...],
    slowest: Array,
    *,
    kept: str = "",
    harmonics: Harmonics | None = None,
) -> CutoffChoice:
    """Cut-offs and dead zone for the rows of a fit.

    Args:
        rows: Training data, with cut-offs from `LOWEST` times the default.
        joints: Names of the joints.
        slowest: Speed below which a velocity's sign is noise, shape (nv,) [rad/s].
        kept: Why the default cut-off is kept, if it is; only the dead zone is chosen then.
        harmonics: Those of the motion where they are known; what they need is not filtered away.
    """
    spectra, hz = column_spectra(rows), np.full(rows.nv, rows.judge_hz)
    least = np.zeros(rows.nv) if harmonics is None else harmonics.torque_hz
    common, own = kept, dict[int, str]()
    if not kept:
        grid = rows.judge_hz * 2.0 ** (-np.arange(_STEPS) / 2)
        hz, common = _common(rows, grid, least)
        hz, own = _per_joint(rows, spectra, grid, hz, least)
    dead, said = _dead_zone(rows, hz)
    peaks = np.array([spectra.peak_hz(j) for j in range(rows.nv)])
    explained = np.array([spectra.explained_hz(j) for j in range(rows.nv)])
    reasons = tuple(
        own.get(j) or common or "default: no lower one predicts better beyond chance"
        for j in range(rows.nv)
    )
    left_out = np.array([rows.left_out(j, float(hz[j])) for j in range(rows.nv)])
    return CutoffChoice(
        hz, reasons, explained, peaks, slowest, left_out, dead,
        (*(() if kept else _notes(joints, hz, rows.judge_hz, reasons, harmonics)), *said),
        harmonics,
    )  # fmt: skip


def block_errors(rows: Bank, hz: Array, moving: bool = False, judged: Array | None = None) -> Array:
    """Mean square errors of joints in blocks left out, at the cut-off of judging, (blocks, nv).

    Args:
        rows: Training data.
        hz: Cut-offs of joints' rows, shape (nv,) [Hz].
        moving: Leave rows out of the fit whose sign of velocity is noise.
        judged: Gram matrices of what is predicted, shape (nv, blocks, r + 1, r + 1); all rows
            when None.
    """
    grams = np.array([rows.grams(j, float(hz[j]), moving) for j in range(rows.nv)])
    judged = rows.judged() if judged is None else judged
    counts, total = rows.counts, grams.sum(axis=1)
    errors = []
    for b, count in enumerate(counts):
        beta = weighted_fit(total - grams[:, b], counts.sum() - count)
        errors.append(squared_errors(judged[:, b], beta) / count)
    return np.array(errors)


def paired(before: Array, after: Array, unit: Array | None = None) -> tuple[float, float]:
    """Mean relative fall of errors, and its standard error from the spread between blocks.

    Args:
        before: Mean square errors of blocks and joints, shape (blocks, nv).
        after: The same in another way.
        unit: What falls are relative to, shape (nv,); the mean of `before` when None.
    """
    size = np.maximum(before.mean(axis=0) if unit is None else unit, np.finfo(float).tiny)
    fall = ((before - after) / size).mean(axis=1)
    if len(fall) < _FEWEST:
        return 0.0, np.inf
    return float(fall.mean()), float(fall.std(ddof=1) / np.sqrt(len(fall)))


def in_percent(share: float, error: float, sign: str = "") -> str:
    """A share with its standard error, as many decimals as that has; `sign` as in formats."""
    if not np.isfinite(error):
        return "an unknown amount (too few blocks)"
    decimals = 2 if error <= 0 else int(np.clip(1 - np.floor(np.log10(100 * error)), 0, 3))
    return f"{100 * share:{sign}.{decimals}f} ± {100 * error:.{decimals}f} %"


def beyond_chance(fall: float, error: float, tried: int, blocks: int) -> bool:
    """Whether a fall is more than the best of some tries would show by chance."""
    return fall > float(scipy.stats.t.isf(_CHANCE / tried, max(blocks - 1, 1))) * error


def _common(rows: Bank, grid: Array, least: Array) -> tuple[Array, str]:
    """One cut-off for all joints by cross-validation, and why; no words for the default.

    Joints whose known harmonics go further keep the lowest of the grid that passes these.
    """
    trials = [_passing(np.full(rows.nv, f), grid, least) for f in grid]
    errors = [block_errors(rows, hz) for hz in trials]
    falls, blocks = [paired(errors[0], e) for e in errors], len(errors[0])
    sure = [k for k in range(1, len(grid)) if beyond_chance(*falls[k], len(grid) - 1, blocks)]
    if not sure:
        return trials[0], ""
    best = max(sure, key=lambda k: falls[k][0])
    near = (k for k in sure if _no_worse(errors[best], errors[k]))
    chosen = min(near)
    fall, error = falls[chosen]
    return trials[chosen], (
        f"cross-validation: errors (mean square) lower by {in_percent(fall, error)} "
        f"than with {grid[0]:.3g} Hz for all joints"
    )


def _passing(hz: Array, grid: Array, least: Array) -> Array:
    """Cut-offs of joints, none below what harmonics need if a higher one of the grid is not."""
    enough = [min((f for f in grid if f >= own), default=grid[0]) for own in least]
    return np.maximum(hz, enough)


def _no_worse(best: Array, other: Array) -> bool:
    """Whether errors are those of the best up to one standard error."""
    fall, error = paired(other, best)
    return fall <= error


def _per_joint(
    rows: Bank, spectra: ColumnSpectra, grid: Array, start: Array, least: Array
) -> tuple[Array, dict[int, str]]:
    """Cut-offs lowered joint by joint where spectra and cross-validation agree, and why."""
    hz, said = start.copy(), {}
    for j in range(rows.nv):
        lower = [f for f in grid if least[j] <= f < hz[j] * (1 - 1e-9)]
        trials = [np.where(np.arange(rows.nv) == j, f, hz) for f in lower]
        found = _lowered(spectra, hz, trials, rows.nv * (len(grid) - 1)) if trials else None
        if found is None:
            continue
        trial, fall, error = found
        change, spread = paired(block_errors(rows, hz), block_errors(rows, trial))
        if change < -spread:
            continue
        hz = trial
        said[j] = (
            f"spectrum: residual densest at {spectra.peak_hz(j):.2g} Hz, torque explained up to "
            f"{spectra.explained_hz(j):.2g} Hz; a lower cut-off takes {in_percent(fall, error)} "
            "off the variance of the predicted torque"
        )
    return hz, said


def _lowered(
    spectra: ColumnSpectra, hz: Array, trials: Sequence[Array], tried: int
) -> tuple[Array, float, float] | None:
    """The highest of lower cut-offs that is as good as the best, its gain and the error of that.

    None where the gain is not beyond chance.
    """
    now, parts = spectra.error(hz), [spectra.error(trial) for trial in trials]
    best = min(parts, key=lambda part: float(part.sum()))
    gains = [spectra.gained(part, best) for part in parts]
    k = next(k for k, (less, spread) in enumerate(gains) if less <= spread)
    fall, error = spectra.gained(now, parts[k])
    bound = float(scipy.stats.norm.isf(_CHANCE / tried))
    return (trials[k], fall, error) if fall > bound * error else None


def _dead_zone(rows: Bank, hz: Array) -> tuple[bool, tuple[str, ...]]:
    """Whether rows of unknown sign are left out of the fit, and what to say.

    Judged on the other rows: at rest, dry friction holds what nobody can predict.
    """
    share = np.array([rows.left_out(j, float(hz[j])) for j in range(rows.nv)])
    if not share.any():
        return False, ()
    judged = np.array([rows.grams(j, rows.judge_hz, moving=True) for j in range(rows.nv)])
    before, after = (block_errors(rows, hz, moving, judged) for moving in (False, True))
    fall, error = paired(before, after)
    taken = beyond_chance(fall, error, 1, len(before))
    did = "left out" if taken else "kept"
    return taken, (
        f"velocity dead zone: noise decides the sign of a velocity in up to "
        f"{100 * share.max():.2g} % of a joint's rows; they are {did}: without them, errors of the "
        f"other rows (mean square) in cross-validation change by {in_percent(-fall, error, '+')}",
    )


def _notes(
    joints: tuple[str, ...],
    hz: Array,
    default: float,
    reasons: tuple[str, ...],
    harmonics: Harmonics | None,
) -> tuple[str, ...]:
    note = _note(joints, hz, default, reasons)
    return (note,) if harmonics is None else (note, harmonics.sentence(joints, default))


def _note(joints: tuple[str, ...], hz: Array, default: float, reasons: tuple[str, ...]) -> str:
    lower = [
        f"{joint} {f:.3g} Hz ({why})"
        for joint, f, why in zip(joints, hz, reasons, strict=True)
        if f != default
    ]
    if not lower:
        return (
            f"cut-off: {default:.3g} Hz for all joints; no lower one predicts the training data's "
            "left-out blocks better beyond chance, nor lowers the variance of the prediction"
        )
    if len(set(reasons)) == 1 and len(set(hz)) == 1:
        return f"cut-off of the fit: {hz[0]:.3g} Hz for all joints ({reasons[0]})"
    rest = f"; the others {default:.3g} Hz" if len(lower) < len(joints) else ""
    return f"cut-off of the fit: {', '.join(lower)}{rest}; judged at {default:.3g} Hz"
