"""What a cut-off does to the uncertainty of the predicted torque, from spectra alone.

A filter of gain g(f) applied to rows and torque of joint j gives each frequency the weight g². With
K_j(f) the spectral density of joint j's columns, S_j(f) that of its noise and w_j its weight,

    A = Σ_j w_j ∫ g_j² K_j df,   Ω = Σ_j w_j² ∫ g_j⁴ S_j K_j df,   cov β̂ = A⁻¹ Ω A⁻¹ / T

and E = tr(cov β̂ · J) is the mean square error of the torque predicted at the cut-off of judging, J
the columns there, each joint relative to its noise. White noise makes E fall with rising cut-off; a
resonance, or noise that differentiation let in, makes it fall until the filter reaches it. E
needs no held-out samples, whose own noise would hide what a filter changes; what it cannot see is
bias, so that `excitant.identify.cutoff` asks for a second opinion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal

from excitant.identify.cutoff_rows import Bank, Part, weighted_fit
from excitant.identify.differentiators import ZeroPhaseButterworth
from excitant.identify.least_squares import SMALLEST
from excitant.robots.motion import Array, freeze

_WINDOW = 4.0  # s, tapered; long against the period of the lowest cut-off
_BINS = 8.0  # per octave at high frequency; single lines at low
_HIGHEST = 2.0  # cut-offs of judging: what is above passes no filter


@dataclass(frozen=True, eq=False)
class ColumnSpectra:
    """Spectral densities of every joint's columns and noise in bins of frequency.

    Attributes:
        f: Mean frequency of the bins, shape (m,) [Hz].
        K: Power of the columns in each bin, shape (nv, m, r, r).
        noise: Power of the noise in each bin, shape (nv, m) [(torque unit)²].
        signal: The same of the predicted torque, shape (nv, m).
        lines: Width of each bin in lines of the transform, shape (m,).
        looks: Independent looks at each line.
        judge_hz: Cut-off of judging [Hz].
        rate_hz: Rate that gains are taken at [Hz].
    """

    f: Array
    K: Array
    noise: Array
    signal: Array
    lines: Array
    looks: float
    judge_hz: float
    rate_hz: float

    def __post_init__(self) -> None:
        freeze(self, "f", "K", "noise", "signal", "lines")

    def gain(self, hz: Array) -> Array:
        """Gain of the filters of joints, cut-offs of shape (nv,) → (nv, m)."""
        return np.array([ZeroPhaseButterworth(float(c)).gain(self.f, self.rate_hz, 0) for c in hz])

    def error(self, hz: Array) -> Array:
        """Parts of E by joint's noise and bin, shape (nv, m), at cut-offs of shape (nv,)."""
        g = self.gain(hz)
        judge = self.gain(np.full(len(hz), self.judge_hz))
        weight = 1 / np.maximum((g**2 * self.noise).sum(axis=1), SMALLEST**2)
        unit = 1 / np.maximum((judge**2 * self.noise).sum(axis=1), SMALLEST**2)
        A = np.einsum("j,jm,jmrs->rs", weight, g**2, self.K, optimize=True)
        J = np.einsum("j,jm,jmrs->rs", unit, judge**2, self.K, optimize=True)
        d = 1 / np.sqrt(np.maximum(np.diag(A), SMALLEST))
        inverse = np.linalg.pinv(A * np.outer(d, d), rcond=1e-12, hermitian=True)
        P = (inverse * d[:, None] * d) @ J @ (inverse * d[:, None] * d)
        traces = np.einsum("jmrs,rs->jm", self.K, P, optimize=True)
        return np.asarray((weight**2)[:, None] * g**4 * self.noise / self.lines * traces, float)

    def gained(self, before: Array, after: Array) -> tuple[float, float]:
        """Fall of E relative to what it was, and the standard deviation of that.

        The noise of a bin is known from its looks alone, a share 1 / √looks of it.

        Args:
            before: Parts of E as `error` gives them.
            after: The same at other cut-offs.
        """
        fall, total = before - after, float(before.sum())
        spread = float(np.sqrt((fall**2 / (self.looks * self.lines)).sum()))
        return float(fall.sum()) / total, spread / total

    def explained_hz(self, joint: int) -> float:
        """Frequency up to which the model explains more of a joint's torque than it leaves [Hz]."""
        own = (self.signal[joint] > self.noise[joint]) & (self.f <= self.judge_hz)
        return float(self.f[own].max(initial=0.0))

    def peak_hz(self, joint: int) -> float:
        """Where a joint's noise is strongest [Hz]."""
        return float(self.f[int(np.argmax(self.noise[joint] / self.lines))])


def column_spectra(rows: Bank) -> ColumnSpectra:
    """Spectra of the columns and of what weighted least squares leaves."""
    beta = weighted_fit(rows.judged().sum(axis=1), float(rows.counts.sum()))
    window = min(_WINDOW, *(len(p.columns[0]) / p.rate_hz for p in rows.parts))
    edges = _edges(1 / window, _HIGHEST * rows.judge_hz)
    r, m = rows.size, len(edges) - 1
    K, powers = np.zeros((rows.nv, m, r, r)), np.zeros((2, rows.nv, m))
    looks, time = 0.0, 0.0
    for part in rows.parts:
        duration = len(part.columns[0]) / part.rate_hz
        looks, time = looks + duration / window, time + duration
        for j in range(rows.nv):
            own, signal, noise = _binned(part, j, beta, window, edges)
            u = part.used[j]
            K[j][:, u[:, None], u] += own * duration
            powers[:, j] += np.array([signal, noise]) * duration
    return ColumnSpectra(
        f=(edges[:-1] + edges[1:]) / 2, K=K / time, noise=powers[1] / time,
        signal=powers[0] / time, lines=np.diff(edges) * window, looks=looks,
        judge_hz=rows.judge_hz, rate_hz=min(p.rate_hz for p in rows.parts),
    )  # fmt: skip


def _edges(line: float, highest: float) -> Array:
    """Edges of the bins: single lines first, then so many to an octave [Hz]."""
    edges = [line / 2]
    while edges[-1] < highest:
        edges.append(edges[-1] + line * max(1.0, np.floor(edges[-1] / line / _BINS)))
    return np.array(edges)


def _binned(
    part: Part, joint: int, beta: Array, window: float, edges: Array
) -> tuple[Array, Array, Array]:
    """Columns' powers (m, u, u), and powers of predicted torque and residual, each (m,)."""
    X, used = part.columns[joint], part.used[joint]
    predicted = X[:, :-1] @ beta[used]
    values = np.column_stack([X[:, :-1], predicted, X[:, -1] - predicted])
    f, spectra = _windows(values, part.rate_hz, window)
    place = np.digitize(f, edges) - 1
    m, u = len(edges) - 1, len(used)
    K, powers = np.zeros((m, u, u)), np.zeros((2, m))
    for k in range(m):
        lines = spectra[:, place == k].reshape(-1, u + 2)
        K[k] = (lines[:, :u].conj().T @ lines[:, :u]).real
        powers[:, k] = (np.abs(lines[:, u:]) ** 2).sum(axis=0)
    return K, powers[0], powers[1]


def _windows(
    values: Array, rate_hz: float, window: float
) -> tuple[Array, npt.NDArray[np.complex128]]:
    """Fourier transforms of tapered windows that overlap by half, power as in the values.

    Returns:
        Frequencies (lines,) [Hz], transforms (windows, lines, columns); Σ |·|² over the lines but
        the first is the variance.
    """
    n = min(int(window * rate_hz), len(values))
    starts = np.unique(
        np.linspace(0, len(values) - n, max(1, 2 * len(values) // n - 1)).astype(int)
    )
    taper = scipy.signal.get_window("hann", n)[:, None]
    scale = np.sqrt(2 / (n * float((taper**2).sum())) / len(starts))
    found = [np.fft.rfft(taper * (values[s : s + n]), axis=0) * scale for s in starts]
    return np.asarray(np.fft.rfftfreq(n, 1 / rate_hz), float), np.array(found, complex)
