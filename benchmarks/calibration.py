"""Whether every ± that is printed holds, and which estimator misses least; see README.md."""

import time
import warnings
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import common
import numpy as np
import pandas as pd
import scipy
from threadpoolctl import threadpool_limits
from worlds_plant import SLIDING as STICKING
from worlds_plant import Drawing, Plant, Rng, Trajectory, given_and_true

from excitant.analysis.diagnosis import diagnose
from excitant.design import random_trajectory
from excitant.exceptions import ExcitantError
from excitant.identify import Estimate, Recording, identify_robot
from excitant.robots import Motion, Robot, load_robot, torque
from excitant.robots.effects import RotorInertia, effect_values
from excitant.robots.motion import Array
from excitant.robots.parameters import STANDARD, pseudo_inertia

FACTORS: dict[str, tuple[Any, ...]] = {
    "arm": ("ur5e", "ur10", "panda", "iiwa14", "gen3", "scara"),
    "bodies": (0.0, 0.1, 0.3),  # relative errors of the given ones, and of friction
    "reading": ("torque", "current"),
    "hidden": ("nothing", "payload", "spring", "tool left off"),
    "noise": ("clean", "coloured", "coarse", "bursts", "coarse and coloured"),
}
HIDDEN = {"payload": "payload", "spring": "spring", "tool left off": "payload"}  # as drawn
DURATION, HARMONICS = 20.0, 5  # of each motion [s]
RATES = (125.0, 250.0)  # Hz
TORQUE = 0.01  # noise of torque, of its standard deviation
FINE, COARSE = 2e-5, 2 * np.pi / 2**13  # noise of positions; steps of coarse encoders [rad]
SLIDING, CORRELATION = 0.1, 0.1  # the same of sliding joints [m/rad]; of coloured noise [s]
BURST, SHARE, SIZE = 0.1, 0.03, 3.0  # length [s], share of the time, times the torque's rms
GAIN, SPREAD = 10.0, (0.3, 0.5)  # median of drives [N·m/A]; std of their logarithms
PLACEHOLDER = np.array([1e-3, 0, 0, 0, *(1e-6 * np.eye(3))[np.triu_indices(3)]])  # kg, kg·m²
METHODS = {"default": None, "wls": "wls", "irls": "irls", "iv": "iv"}
Scores = list[tuple[str, float]]


@dataclass(frozen=True, eq=False)
class World:
    """An arm as given and as it is, three motions, and recordings of the first two."""

    levels: dict[str, Any]
    given: Robot
    plant: Plant
    gains: Array  # torque per reading
    motions: tuple[Trajectory, ...]
    recordings: tuple[Recording, ...]
    truth: dict[str, float]  # of parameters by name, in SI units

    def scores(self, result: dict[str, Any], prefix: str = "") -> Scores:
        """Kind and (value − truth) / ± of what a result says, where the truth is known."""
        per_reading, found = dict(zip(self.given.joints, self.gains, strict=True)), []
        for kind, name, value, std, unit in printed(result, self.given):
            if std and np.isfinite(std) and name in self.truth:
                true = self.truth[name]
                true /= per_reading[name.rpartition(".")[0]] if "A" in unit else 1.0
                found.append((prefix + kind, float((value - true) / std)))
        return found


def printed(result: dict[str, Any], robot: Robot) -> Iterator[tuple[str, str, Any, Any, str]]:
    """Kind, name, value, ± and unit of all that is told."""
    for x in result.get("base_parameters", ()):
        yield "base parameters", x["expression"], x["value"], x["std"], ""
    for x in result.get("parameters", ()):
        kind = x["name"].rpartition(".")[2]
        kind = f"links, unique, by {x['decided_by']}" if kind in STANDARD else kind
        yield kind, x["name"], x["value"], x["std"], x["unit"]
    for x in result.get("corrected", ()):
        yield "corrected values", x["name"], x["value"], x["std"], x["unit"]
    for finding in (part for f in result.get("findings", ()) for part in f.get("parts") or [f]):
        for x in finding["parameters"]:
            kind = f"{finding['effect']}, {finding['verdict']}"
            yield kind, x["name"], x["value"], x.get("std"), x.get("unit", "")
    gains = (result.get(f"drive_gain{s}_Nm_per_A") or [None] * robot.nv for s in ("", "_std"))
    for joint, gain, std in zip(robot.joints, *gains, strict=True):
        if gain and std:
            yield "log of drive gains", f"{joint} gain", np.log(gain), std / gain, ""


def levels_of(seed: int, number: int) -> dict[str, Any]:
    """A level of each factor: as many worlds in a row as there are have each level once."""
    found = {}
    for k, (factor, levels) in enumerate(FACTORS.items()):
        block, place = divmod(number, len(levels))
        order = np.random.default_rng([seed, k, block]).permutation(len(levels))
        found[factor] = levels[order[place]]
    return found


def drawn(seed: int, number: int, **chosen: Any) -> World:
    """A world of a number, with some of its levels chosen."""
    rng, levels = np.random.default_rng([seed, number]), levels_of(seed, number) | chosen
    arm, off = load_robot(levels["arm"]), levels["bodies"]
    given, as_given, plant = given_and_true(arm, rng, off)
    rotors = np.array([effect_values(arm).get(f"{joint}.Ia", 0.0) for joint in arm.joints])
    true_rotors = rotors * (1 + off * rng.normal(size=arm.nv).clip(-2, 2))
    given = given.with_effects([*given.effects, RotorInertia(arm.joints, values=tuple(rotors))])
    plant = replace(plant, laws=((lambda state: state.ddq, true_rotors),))
    motions = tuple(random_trajectory(given, rng, DURATION, HARMONICS) for _ in range(3))
    truth, hidden, body = {}, levels["hidden"], given.phi.copy()
    if hidden != "nothing":
        kind, drawing = HIDDEN[hidden], Drawing(plant, as_given, motions[:2], rng)
        plant, found = drawing.hide(plant, kind, set())
    if hidden == "spring":
        k, [joint] = found.parameters["factor"], found.joints
        truth = {f"{joint}.k": k, f"{joint}.moment": -k * found.parameters["rest"]}
    if hidden == "tool left off":
        body[-10:] = PLACEHOLDER
    missing = plant.robot.phi - body
    carried = found.parameters["phi"] if hidden == "payload" else missing[-10:]
    own = {"Fv": plant.viscous, "Fc": plant.coulomb, "Ia": true_rotors, "offset": 0 * rotors}
    gains = GAIN * np.exp(rng.uniform(*SPREAD) * rng.normal(size=arm.nv))
    gains = gains if levels["reading"] == "current" else np.ones(arm.nv)
    for k, (link, joint) in enumerate(zip(arm.links, arm.joints, strict=True)):
        phi, more = (x.reshape(-1, len(STANDARD))[k] for x in (plant.robot.phi, missing))
        for name, x in ((f"{link}.", phi), (f"{link}.delta_", more), (f"{link}.payload_", carried)):
            truth |= {name + symbol: float(v) for symbol, v in zip(STANDARD, x, strict=True)}
        truth[f"{joint} gain"] = np.log(gains[k])
        truth |= {f"{joint}.{symbol}": values[k] for symbol, values in own.items()}
    t = np.arange(0.0, DURATION, 1 / rng.choice(RATES))
    logs = tuple(record(plant, x, t, levels, gains, rng) for x in motions[:2])
    return World(levels, given.with_parameters(body), plant, gains, motions, logs, truth)


def record(
    plant: Plant, motion: Trajectory, t: Array, levels: dict[str, Any], gains: Array, rng: Rng
) -> Recording:
    """What the sensors of a world read of a motion."""
    q, tau, rate = motion(t, 0), plant.torque(motion, t), 1 / t[1]
    noise, kind = rng.normal(size=tau.shape), levels["noise"]
    if "coloured" in kind:
        a = np.exp(-1 / (rate * CORRELATION))
        noise = scipy.signal.lfilter([np.sqrt(1 - a**2)], [1, -a], noise, axis=0)
    read = tau + TORQUE * tau.std(axis=0) * noise
    if kind == "bursts":
        length = round(BURST * rate)
        begins = (rng.random(tau.shape) < SHARE / length) * rng.choice([-1.0, 1.0], tau.shape)
        bursts = scipy.signal.lfilter(np.ones(length), np.ones(1), begins, axis=0)
        read += SIZE * np.sqrt((tau**2).mean(axis=0)) * bursts
    unit = np.where(plant.robot.revolute, 1.0, SLIDING)
    q = q + FINE * unit * rng.normal(size=q.shape)
    if "coarse" in kind:
        q = COARSE * unit * np.round(q / (COARSE * unit))
    name, of = f"run {rng.integers(10**9)}", "N·m" if levels["reading"] == "torque" else "A"
    return Recording(name, name, t, q, read / gains, of)


def identified(world: World, estimator: str | None = None) -> Estimate:
    fit, held = world.recordings
    return identify_robot(world.given, [fit], validate=[held], estimator=estimator)


def identify(world: World) -> dict[str, Any]:
    """Scores of all that an identification prints, and how far links are from the true ones."""
    estimate, spring = identified(world), world.levels["hidden"] == "spring"
    beta = estimate.base.regrouping @ [world.truth[name] for name in estimate.base.names]
    world.truth.update(zip(estimate.base.expressions, beta, strict=True))
    scores = world.scores(estimate.result(), "hidden spring: " if spring else "")
    links = [distances(phi, world.plant.robot.phi) for phi in (world.given.phi, estimate.phi)]
    return {"scores": scores, "links": np.transpose(links).tolist()}


def diagnosed(world: World) -> dict[str, Any]:
    fit, held = world.recordings
    result = diagnose(world.given, [fit], validate=[held]).result()
    return {"scores": world.scores(result, "diagnose: ")}


def estimators(world: World) -> dict[str, Any]:
    """Nrmse per joint of readings without noise, of a third motion, by each estimator."""
    t = np.arange(0.0, DURATION, 0.02)
    motion, tau = Motion(t, *(world.motions[2](t, k) for k in range(3))), {}
    true = world.plant.torque(world.motions[2], t) / world.gains
    moves, size = np.abs(motion.dq) > 10 * STICKING, true.std(axis=0)
    for method, name in METHODS.items():
        found = identified(world, name)
        error = np.where(moves, torque(found.model, motion) / found.gains - true, 0.0)
        tau[method] = (np.sqrt((error**2).sum(axis=0) / moves.sum(axis=0)) / size).tolist()
    return {"errors": tau}


def distances(phi: Array, truth: Array) -> Array:
    """Distances to the true links in units of mass and radius of gyration, (10 nv,) → (nv,)."""
    found = []
    for P, true in zip(*(pseudo_inertia(x.reshape(-1, 10)) for x in (phi, truth)), strict=True):
        mass = true[3, 3]
        radius = np.sqrt(np.trace(true[:3, :3]) / mass - (true[:3, 3] ** 2).sum() / mass**2)
        scale = np.diag([1 / radius] * 3 + [1.0]) / np.sqrt(mass)
        found.append(np.linalg.norm(scale @ (P - true) @ scale))
    return np.array(found)


VERBS = {"identify": identify, "diagnose": diagnosed, "estimators": estimators}


def run(seed: int, number: int, verbs: Sequence[str], tell: bool = False) -> dict[str, Any]:
    """What verbs make of a world; ``tell`` raises what they raise."""
    threadpool_limits(1)
    warnings.simplefilter("ignore")
    world = drawn(seed, number)
    case: dict[str, Any] = {"case": number, "levels": world.levels, "failed": [], "scores": []}
    for verb in verbs:
        if verb == "estimators" and world.levels["hidden"] == "spring":
            continue  # what none of them describes
        try:
            answer = VERBS[verb](world)
            case |= answer | {"scores": case["scores"] + answer.get("scores", [])}
        except Exception as error:
            if tell:
                raise
            what = "refused" if isinstance(error, ExcitantError) else "crashed"
            case["failed"].append(f"{verb} {what}: {error!s}"[:200].splitlines()[0])
    return case


def report(results: Sequence[dict[str, Any]], by: str | None, repeat: str) -> Iterator[str]:
    scores = [(r["levels"].get(by, ""), *x) for r in results for x in r["scores"]]
    if scores:
        table = pd.DataFrame(scores, columns=[by or "", "kind", "z"]).assign(z=lambda x: abs(x.z))
        groups = table.groupby(["kind", *([by] if by else [])])["z"]
        columns = {
            "how many": groups.size(),
            "95 % hold [%]": groups.agg(lambda z: 100 * (z <= 1.96).mean()),
            "rms z": groups.agg(lambda z: np.sqrt((z**2).mean())),
            "worst |z|": groups.max(),
            "beyond 5 [%]": groups.agg(lambda z: 100 * (z > 5).mean()),
        }
        yield pd.DataFrame(columns).to_string(float_format="{:.3g}".format)
    if links := [pair for r in results for pair in r.get("links", ())]:
        given, found = np.sqrt(np.mean(np.square(links), axis=0))
        share = 100 * np.mean([after < before for before, after in links])
        yield f"links to the true ones, rms: {given:.2f} → {found:.2f}, nearer in {share:.0f} %"
    if compared := [r for r in results if "errors" in r]:
        noise = [r["levels"]["noise"] for r in compared]
        for which, reduce in (("worst joint", np.max), ("median joint", np.median)):
            logs = [{m: np.log(reduce(e)) for m, e in r["errors"].items()} for r in compared]
            table = 100 * np.exp(pd.DataFrame(logs).groupby(noise).mean())
            table["default/best"] = table["default"] / table[[*METHODS][1:]].min(axis=1)
            yield f"\nunseen torque, nrmse of the {which} [%], geometric mean over worlds"
            yield table.to_string(float_format="{:.3g}".format)
    failed = Counter(what.partition(":")[0] for r in results for what in r["failed"])
    yield from (f"{what}: {count} worlds" for what, count in failed.items())
    yield from (f"{repeat} --case {r['case']}  # {w}" for r in results for w in r["failed"])


def main(
    *,
    count: int = 240,
    seed: int | None = None,
    verbs: Sequence[Literal[*VERBS]] = tuple(VERBS),  # type: ignore[valid-type]
    by: Literal[*FACTORS] | None = None,  # type: ignore[valid-type]
    case: int | None = None,
    processes: int = 2,
    output: common.Output = None,
) -> None:
    """Identify and diagnose worlds whose truth is known.

    Args:
        count: Number of worlds.
        by: Factor by whose levels the table is split.
        case: This world alone.
    """
    seed, begun = common.printed_seed(seed), time.perf_counter()
    if case is None:
        worlds = [(seed, number, verbs) for number in range(count)]
        results = common.answers(run, worlds, processes, output)
    else:
        results = [run(seed, case, verbs, tell=True)]
    print("\n".join(report(results, by, f"python benchmarks/calibration.py --seed {seed}")))
    print(f"{len(results)} worlds in {(time.perf_counter() - begun) / 60:.1f} min")


if __name__ == "__main__":
    common.run(main)
