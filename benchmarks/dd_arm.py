"""Khosla's Tables 2-4 as a recovery experiment on the CMU DD Arm II; see README.md."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import common
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import scipy.linalg
from arms import TrueArm
from seed import TableEntry, dd_arm, dd_arm_chain, dd_arm_parameters, dd_arm_tables, parameter_map

from excitant.design import random_trajectory
from excitant.identify import Data, Recording
from excitant.identify.differentiators import LocalPolynomial
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.physical import fit_physical
from excitant.identify.preprocessing import Segment, prepare
from excitant.identify.prior import link_coordinates, prior_parameters
from excitant.identify.rows import FitRows, fit_rows
from excitant.robots import Motion, Robot, base_parameters, regressor, robot_from_dh
from excitant.robots import parameters as standard
from excitant.robots.effects import CoulombFriction, Effect, ViscousFriction
from excitant.robots.torque import observation_columns

STEP_S = 0.002  # the paper's sampling
ENCODER = 2 * np.pi / 2**16  # rad: assumed step
NOISE_SHARE = 0.02  # of each joint's rms torque
PERIOD_S, HARMONICS = 10.0, 5
TACHO = 0.001  # noise of measured velocity, of each joint's top speed
VISCOUS = np.array([0.6, 0.3, 0.15, 0.06, 0.04, 0.02])  # N·m·s/rad, assumed
COULOMB = np.array([1.5, 0.8, 0.4, 0.25, 0.15, 0.08])  # N·m, assumed
PRIOR_STEP = 0.2  # of a link's inertia: how far the prior is moved
DRAWS = 4
DATA, PRIOR = 0.1, 0.7  # std after over std before, below and above which one of them decides
AGREE = 0.05  # difference up to which the paper's results count as the same
MARGIN = 1e-4  # smallest eigenvalue of Q, as in the fit


class Entry(NamedTuple):
    """One table entry after the experiment."""

    entry: TableEntry
    initial: float  # in the prior
    truth: float
    value: float
    std: float
    kept: float  # standard deviation after over before the data: 1 where they say nothing
    silent: float  # share of the prior's variance in the null space of the regressor
    moved: float  # largest change when the prior moves along the null space

    @property
    def decided_by(self) -> str:
        """Who decided: the data, the prior, or both."""
        return "data" if self.kept < DATA else "prior" if self.kept > PRIOR else "both"


class Recovery(NamedTuple):
    """The 46 table entries; base parameters of links and friction, true and by least squares."""

    entries: tuple[Entry, ...]
    beta_true: np.ndarray
    beta: np.ndarray
    beta_std: np.ndarray
    base_moved: float  # largest change when the prior moves along the null space [std]


def simulated(truth: Robot, rng: np.random.Generator, seconds: float) -> list[Recording]:
    """Recordings of one period each: quantised positions, torque with noise."""
    count = max(1, round(seconds / PERIOD_S))
    return [recorded(truth, motion_of(rng), rng, f"run {k + 1}") for k in range(count)]


def motion_of(rng: np.random.Generator) -> Motion:
    """One period of a random motion."""
    path = random_trajectory(dd_arm("initial"), rng, PERIOD_S, HARMONICS)
    return path.at(np.arange(0, PERIOD_S, STEP_S))


def recorded(
    truth: Robot, motion: Motion, rng: np.random.Generator, name: str, step: float = ENCODER
) -> Recording:
    """A motion as the sensors read it, without velocity."""
    tau = TrueArm(truth.model, VISCOUS, COULOMB).torque(motion)
    tau += NOISE_SHARE * np.sqrt((tau**2).mean(axis=0)) * rng.standard_normal(tau.shape)
    return Recording(name, "simulated", motion.t, step * np.round(motion.q / step), tau)


def fitted(
    given: Robot, recordings: Sequence[Recording], effects: Sequence[Effect] | None = None
) -> FitRows:
    """Rows of recordings, for bodies and effects; for viscous and Coulomb friction when None."""
    if effects is None:
        effects = (ViscousFriction(given.joints), CoulombFriction(given.joints))
    train = tuple(segment for recording in recordings for segment in prepare(recording))
    data = Data(train, (), "N·m", train[0].cutoff_hz, "nothing held out")
    return fit_rows(given, effects, base_parameters(given, effects), data)


class Tables(NamedTuple):
    """The table entries as functions of the standard parameters about the joint frames."""

    entries: tuple[TableEntry, ...]
    selection: np.ndarray  # (46, 60), about the link frames: products with the other sign, sums
    central: int  # the entry that is about the centre of mass, I1zz
    to_frames: np.ndarray  # (60, 60), from joint frames to link frames

    def values(self, phi: np.ndarray) -> np.ndarray:
        """Values of all entries, shape (46,)."""
        frames = self.to_frames @ phi
        found = self.selection @ frames
        found[self.central] -= (frames[1] ** 2 + frames[2] ** 2) / frames[0]
        return np.asarray(found)

    def gradients(self, phi: np.ndarray) -> np.ndarray:
        """Derivatives of the entries, shape (46, 60)."""
        rows = self.selection.copy()
        m, x, y = (self.to_frames @ phi)[:3]
        rows[self.central, :3] -= np.array([-(x**2 + y**2) / m**2, 2 * x / m, 2 * y / m])
        return np.asarray(rows @ self.to_frames)


def tables() -> Tables:
    entries = dd_arm_tables()
    rows = np.zeros((len(entries), 60))
    for row, entry in zip(rows, entries, strict=True):
        for link, symbol in (name.split(".") for name in entry.parameter.split(" + ")):
            sign = -1.0 if symbol in ("Ixy", "Ixz", "Iyz") else 1.0
            row[10 * (int(link[4:]) - 1) + standard.STANDARD.index(symbol)] = sign
    central = [entry.name for entry in entries].index("I1zz")
    return Tables(entries, rows, central, np.linalg.inv(parameter_map(dd_arm_chain())))


def recovery(seconds: float = 60.0, *, likely: bool = True, seed: int = 0) -> Recovery:
    """Simulate some seconds with the estimated values, identify from the initial ones.

    ``likely``: doubtful digits of the truth as they probably are, or as read.
    """
    given, truth = dd_arm("initial"), dd_arm("estimated", likely=likely)
    rng = np.random.default_rng(seed)
    rows = fitted(given, simulated(truth, rng, seconds))
    fit = weighted_least_squares(rows.reduced)
    R, z = rows.regression.factor(fit.weight)
    prior = prior_parameters(given)
    found = fit_physical(R, z, prior, rows.open_prior)
    bodies = [prior + step.reshape(prior.shape) for step in null_steps(prior, rows, rng)]
    priors = [replace(found.prior, bodies=each, metric=prior) for each in bodies]
    moved = [fit_physical(R, z, each, rows.open_prior).x for each in priors]
    moves = np.array(moved) - found.x
    B, std = rows.base.regrouping, np.sqrt(np.diag(fit.covariance))
    columns, phi, L = tables(), found.x[:60], found.root[:60]
    S = scipy.linalg.null_space(B[:, :60] @ L)
    gradients = columns.gradients(phi)
    before = np.linalg.norm(gradients @ L, axis=1)
    after = np.sqrt(np.einsum("kp,pq,kq->k", gradients, found.covariance[:60, :60], gradients))
    silent = (np.linalg.norm(gradients @ L @ S, axis=1) / before) ** 2
    changes = np.array([columns.values(phi + move[:60]) - columns.values(phi) for move in moves])
    values = (columns.values(each) for each in (given.phi, truth.phi, phi))
    figures = np.array([*values, after, after / before, silent, np.abs(changes).max(axis=0)]).T
    return Recovery(
        tuple(Entry(entry, *row) for entry, row in zip(columns.entries, figures, strict=True)),
        B @ np.concatenate([truth.phi, VISCOUS, COULOMB]),
        fit.beta,
        std,
        float(np.abs(moves @ B.T / std).max()),
    )


class TwoByTwo(NamedTuple):
    """Table entries and base parameters by two motions from two sets of initial values.

    Arrays are indexed by motion, by set of initial values, and by entry or parameter.
    """

    entries: np.ndarray  # (2, 2, 46)
    truth: np.ndarray  # (46,)
    base: np.ndarray  # (2, 2, r)
    base_truth: np.ndarray  # (r,), those of the links

    def spreads(self, of_base: bool = False) -> np.ndarray:
        """Relative difference between motions, and between initial values, shape (2, ...)."""
        values, truth = (self.base, self.base_truth) if of_base else (self.entries, self.truth)
        across = [np.abs(np.diff(values, axis=k)).max(axis=(0, 1)) for k in (0, 1)]
        return np.asarray(across) / np.abs(truth)


def two_by_two_runs(seconds: float = 20.0, seed: int = 0) -> TwoByTwo:
    """The paper's proof: each of two motions identified from two sets of initial values.

    The first set is that of the tables, the second the same bodies at half their density.
    """
    truth, rng, columns = dd_arm("estimated", likely=True), np.random.default_rng(seed), tables()
    entries, base = [], []
    for motion in (simulated(truth, rng, seconds) for _ in range(2)):
        for density in (1.0, 0.5):
            given = dd_arm("initial").with_parameters(density * dd_arm("initial").phi)
            rows = fitted(given, motion)
            R, z = rows.regression.factor(weighted_least_squares(rows.reduced).weight)
            x = fit_physical(R, z, prior_parameters(given), rows.open_prior).x
            entries.append(columns.values(x[:60]))
            B = rows.base.regrouping[np.array(rows.base.columns) < 60]
            base.append(B @ x)
    known = B[:, :60] @ truth.phi
    shape = (2, 2, -1)
    return TwoByTwo(
        np.reshape(entries, shape), columns.values(truth.phi), np.reshape(base, shape), known
    )


def two_by_two_lines(found: TwoByTwo) -> Iterator[str]:
    error = np.abs(found.entries / found.truth - 1).max(axis=(0, 1))
    for words, of_base in ((f"{len(found.truth)} table entries", False), ("base parameters", True)):
        motions, initial = found.spreads(of_base)
        both = (np.maximum(motions, initial) < AGREE).sum()
        yield (
            f"{words}: {(motions < AGREE).sum()} agree within 5 % between motions, "
            f"{(initial < AGREE).sum()} between initial values, {both} between both"
        )
    agreeing = found.spreads()[0] < AGREE
    yield (
        f"of those {agreeing.sum()} entries that agree between motions, "
        f"{(agreeing & (error > AGREE)).sum()} are more than 5 % off the truth"
    )


def draw_two_by_two(found: TwoByTwo, path: Path) -> None:
    """Difference between motions against difference between initial values, entry by entry."""
    figure, axes = plt.subplots(figsize=(6.4, 5.2), layout="constrained")
    for of_base, words, colour, marker in (
        (True, "base parameter of the links", "#1b4965", "x"),
        (False, "entry of Tables 2 to 4", "#ca6702", "o"),
    ):
        x, y = np.clip(100 * found.spreads(of_base), 1e-2, 1e3)
        axes.loglog(x, y, marker, color=colour, ms=5, mfc="none", label=words)
    axes.axvline(100 * AGREE, color="0.6", ls="--", lw=1)
    axes.axhline(100 * AGREE, color="0.6", ls="--", lw=1)
    axes.set_xlabel("difference between two motions [% of the truth]")
    axes.set_ylabel("difference between two sets of initial values [%]")
    axes.legend(loc="lower right", fontsize=8)
    figure.savefig(path, dpi=150)


def null_steps(prior: np.ndarray, rows: FitRows, rng: np.random.Generator) -> list[np.ndarray]:
    """Moves of the prior that no torque shows, each changing some link by 20 %, shape (60,)."""
    T = link_coordinates(prior)
    scaled = np.linalg.solve(T, scipy.linalg.null_space(rows.base.regrouping[:, :60]))
    steps = []
    for _ in range(DRAWS):
        y = scaled @ np.linalg.lstsq(scaled, rng.standard_normal(60), rcond=None)[0]
        Q = np.zeros((len(y) // 10, 4, 4))
        Q[:, *np.triu_indices(4)] = y.reshape(-1, 10)
        Q += np.triu(Q, 1).transpose(0, 2, 1)
        steps.append(T @ y * PRIOR_STEP / np.abs(np.linalg.eigvalsh(Q)).max())
    return steps


class NearestBody(NamedTuple):
    """A link's printed parameters (10,), the inequality they break, and the nearest possible."""

    link: str
    violated: str
    printed: np.ndarray
    nearest: np.ndarray
    distance: float  # ‖Q − Q_printed‖_F, relative to the link's initial body


def nearest_bodies() -> Iterator[NearestBody]:
    """Links whose estimate as printed is impossible, and what is nearest to it.

    Near in the metric of the library's prior: P = L Q Lᵀ with L Lᵀ the pseudo-inertia of the
    initial values, ‖Q − Q_printed‖_F least with Q ⪰ 10⁻⁴. That is an eigenvalue clipped in Q.
    """
    initial, printed = (dd_arm_parameters(c).reshape(6, 10) for c in ("initial", "estimated"))
    for k, link in enumerate(dd_arm_chain().links):
        for broken in standard.violations(printed[k], (link,)):
            L = np.linalg.cholesky(standard.pseudo_inertia(initial[k]))
            Q = np.linalg.solve(L, np.linalg.solve(L, standard.pseudo_inertia(printed[k])).T)
            values, vectors = np.linalg.eigh((Q + Q.T) / 2)
            nearest = (vectors * np.maximum(values, MARGIN)) @ vectors.T
            phi = standard.from_pseudo_inertia(L @ nearest @ L.T)
            distance = float(np.linalg.norm(np.minimum(values - MARGIN, 0)))
            yield NearestBody(link, broken, printed[k], phi, distance)


def _rank(M: np.ndarray) -> int:
    flat = M.reshape(-1, M.shape[-1])
    norms = np.linalg.norm(flat, axis=0)
    used = norms > 1e-10 * norms.max()
    return int(np.linalg.matrix_rank(flat[:, used] / norms[used], rtol=1e-9))


EXPERIMENTS = {
    "cascade": "joints 1..i move, τ_i is read",
    "literal": "joint i alone moves, one pose, τ_i",
    "poses": "joint i alone moves, many poses, τ_1..τ_i",
}


def counts(rng: np.random.Generator, across: bool = False) -> dict[str, list[int]]:
    """Parameters per link, link 6 first, that experiments of several kinds determine.

    ``across``: the assumed offset of link 3 across joint 3 (a3) instead of along it (d3).
    """
    chain = dd_arm_chain()
    if across:
        third = np.arange(6) == 2
        chain = replace(chain, a=np.where(third, chain.d, chain.a), d=chain.d * ~third)
    robot, kinds = robot_from_dh(chain), {kind: [] for kind in EXPERIMENTS}
    for i in reversed(range(6)):
        for kind, found in kinds.items():
            q, dq, ddq = rng.uniform(-2, 2, (3, 300, 6))
            still = np.arange(6) > i if kind == "cascade" else np.arange(6) != i
            dq[:, still] = ddq[:, still] = 0.0
            if kind != "poses":
                q[:, still] = q[0, still]
            Y = regressor(robot, Motion(np.arange(300.0), q, dq, ddq))
            M = (Y @ parameter_map(chain))[..., 10 * i : 10 * i + 10]
            found.append(_rank(M[:, : i + 1] if kind == "poses" else M[:, i]))
    return kinds


def count_lines(rng: np.random.Generator) -> Iterator[str]:
    yield f"base parameters: {len(base_parameters(dd_arm('initial')))}"
    for across in (False, True):
        where = "across joint 3 (a3)" if across else "along joint 3 (d3)"
        yield f"  offset of link 3 {where}, assumed 0.1 m"
        for kind, found in counts(rng, across).items():
            total = " + ".join(map(str, found))
            yield f"    {EXPERIMENTS[kind]:<44} {total} = {sum(found)}"


def table_lines(found: Recovery) -> Iterator[str]:
    table, votes = pd.DataFrame(found.entries), [e.decided_by for e in found.entries]
    rows = [*table["entry"]]
    table["entry"] = [x.name + "?" * (x.doubtful in ("estimated", "both")) for x in rows]
    table["parameter"] = [x.parameter for x in rows]
    table["z"] = (table["value"] - table["truth"]) / table["std"]
    table["decided by"] = votes
    yield table.round(9).to_string(index=False, float_format="{:.4g}".format)
    yield ", ".join(f"{votes.count(who)} by {who}" for who in ("data", "both", "prior")) + (
        f"; base parameters moved by {found.base_moved:.1g} std at most"
    )
    z = (found.beta - found.beta_true) / found.beta_std
    yield (
        f"{len(z)} base parameters of links and friction by least squares: "
        f"{(np.abs(z) < 1.96).sum()} within 1.96 std, largest {np.abs(z).max():.1f} std"
    )


def body_lines() -> Iterator[str]:
    for body in nearest_bodies():
        yield f"{body.violated}; nearest possible body, at distance {body.distance:.3g}:"
        Ixx, Iyy, Izz = body.printed[[4, 6, 9]]
        if Ixx > Iyy + Izz:
            yield f"  about the link frame: Ixx > Iyy + Izz, {Ixx:.6f} > {Iyy:.6f} + {Izz:.6f}"
        values = {"printed": body.printed, "nearest": body.nearest, "unit": standard.UNITS}
        yield pd.DataFrame(values, standard.STANDARD).to_string(float_format="{:.6f}".format)


def velocities(seed: int = 0, tacho: float = TACHO, runs: int = 3) -> pd.DataFrame:
    """Rms torque error on motions not fitted, relative to the paper's velocity and filter of it.

    By `identify` before it used measured velocity, and after. Encoders have 12, 14 and 16 bits; the
    noise of the tacho is a share of the top speed.
    """
    given, truth = dd_arm("initial"), dd_arm("estimated", likely=True)
    rng, table = np.random.default_rng(seed), {}
    motions = [motion_of(rng) for _ in range(2 * runs)]
    for bits in (12, 14, 16):
        alone, fused = [], []
        for motion in motions[:runs]:
            alone.append(recorded(truth, motion, rng, "run", 2 * np.pi / 2**bits))
            noise = tacho * np.abs(motion.dq).max(axis=0) * rng.standard_normal(motion.q.shape)
            fused.append(replace(alone[-1], dq=motion.dq + noise))
        rows = fitted(given, fused)
        beta = rows.base.regrouping @ np.concatenate([truth.phi, VISCOUS, COULOMB])
        W = np.concatenate([observation_columns(given, rows.effects, m) for m in motions[runs:]])
        W = W[:, :, list(rows.base.columns)]
        paper = replace(rows.data, train=tuple(map(_five_points, fused)))
        ways = (fit_rows(given, rows.effects, rows.base, paper), fitted(given, alone), rows)
        fits = [weighted_least_squares(each.reduced).beta for each in ways]
        five, *others = [np.sqrt(((W @ (fit - beta)) ** 2).mean(axis=0)) for fit in fits]
        table |= {(bits, way): e / five for way, e in zip(("before", "after"), others, strict=True)}
        table[bits, "velocity above [Hz]"] = rows.data.sensors.crossover_hz
    return pd.DataFrame(table, index=range(1, 7)).T


def _five_points(recording: Recording) -> Segment:
    """Measured velocity, and acceleration of it by five samples (Khosla 1987, section 5.1)."""
    [segment] = prepare(recording)
    inner = slice(2, -2)
    five = LocalPolynomial(2, 2).kernel(1) * segment.rate_hz
    ddq = np.lib.stride_tricks.sliding_window_view(recording.dq, 5, axis=0) @ five
    motion = Motion(recording.t[inner], recording.q[inner], recording.dq[inner], ddq)
    keep = slice(segment.keep.start, segment.keep.stop - 4, segment.keep.step)
    tau, raw = segment.tau[inner], segment.tau_raw[inner]
    # five points pass what one sample of several would fold
    return replace(segment, motion=motion, tau=tau, tau_raw=raw, keep=keep, whole=True)


def main(
    *, seconds: float = 60.0, as_read: bool = False, two_by_two: Path | None = None, seed: int = 0,
    velocity: bool = False, tacho: float = TACHO,
) -> None:  # fmt: skip
    """Recover the tables.

    Args:
        seconds: Duration of what is recorded, 10 s a run.
        as_read: Take doubtful digits as the print shows them.
        two_by_two: File of a figure: two motions, two sets of initial values instead.
        seed: Of motions and noise.
        velocity: Compare uses of measured velocity instead.
        tacho: Noise of measured velocity, as a share of each joint's top speed.
    """
    if two_by_two:
        both = two_by_two_runs(seconds, seed)
        draw_two_by_two(both, two_by_two)
        print("\n".join(two_by_two_lines(both)))
        return
    if velocity:
        print("rms torque error on motions not fitted, joints 1 to 6, relative to five points")
        print(velocities(seed, tacho).to_string(float_format="{:.2f}".format))
        return
    print("\n".join(count_lines(np.random.default_rng(seed))), end="\n\n")
    print("\n".join(body_lines()), end="\n\n")
    print("\n".join(table_lines(recovery(seconds, likely=not as_read, seed=seed))))


if __name__ == "__main__":
    common.run(main)
