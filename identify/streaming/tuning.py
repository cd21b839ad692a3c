"""Cut-offs and dead zone of a streamed fit, chosen as in memory, from excerpts of its logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from excitant.identify.cutoff_study import FACTORS, Study, study
from excitant.identify.differentiators import low_pass
from excitant.identify.preprocessing import prepare, resampled, uninterrupted
from excitant.identify.recording import MINIMUM_DURATION, Recording
from excitant.identify.rows import Data, fit_rows
from excitant.identify.streaming.columns import Layout

_RATE = 16.0  # instants per period of the highest cut-off that is tried
_ANTI_ALIAS = 0.4  # of that rate


def study_of_excerpts(
    form: Layout, excerpts: Sequence[Recording], cutoff_hz: float, *, fixed: bool
) -> Study:
    """What `excitant.identify.cutoff_study.study` chooses for the excerpts alone.

    Args:
        form: The arm, its effects and its base parameters.
        excerpts: The liveliest piece of what is fitted of each log.
        cutoff_hz: Cut-off at which errors are judged [Hz].
        fixed: Keep it, because the user gave it.
    """
    parts = [thinned(excerpt, _RATE * FACTORS[-1] * cutoff_hz) for excerpt in excerpts]
    segments = tuple(s for part in parts for s in prepare(part, cutoff_hz))
    data = Data(segments, (), parts[0].unit, cutoff_hz, "")
    rows = fit_rows(form.robot, form.effects, form.base, data)
    return study(form.robot, rows, parts, fixed=fixed)


def thinned(recording: Recording, rate_hz: float) -> Recording:
    """A recording at a lower rate, but not below a given one [Hz], without what would alias."""
    step = float(np.median(np.diff(recording.t)))
    stride = int(1 / (rate_hz * step) + 1e-6)
    if stride < 2:
        return recording
    kept = [
        part
        for part in uninterrupted(recording.t)
        if recording.t[part[-1]] - recording.t[part[0]] >= MINIMUM_DURATION
    ]
    if not kept:
        return recording  # `prepare` says why it cannot be used
    times, channels = [], []
    for part in kept:
        t, q, tau = resampled(recording, part)
        times.append(t[::stride])
        channels.append(low_pass(np.hstack([q, tau]), _ANTI_ALIAS / (stride * step), 1 / step))
    both = np.concatenate([x[::stride] for x in channels])
    q, tau = np.hsplit(both, 2)
    return replace(recording, t=np.concatenate(times), q=q, tau=tau, dq=None)


def sentence(excerpts: Sequence[Recording]) -> str:
    """Where the choice was made, for the notes."""
    seconds = sum(excerpt.duration for excerpt in excerpts)
    return (
        f"cut-offs and dead zone of the fit were chosen on {seconds:.3g} s of the recordings, in "
        "which most joints move, and hold for all of them"
    )
