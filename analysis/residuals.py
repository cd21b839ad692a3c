"""What a model leaves on the hold-out: how much of it is noise, and where the rest shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from excitant.analysis.sticking import sliding
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array

VISIBLE = 2.0  # times the noise floor: from here on an effect can be seen
_SHARE = 0.1  # of the given model's squared error
_BINS = 24
_BAND = 1.5  # times the cut-off: where nothing of the motion is left
_PASSED = 0.898  # of white noise below the cut-off: ∫ dx / (1 + x⁸)²
_NEAR = (0.6, 0.95)  # of the cut-off
_LONGEST = 512  # samples of a periodogram's stretch
_FORGETS = 0.1  # s: residuals that forget faster than this look like noise


@dataclass(frozen=True)
class Remainder:
    """What is left of one joint's torque.

    Attributes:
        joint: Name.
        rms: Error of the extended model [torque unit].
        floor: What noise alone would leave [torque unit].
        given: Error of the given model [torque unit].
        correlation_s: How long the error stays correlated [s].
        shows: Share of the error's power that varies with position, velocity, load and time.
    """

    joint: str
    rms: float
    floor: float
    given: float
    correlation_s: float
    shows: tuple[tuple[str, float], ...]

    @property
    def structured(self) -> float:
        """Rms of the error beyond the noise [torque unit]."""
        return float(np.sqrt(max(self.rms**2 - self.floor**2, 0.0)))

    @property
    def visible(self) -> bool:
        """Whether more than noise is left, by what can be seen, and much of what was there."""
        share = self.structured**2 / max(self.given**2, 1e-300)
        slow = self.correlation_s > _FORGETS / 2
        return slow and self.structured > VISIBLE * self.floor and share > _SHARE

    @property
    def domain(self) -> str:
        """What the error varies with most."""
        return max(self.shows, key=lambda pair: pair[1])[0]

    @property
    def structure(self) -> str:
        """What is left, in words."""
        if not self.visible and self.correlation_s < _FORGETS:
            return "noise-like"
        words = f"structured: stays correlated over {self.correlation_s:.2g} s"
        share = dict(self.shows)[self.domain]
        return f"{words}; {100 * share:.0f} % vary with {self.domain}" if share > 0.1 else words


def remainders(
    joints: Sequence[str], segments: Sequence[Segment], error: Array, given: Array, load: Array
) -> tuple[Remainder, ...]:
    """What is left of each joint's torque where it moves.

    Args:
        joints: Names.
        segments: The hold-out.
        error: What the model leaves at its rows, shape (n, nv) [torque unit].
        given: What the given model leaves there, shape (n, nv) [torque unit].
        load: Torque of the model at its rows, shape (n, nv) [torque unit].
    """
    q, dq = (
        np.concatenate([getattr(s.motion, name)[s.keep] for s in segments]) for name in ("q", "dq")
    )
    step = float(segments[0].t[1] - segments[0].t[0])
    cutoff = segments[0].cutoff_hz
    time, found, moves = np.arange(len(error), dtype=float), [], sliding(segments)
    for j, joint in enumerate(joints):
        at = moves[:, j] if moves[:, j].any() else ~moves[:, j]
        e = error[at, j]
        domains = {
            "position": q[:, j],
            "velocity": dq[:, j],
            "load": load[:, j] * np.sign(dq[:, j]),
            "time": time,
        }
        found.append(
            Remainder(
                joint,
                float(np.sqrt((e**2).mean())),
                max(noise_floor(segments, j), _fast(error[:, j], 1 / step, cutoff)),
                float(np.sqrt((given[at, j] ** 2).mean())),
                float(autocorrelation_time(e) * step),
                tuple((name, _varies(e, x[at])) for name, x in domains.items()),
            )
        )
    return tuple(found)


def noise_floor(segments: Sequence[Segment], j: int) -> float:
    """Rms that white noise of one joint's raw torque leaves behind the filter [torque unit].

    Its density is the median of the periodogram above the motion's band; zero where the rate
    leaves no such band.
    """
    power, weight = 0.0, 0
    for s in segments:
        n = len(s.tau_raw)
        f, density = scipy.signal.welch(s.tau_raw[:, j], s.rate_hz, nperseg=min(_LONGEST, n))
        above = density[f > _BAND * s.cutoff_hz]
        if len(above):
            power += n * float(np.median(above)) * _PASSED * s.cutoff_hz
            weight += n
    return float(np.sqrt(power / weight)) if weight else 0.0


def _fast(e: Array, rate_hz: float, cutoff_hz: float) -> float:
    """Rms that an error would have if its density below the cut-off were that close to it."""
    f, density = scipy.signal.welch(e, rate_hz, nperseg=min(_LONGEST // 4, len(e)))
    near = density[(f > _NEAR[0] * cutoff_hz) & (f < _NEAR[1] * cutoff_hz)]
    return float(np.sqrt(np.median(near) * _PASSED * cutoff_hz)) if len(near) else 0.0


def _varies(e: Array, x: Array) -> float:
    """Share of the power of e that its means over bins of x hold, less what chance would."""
    edges = np.quantile(x, np.linspace(0, 1, _BINS + 1)[1:-1])
    bins = np.searchsorted(edges, x)
    count = np.bincount(bins, minlength=_BINS)
    mean = np.bincount(bins, e, minlength=_BINS) / np.maximum(count, 1)
    held = float((count * mean**2).sum()) / max(float((e**2).sum()), 1e-300)
    independent = len(e) / autocorrelation_time(e - mean[bins])
    chance = (1 - held) * _BINS / independent
    return float(np.clip(held - chance, 0.0, 1.0))
