"""Differentiators side by side on one recording: gains, noise, predicted error, for a figure."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from excitant.identify.differentiator_choice import (
    Spectrum,
    best_of,
    candidates,
    position_spectrum,
    predicted_error,
)
from excitant.identify.differentiators import (
    Differentiator,
    FourierFit,
    ZeroPhaseButterworth,
    five_point,
)
from excitant.identify.online import regular
from excitant.identify.recording import Recording
from excitant.robots.motion import Array

_POINTS = 200  # frequencies of a curve
_LOWEST = 0.1  # Hz
_GAP_STEPS = 2.5  # of the median step: a longer one is a gap


@dataclass(frozen=True, eq=False)
class Contestant:
    """One differentiator of the comparison.

    Attributes:
        label: What it is, in a word or two.
        differentiator: With its settings.
        chosen: Whether it served.
    """

    label: str
    differentiator: Differentiator
    chosen: bool = False


@dataclass(frozen=True, eq=False)
class DifferentiatorTable:
    """Differentiators compared on the positions of a recording.

    Attributes:
        contestants: Those compared; the one that served is among them.
        spectrum: Signal and noise of the positions.
        joint: The joint whose predicted error weighs most in the choice.
        why: Why the one that served was chosen, one sentence.
    """

    contestants: tuple[Contestant, ...]
    spectrum: Spectrum
    joint: int
    why: str


def differentiator_table(recording: Recording, why: str) -> DifferentiatorTable:
    """Compare the kinds, each with the settings that suit the recording best.

    Args:
        recording: What was recorded.
        why: The sentence of the choice that served on line; it begins with its name.

    Raises:
        BadInput: Fewer than 64 samples without a gap.
    """
    t, q, _ = regular(recording)
    steps = np.diff(t)
    ends = np.flatnonzero(steps > _GAP_STEPS * np.median(steps)) + 1
    edges = [0, *ends.tolist(), len(t)]
    k = int(np.argmax(np.diff(edges)))
    part = slice(edges[k], edges[k + 1])
    spectrum = position_spectrum(t[part], q[part])
    contestants = tuple(_contestants(spectrum, why))
    return DifferentiatorTable(contestants, spectrum, _telling_joint(contestants, spectrum), why)


def _contestants(spectrum: Spectrum, why: str) -> list[Contestant]:
    """Of each kind its best, and the one that served."""
    options = candidates(spectrum, period=spectrum.duration)
    filters = [d for d in options if isinstance(d, ZeroPhaseButterworth)]
    series = [d for d in options if isinstance(d, FourierFit)]
    polynomials = [d for d in options if d not in (*filters, *series, five_point())]
    central = [ZeroPhaseButterworth(d.cutoff_hz, "central") for d in filters]
    late = candidates(spectrum, causal=True)
    served = [d for d in late if why.startswith(f"{d.name}:")]
    found = [
        Contestant("five-point", five_point()),
        Contestant(
            "five-point, causal", five_point(causal=True), five_point(causal=True) in served
        ),
    ]
    for label, kind in (
        ("Savitzky-Golay", polynomials),
        ("Butterworth, spline", filters),
        ("Butterworth, central", central),
        ("Fourier series", series),
    ):
        if kind:
            found.append(Contestant(label, best_of(kind, spectrum).differentiator))
    found += [
        Contestant("Savitzky-Golay, causal", d, True)
        for d in served
        if d != five_point(causal=True)
    ]
    return found


def _telling_joint(contestants: Sequence[Contestant], spectrum: Spectrum) -> int:
    """The joint whose acceleration suffers most, relative to its size, from the one that served."""
    served = next((c for c in contestants if c.chosen), contestants[0])
    error = np.hypot(*predicted_error(served.differentiator, spectrum))
    f, width = spectrum.f, spectrum.f[1] - spectrum.f[0]
    size = np.sqrt((2 * np.pi * f) ** 4 @ spectrum.signal * width)
    return int(np.argmax(np.divide(error, size, out=np.zeros_like(error), where=size > 0)))


def differentiator_result(found: DifferentiatorTable) -> dict[str, Any]:
    """The comparison as entries of result.json; errors are of the telling joint."""
    spectrum, rate, j = found.spectrum, found.spectrum.rate_hz, found.joint
    rows = []
    for each in found.contestants:
        lost, noise = (float(part[j]) for part in predicted_error(each.differentiator, spectrum))
        rows.append(
            {
                "label": each.label,
                "name": each.differentiator.name,
                "chosen": each.chosen,
                "delay_s": each.differentiator.delay(rate),
                "noise_gain_velocity": each.differentiator.noise_gain(rate, 1),
                "noise_gain_acceleration": each.differentiator.noise_gain(rate, 2),
                "signal_lost": lost,
                "noise": noise,
                "error": float(np.hypot(lost, noise)),
            }
        )
    return {
        "why": found.why,
        "rate_hz": rate,
        "joint": j + 1,
        "position_noise": float(spectrum.noise[j]),
        "contestants": rows,
    }


def differentiator_series(found: DifferentiatorTable) -> dict[str, Array]:
    """Curves for the figure.

    ``differentiator_f`` (k,) [Hz], gains of velocity and acceleration (k, contestants), and
    the positions' ``position_f`` (m,), ``position_signal`` (m,) [rad²/Hz], of the telling joint.
    """
    rate, spectrum = found.spectrum.rate_hz, found.spectrum
    f = np.geomspace(min(_LOWEST, rate / 100), rate / 2, _POINTS)
    gains = [
        np.column_stack([c.differentiator.gain(f, rate, order) for c in found.contestants])
        for order in (1, 2)
    ]
    where, power = _binned(spectrum.f[1:], spectrum.signal[1:, found.joint])
    return {
        "differentiator_f": f,
        "differentiator_gain_velocity": gains[0],
        "differentiator_gain_acceleration": gains[1],
        "position_f": where,
        "position_signal": power,
    }


def _binned(f: Array, power: Array) -> tuple[Array, Array]:
    """Mean power in bins of equal width on a logarithmic axis, empty bins left out."""
    edges = np.geomspace(f[0], f[-1] * (1 + 1e-9), _POINTS + 1)
    bins = np.clip(np.searchsorted(edges, f, side="right") - 1, 0, _POINTS - 1)
    count = np.bincount(bins, minlength=_POINTS)
    mean = np.bincount(bins, power, _POINTS) / np.maximum(count, 1)
    used = count > 0
    return np.sqrt(edges[:-1] * edges[1:])[used], mean[used]
