"""Diagnosis of arms of MuJoCo that hide effects, in worlds of more or less error; see README.md."""

import contextlib
import itertools
import json
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any, NamedTuple

import common
import numpy as np
import pandas as pd
import scipy
import worlds_plant as worlds
from common import wilson
from threadpoolctl import threadpool_limits
from worlds_plant import DURATION, Hidden, Plant, Rng, Trajectory

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.diagnosis_result import key
from excitant.analysis.discrimination_plan import plan
from excitant.analysis.explanation import rivals_of
from excitant.design import random_trajectory
from excitant.exceptions import Infeasible
from excitant.identify import Recording, identify_robot
from excitant.robots import Robot, load_robot
from excitant.robots.motion import Array

OFF = {"exact": 0.0, "off 10 %": 0.1, "off 30 %": 0.3}  # inertias and friction of the given model
READINGS = ("white", "coloured", "jitter", "current")
WORLDS = tuple(itertools.product(OFF, READINGS))
CATEGORIES = {"effects": 0.55, "set-up": 0.15, "outside": 0.1, "nothing": 0.2}
COUNTS = (0.6, 0.25, 0.15)  # shares of one, two and three effects
DIFFER = ("payload", "gravity_direction", "encoder_offset", "coulomb_friction", "viscous_friction",
          "torque_offset", "torque_gain")  # fmt: skip
HARMONICS = 5  # of each motion
NOISE, ENCODER = 0.01, 2e-5  # of torque, of its standard deviation; of positions [rad]
CORRELATION, BITS, HEADROOM = 0.02, 12, 1.5  # of coloured noise [s]; of torque, times its peak
JITTER, GAINS = 0.1, (2.0, 30.0)  # of the period; of the drives [N·m/A]
BINS = (0.0, 0.03, 0.05, 0.1, 0.2, 0.4, np.inf)

SAME = {  # exactly the same torque
    "asymmetric_friction": ("coulomb_friction", "torque_offset"),  # their sum
    "payload": ("inertial_parameters",),  # of the last link
    "inertial_parameters": ("payload",),
    "rotor_inertia at the first joint": ("inertial_parameters",),
}
NEAR = {  # as near as the vocabulary comes; neither right nor wrong
    "hose": ("spring", "presliding_hysteresis"),
    "bumper": ("spring",),
    "swaying table": ("joint_elasticity",),
}


def record(
    plant: Plant, motion: Trajectory, reading: str, gains: Array | float, rng: Rng, name: str,
    duration: float = DURATION,
) -> Recording:  # fmt: skip
    """What the sensors of a world read of a motion."""
    rate = 100.0 if reading == "jitter" else 125.0
    t = np.arange(0.0, duration, 1 / rate)
    if reading == "jitter":
        t[1:] += rng.uniform(-JITTER, JITTER, len(t) - 1) / rate
    q, tau = motion(t, 0), plant.torque(motion, t)
    noise = rng.normal(size=tau.shape)
    if reading == "coloured":
        a = np.exp(-1 / (rate * CORRELATION))
        noise = scipy.signal.lfilter([np.sqrt(1 - a**2)], [1, -a], noise, axis=0)
    tau = tau + NOISE * tau.std(axis=0) * noise
    if reading == "coloured":
        step = 2 * HEADROOM * np.abs(tau).max(axis=0) / 2**BITS
        tau = step * np.round(tau / step)
    q, tau = plant.edit(q + ENCODER * rng.normal(size=q.shape), tau)
    if reading == "current":
        return Recording(name, name, t, q, tau / gains, "A")
    return Recording(name, name, t, q, tau)


class Asked(NamedTuple):
    """What is drawn and done beside the usual, as options of `main`."""

    differ: bool = False
    settle: bool = False
    kinds: Sequence[str] = ()
    sizes: tuple[float, float] = worlds.SIZES
    arms: Sequence[str] = ()


class Case(NamedTuple):
    """A case: its description, the given model, two recordings, what is hidden, its sensors."""

    about: dict[str, Any]
    robot: Robot
    recordings: list[Recording]
    hidden: list[Hidden]
    read: Callable[..., Recording]  # of a motion, by name and for some time


def drawn(seed: int, number: int, asked: Asked = Asked()) -> Case:  # noqa: B008
    """A case by its number."""
    rng, (off, reading) = np.random.default_rng([seed, number]), WORLDS[number % len(WORLDS)]
    category = str(rng.choice(list(CATEGORIES), p=list(CATEGORIES.values())))
    category = "between" if asked.differ else "effects" if asked.kinds else category
    robot, given, bare, motions = moving_arm(rng, OFF[off], asked.arms)
    drawing = worlds.Drawing(bare, given, motions, rng, asked.sizes)
    plant, hidden = bare, list[Hidden]()
    if category == "set-up":
        plant, found = drawing.set_up(plant, str(rng.choice(worlds.SET_UPS)))
        hidden.append(found)
    elif category != "nothing":
        kinds, count = worlds.STRUCTURES, 1
        if category in ("effects", "between"):  # a current does not show the gain of its drive
            kinds = asked.kinds or (DIFFER if asked.differ else worlds.KINDS)
            kinds = tuple(k for k in kinds if (k, reading) != ("torque_gain", "current"))
        if asked.kinds:  # each in every world
            kinds = (kinds[(number + number // len(WORLDS)) % len(kinds)],)
        elif category == "effects":
            count = 1 + int(rng.choice(3, p=COUNTS))
        taken = set[int]()
        for kind in rng.choice(kinds, count, replace=False):
            plant, found = drawing.hide(plant, str(kind), taken)
            hidden.append(found)
    gains = np.exp(rng.uniform(*np.log(GAINS), robot.nv))
    sensors = partial(record, reading=reading, gains=gains, rng=rng)
    both = zip((bare if asked.differ else plant, plant), motions, ("fitted", "held"), strict=True)
    recordings = [sensors(arm, motion, name=name) for arm, motion, name in both]
    case = {"case": number, "seed": seed, "arm": robot.name, "world": f"{off}, {reading}"}
    case |= {"category": category, "off": OFF[off] * (not asked.differ)}
    return Case(case, robot, recordings, hidden, partial(sensors, plant))


def moving_arm(
    rng: Rng, off: float, arms: Sequence[str] = ()
) -> tuple[Robot, Plant, Plant, tuple[Trajectory, ...]]:
    """An arm whose drives can hold it, as `given_and_true`, and two motions."""
    while True:
        arm = load_robot(str(rng.choice(arms))) if arms else worlds.drawn_arm(rng)
        robot, given, bare = worlds.given_and_true(arm, rng, off)
        with contextlib.suppress(Infeasible):
            motions = [random_trajectory(robot, rng, DURATION, HARMONICS) for _ in range(2)]
            return robot, given, bare, tuple(motions)


def run(seed: int, number: int, asked: Asked, tell: bool = False) -> dict[str, Any]:
    """Draw a case, diagnose it and score what is said; ``tell`` prints all of it."""
    threadpool_limits(1)
    warnings.simplefilter("ignore")
    differ, world = asked.differ, drawn(seed, number, asked)
    case, robot, (fitted, holdout), hidden, _ = world
    case["hidden"] = [plain(vars(h)) for h in hidden]
    begun = time.perf_counter()
    try:
        if differ:
            told = identify_robot(robot, [fitted], validate=[holdout]).differences
            few = {"verdict": "named", "rivals": [], "parameters": []}
            findings = [d.entry(robot) | few | {"explained": 1 - d.left} for d in told]
        else:
            diagnosis = diagnose(robot, [fitted], validate=[holdout])
            told = diagnosis.result()["findings"]
            findings = [part for each in told for part in each.get("parts", [each])]
            case["settled"] = list(settled(world, diagnosis)) if asked.settle else []
    except Exception as error:
        if tell:
            raise
        case["no_result"] = f"{type(error).__name__}: {error}"
        return case | {"seconds": time.perf_counter() - begun}
    case["seconds"] = time.perf_counter() - begun
    case["found"] = [brief(finding) for finding in findings]
    case["score"] = score(case, robot, hidden, findings)
    if tell:
        print(json.dumps(case, indent=1))
    if tell and not differ:
        for label, accuracy in (("given", diagnosis.simulation), ("extended", diagnosis.extended)):
            print(f"nrmse on the hold-out, {label} model: {np.round(accuracy.nrmse, 3)}")
        print("\n".join([diagnosis.headline, *diagnosis.notes]))
    return case


def settled(world: Case, before: Diagnosis) -> Iterator[dict[str, Any]]:
    """What becomes of what is undecided when the motions that are to decide it were run."""
    proposed = plan(before, np.random.default_rng(0))
    asking = [e for e in (*proposed.experiments.values(), proposed.general) if e and e.file]
    times = dict(sorted((e.file, e.repetitions) for e in asking))  # the most of each file
    fitted, holdout = world.recordings
    runs = [
        world.read(motion, name=f"{file} {k}", duration=motion.period)
        for motion, (file, count) in zip(proposed.motions, times.items(), strict=True)
        for k in range(count)
    ]
    after = diagnose(world.robot, [fitted, *runs], validate=[holdout]) if runs else before
    said = {(f.effect.name, j, f.verdict) for f in after.findings for j in f.effect.joints}
    for finding in (f for f in before.findings if f.verdict == "undecided"):
        rivals = rivals_of(finding, before.findings)
        for pair in [(finding.effect, rival) for rival in rivals] or [(finding.effect,)]:
            ends = {(effect.name, *effect.joints) for effect in pair}
            true = {end for end in ends if is_true(end, world)}
            seen = {(e, v) for e in ends for name, j, v in said if name == e[0] and j in e[1:]}
            named = {end for end, verdict in seen if verdict == "named"}
            same = {(name, j, "named") for e in true for name in SAME.get(e[0], ()) for j in e[1:]}
            decided = named or said & same or not (true or seen)
            became = "wrong" if named - true else "right" if decided else "open"
            told = proposed.experiments.get(key(*pair)) if rivals else proposed.general
            how = "motion" if told and told.file else "action" if finding.matters else "nothing"
            if told and "both make the same torque" in told.experiment:
                how = "action, of one torque"
            yield {"pair": sorted(ends), "true": sorted(true), "how": how, "became": became}


def is_true(end: tuple[str, ...], world: Case) -> bool:
    """Whether a cause by name and joints is there."""
    entry = {"effect": end[0], "joints": end[1:]}
    there = any(is_it(entry, h, world.robot) for h in world.hidden)
    return there or of_the_world(end[0], world.about["off"], world.hidden)


def plain(value: Any) -> Any:
    """A value as JSON has it, numbers to four digits."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple | np.ndarray):
        return [plain(v) for v in value]
    number = isinstance(value, float | np.floating)
    return float(f"{value:.4g}") if number and np.isfinite(value) else None if number else value


def brief(finding: dict[str, Any]) -> dict[str, Any]:
    share = round(finding.get("share", finding.get("explained")), 4)
    rivals = [[r["effect"], r["joints"]] for r in finding["rivals"]]
    named = {key: finding[key] for key in ("effect", "joints", "verdict")}
    values = {p["name"]: [p["value"], p["std"]] for p in finding["parameters"]}
    few = plain(values) if finding["effect"] not in worlds.BODIES else {}
    return named | {"share": share, "rivals": rivals, "parameters": few}


def score(
    case: dict[str, Any], robot: Robot, hidden: Sequence[Hidden], findings: Sequence[dict[str, Any]]
) -> dict[str, Any]:
    """Of each hidden effect, whether it is named and found; what is named and not there."""
    sure = [f for f in findings if f["verdict"] in ("named", "unknown")]
    named = [any(is_it(f, h, robot) for f in sure) for h in hidden]
    said = [each for f in findings for each in (f, *f["rivals"])]
    found = [any(is_it(each, h, robot) for each in said) for h in hidden]
    settled = [any(_only_names(f, h, robot) for f in findings) for h in hidden]
    wrong = [
        f"{f['effect']}@{'+'.join(f['joints'][:2])}"
        for f in findings
        if f["verdict"] == "named"
        and not of_the_world(f["effect"], case["off"], hidden)
        and not any(is_it(f, h, robot) or f["effect"] in NEAR.get(h.kind, ()) for h in hidden)
    ]
    lead = [*findings[:1], *(findings[0]["rivals"] if findings else ())]
    first = bool(hidden) and any(is_it(each, hidden[0], robot) for each in lead)
    silent = not any(  # beyond what is true of the world
        f["verdict"] in ("named", "undecided")
        and not any(of_the_world(each["effect"], case["off"], ()) for each in (f, *f["rivals"]))
        for f in findings
    )
    near = [f["effect"] for f in sure for h in hidden if f["effect"] in NEAR.get(h.kind, ())]
    judged = {"named": named, "settled": settled, "found": found, "wrong": wrong, "first": first}
    return judged | {"silent": silent, "near": near}


def is_it(finding: dict[str, Any], hidden: Hidden, robot: Robot) -> bool:
    """Whether a finding, or a rival of one, is what is hidden, at one of its joints."""
    first = " at the first joint" if hidden.joints == robot.joints[:1] else ""
    names = (hidden.effect, *SAME.get(hidden.effect, ()), *SAME.get(hidden.effect + first, ()))
    return finding["effect"] in names and bool(set(finding["joints"]) & set(hidden.joints))


def _only_names(finding: dict[str, Any], hidden: Hidden, robot: Robot) -> bool:
    """Whether a finding is what is hidden, and its rivals are other names of the same torque."""

    def same(each: dict[str, Any]) -> bool:
        wider = hidden.effect in SAME.get(each["effect"], ())
        return (wider and bool({*each["joints"]} & {*hidden.joints})) or is_it(each, hidden, robot)

    rivals = finding["rivals"]
    return bool(rivals) and all(map(same, (finding, *rivals)))


def of_the_world(effect: str, off: float, hidden: Sequence[Hidden]) -> bool:
    """Whether a cause is true whatever is hidden: the given bodies and friction are off."""
    if effect in worlds.BODIES:
        return off > 0 or any(h.effect in worlds.BODIES for h in hidden)
    return effect in worlds.FRICTION and off > 0


def confusion(results: Sequence[dict[str, Any]]) -> str:
    """What is said where one effect is hidden: its verdict, and other names."""
    said = list[tuple[str, str]]()
    for r in results:
        [hidden], score = r["hidden"], r["score"]
        verdict = "named" if score["named"][0] else "undecided" if score["found"][0] else "missed"
        said.append((hidden["kind"], verdict))
        said += [(hidden["kind"], f"wrong: {x.partition('@')[0]}") for x in score["wrong"]]
    return pd.crosstab(*np.array(said).T, rownames=["hidden"], colnames=[""]).to_string()


def report(results: Sequence[dict[str, Any]]) -> Iterator[str]:
    yield _worlds(results)
    done = [r for r in results if "score" in r]
    groups = {c: [r["score"] for r in done if r["category"] == c] for c in CATEGORIES}
    outside, clean = groups["outside"], groups["nothing"]
    shown = [r for r in done if r["category"] == "set-up" and r["hidden"][0]["size"] >= BINS[1]]
    set_up = [r["score"] for r in shown]
    effects = [
        (h, r["score"]["named"][k], r["score"]["found"][k], r, r["score"]["settled"][k])
        for r in done
        if r["category"] in ("effects", "between")
        for k, h in enumerate(r["hidden"])
    ]
    large = [e for e in effects if e[0]["size"] >= BINS[2]]
    rows = (
        ("effects of at least 5 %: named", [e[1] for e in large]),
        ("  or only the name of that torque is open", [e[1] or e[4] for e in large]),
        ("effects of at least 5 %: named or undecided", [e[2] for e in large]),
        ("cases with a wrong name", [r["score"]["wrong"] for r in done]),
        ("set-up: the right name first", [s["first"] for s in set_up]),
        ("set-up: a wrong name beside", [s["wrong"] for s in set_up]),
        ("outside the vocabulary: unknown said there", [s["named"][0] for s in outside]),
        ("outside: the nearest name", [s["near"] for s in outside]),
        ("outside: a wrong name", [s["wrong"] for s in outside]),
        ("nothing hidden: no wrong name", [not s["wrong"] for s in clean]),
        ("nothing hidden: nothing open but the world's own", [s["silent"] for s in clean]),
        ("effects: a wrong name beside", [s["wrong"] for s in groups["effects"]]),
    )
    yield ""
    yield from (f"{label:44s} {wilson(hits):>12s} % of {len(hits)}" for label, hits in rows)
    if pairs := [pair for r in done for pair in r.get("settled", ())]:
        for how in sorted({pair["how"] for pair in pairs}):
            here = [pair["became"] for pair in pairs if pair["how"] == how]
            counts = [f"{x} {wilson([y == x for y in here])} %" for x in ("right", "wrong", "open")]
            yield f"undecided, to be settled by {how}: {len(here)}; {', '.join(counts)}"
    if done and all(len(r["hidden"]) == 1 for r in done):
        yield confusion(done)
    yield "\nsize [%]      effects     named [%]     found [%]"
    for low, high in itertools.pairwise(BINS):
        within = [e for e in effects if low <= e[0]["size"] < high]
        named, found = wilson([e[1] for e in within]), wilson([e[2] for e in within])
        yield f"{100 * low:3.0f} to {100 * high:3.0f} {len(within):10d} {named:>13s} {found:>13s}"
    for r in done:
        if wrong := r["score"]["wrong"]:
            what = ", ".join(h["kind"] for h in r["hidden"]) or "nothing"
            yield f"wrong: case {r['case']}, {what} in {r['world']}: {', '.join(wrong)}"
    failed = Counter(r["no_result"].splitlines()[0] for r in results if "no_result" in r)
    yield from (f"no result, {n} times: {why}" for why, n in failed.most_common())


def _worlds(results: Sequence[dict[str, Any]]) -> str:
    table: dict[str, dict[str, Any]] = {}
    for world in [*(", ".join(world) for world in WORLDS), "all"]:
        here = [r for r in results if world in ("all", r["world"])]
        scores = [r["score"] for r in here if "score" in r]
        table[world] = {
            "cases": len(here),
            "named [%]": wilson([hit for s in scores for hit in s["named"]]),
            "found [%]": wilson([hit for s in scores for hit in s["found"]]),
            "wrong [%]": wilson([s["wrong"] for s in scores]),
            "silent [%]": wilson([s["silent"] for s in scores if s["named"]]),
            "no result": len(here) - len(scores),
            "median s": f"{np.median([r['seconds'] for r in here]):.1f}" if here else "-",
        }
    return pd.DataFrame(table).T.to_string()


def main(
    *,
    count: int = 300,
    seed: int | None = None,
    case: int | None = None,
    jobs: int = 2,
    output: common.Output = None,
    differ: bool = False,
    settle: bool = False,
    kinds: Sequence[str] = (),
    sizes: tuple[float, float] = worlds.SIZES,
    arms: Sequence[str] = (),
) -> None:
    """Draw and diagnose arms.

    Args:
        count: Number of cases.
        case: Tell all of this case alone.
        differ: Hide an effect in the held-out recording alone, and tell what `identify` says of it.
        settle: Run the motions that are to settle what is undecided, and diagnose again with them.
        kinds: Hide one effect of these kinds in every case.
        sizes: Of the hidden effects.
        arms: Names of built-in ones, of which each case has one.
    """
    seed, asked = common.printed_seed(seed), Asked(differ, settle, kinds, sizes, arms)
    if case is not None:
        run(seed, case, asked, True)
        return
    begun = time.perf_counter()
    cases = [(seed, k, asked) for k in range(1, count + 1)]
    results = common.answers(run, cases, jobs, output)
    print("\n".join(report(results)))
    print(f"\n{count} cases in {(time.perf_counter() - begun) / 60:.1f} min")


if __name__ == "__main__":
    common.run(main)
