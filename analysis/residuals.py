"""What a model leaves on the hold-out: how much of it is noise, and where the rest shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.signal

from excitant.analysis.domains import band_shares, places, shares, telling
from excitant.analysis.sticking import sliding
from excitant.identify.least_squares import autocorrelation_time
from excitant.identify.preprocessing import Segment
from excitant.robots.motion import Array

VISIBLE = 2.0  # times the noise floor: from here on an effect can be seen
_SHARE = 0.1  # of the given model's squared error
_BAND = 1.5  # times the cut-off: where nothing of the motion is left
_PASSED = 0.898  # of white noise below the cut-off: ∫ dx / (1 + x⁸)²
_NEAR = (0.6, 0.95)  # of the cut-off
_LONGEST = 512  # samples of a periodogram's stretch
_FORGETS = 0.1  # s: residuals that forget faster than this look like noise
_MEASURABLE = 1e-3  # of the error: less noise than this is not what a sensor has, but a filter
_SAID = 100.0  # times the noise: beyond, the number says nothing more
WORDS = {
    "constant": "{} are a constant offset",
    "direction": "{} vary with the direction of motion",
    "velocity": "{} vary with velocity",
    "position": "{} vary with position",
    "load": "{} vary with load",
    "reversal": "{} vary with the distance since the last reversal",
    "time": "{} drift with time",
}


@dataclass(frozen=True)
class Remainder:
    """What is left of one joint's torque.

    Attributes:
        joint: Name.
        rms: Error of the extended model [torque unit].
        floor: What noise alone would leave [torque unit].
        given: Error of the given model [torque unit].
        correlation_s: How long the error stays correlated [s].
        shows: Share of the error's power that each of `domains.DOMAINS` explains.
        bands: Share of the error's power in each of `domains.BANDS`.
    """

    joint: str
    rms: float
    floor: float
    given: float
    correlation_s: float
    shows: tuple[tuple[str, float], ...]
    bands: tuple[tuple[str, float], ...] = ()

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
        """What tells the error best, empty where nothing alone does."""
        return telling(dict(self.shows))

    @property
    def structure(self) -> str:
        """What is left, in words."""
        if not self.visible and self.correlation_s < _FORGETS:
            return "noise-like"
        words = f"structured: stays correlated over {self.correlation_s:.2g} s"
        if not self.domain:
            return words
        share = dict(self.shows)[self.domain]
        return f"{words}; {WORDS[self.domain].format(f'{100 * share:.0f} %')}"

    @property
    def against_noise(self) -> str:
        """How many times the noise the error is, in words; what hides the noise otherwise."""
        if self.floor <= _MEASURABLE * max(self.rms, 1e-300):
            return "no noise is seen in the recorded torque, which was smoothed or computed"
        ratio = self.rms / self.floor
        if ratio > _SAID:
            return f"over {_SAID:.0f} times the noise"
        return f"{ratio:.{0 if ratio >= 10 else 1}f} times the noise"


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
    where, moves = places(segments, load), sliding(segments)
    step, cutoff = where.steps[0], segments[0].cutoff_hz
    found = []
    for j, joint in enumerate(joints):
        at = moves[:, j] if moves[:, j].any() else ~moves[:, j]
        e = error[at, j]
        found.append(
            Remainder(
                joint,
                float(np.sqrt((e**2).mean())),
                max(noise_floor(segments, j), _fast(error[:, j], 1 / step, cutoff)),
                float(np.sqrt((given[at, j] ** 2).mean())),
                float(autocorrelation_time(e) * step),
                tuple(shares(error[:, j], where, j, at).items()),
                tuple(band_shares(error[:, j], where, j).items()),
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
