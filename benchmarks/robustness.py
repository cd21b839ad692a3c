"""Damaged inputs, extreme arms, limits and kills against what is promised; see README.md."""

import contextlib
import json
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from queue import Queue
from typing import Any, Literal

import common
import numpy as np
import pandas as pd
import psutil
import robustness_inputs as inputs
import yaml
from common import wilson

from excitant.cli import main as excitant
from excitant.design import load_trajectory
from excitant.exceptions import ExcitantError, FaultWarning
from excitant.identify import load_column_map, load_dataset, load_knowledge, load_recording
from excitant.interrupts import SIGNALS
from excitant.reports import load_run, page_of
from excitant.robots import Motion, load_limits, load_robot, torque
from excitant.robots.obstacles_file import load_obstacles

Rng = np.random.Generator
Array = np.ndarray
Files = dict[str, bytes]  # contents by name
Case = Iterator[tuple[str, str, str]]  # what was tried, its verdict, what was said

COUNTS = {"fuzz": 10_000, "arms": 200, "limits": 300, "kills": 100}  # of cases
HANG = {"fuzz": 60, "arms": 600, "limits": 120, "kills": 600}  # s of processor time
VERBS = 0.08  # share of commands among the damaged inputs; the others only read
WRONG, CLAIMED = 0.1, 3.0  # nrmse on an unseen motion, and times the one that was reported
MEMORY = 2.5  # GB of a process that runs cases; an idle one has 0.34, damaged inputs are small
ORPHANS, BEGINNING = 15.0, 0.1  # s: no process is left then; Python begins, SIGTERM ends it
GOOD = ("result", "refused")
RUN = {"result.json", "series.npz", "summary.txt", "report.html"}


# One command, and what is promised of it


def command(words: str, folder: Path | None) -> tuple[str, str]:
    """Verdict on a command run in this process, and its traceback or standard error."""
    for stream in (1, 2):
        os.ftruncate(stream, 0)
        os.lseek(stream, 0, os.SEEK_SET)
    status: int | str
    try:
        status = excitant(words.split())
    except SystemExit as end:
        status = int(end.code or 0)
    except Exception:
        status = traceback.format_exc()
    sys.stdout.flush()
    sys.stderr.flush()
    err = Path("/proc/self/fd/2").read_text(errors="replace")
    return verdict(status, err, folder), status if isinstance(status, str) else err


def verdict(status: int | str, err: str, folder: Path | None) -> str:
    """Result or refusal in one line, with the folder whole or absent; else what is broken."""
    lines = err.splitlines()
    if isinstance(status, str) or "Traceback" in err or "a bug (" in err:
        return "traceback"
    if "Warning" in err:
        return "warning on the terminal"
    refusals = [line for line in lines if line.startswith("excitant: ")]
    if status == 1 and len(refusals) > 1:
        return "several lines"
    if status not in (0, 1, 2):
        return f"status {status}"
    if folder is not None and (broken := half_written(folder)):
        return broken
    if folder is not None and status == 0 and not folder.exists():
        return "nothing written"
    return "refused" if status else "result"


def half_written(folder: Path) -> str:
    """What is wrong with the folder of a run; empty where it is whole or was never made."""
    if any(folder.parent.glob(".excitant-*")):
        return "staging left"
    if not folder.exists():
        return ""
    try:
        files = json.loads((folder / "result.json").read_text())["files"]
    except (OSError, ValueError, KeyError):
        return "half-written"
    whole = RUN | {Path(file).name for file in files} <= {path.name for path in folder.iterdir()}
    return "" if whole else "half-written"


def wrong_model(folder: Path, states: tuple[Array, ...], truth: Array) -> str:
    """How wrong a published model is on a motion that it never saw, if nothing was said of it."""
    result = json.loads((folder / "result.json").read_text())
    if not result["published"] or result["faults"] or result["notes"]:
        return ""
    motion = Motion(np.arange(len(truth), dtype=float), *states)
    missed = torque(load_robot(folder / "model.yaml"), motion) - truth
    spread = np.maximum(truth.std(axis=0), 1e-3 * truth.std(axis=0).max())
    error = np.sqrt(np.mean(missed**2, axis=0)) / spread
    claimed = np.array([j["validate"]["nrmse"] or 0.0 for j in result["joints"]])
    bad = error > np.maximum(WRONG, CLAIMED * claimed)
    names = [j["name"] for j in result["joints"]]
    return "; ".join(
        f"{name}: {e:.2f} where {c:.2f} was claimed"
        for name, e, c, b in zip(names, error, claimed, bad, strict=True)
        if b
    )


# Damaged inputs


def _recording(folder: Path, name: str, mapping: Any = None) -> object:
    return load_recording(folder / name, load_robot("planar_2r"), mapping=mapping)


def _robot(folder: Path, name: str) -> object:
    if name == "data/bars/parts/links.xacro":  # is included by this
        name = "data/bars/arm/bars.urdf.xacro"
    tip = {"data/twins.urdf": "left_hand", "data/gripper.xml": "left"}.get(name)
    return load_robot(folder / name, tip=tip, packages=[folder / "data" / "bars"])


READERS: dict[str, Callable[[Path, str], object]] = {
    **dict.fromkeys(("log.csv", "log.parquet", "log.npz", "log.mat", "log.csv.gz"), _recording),
    **dict.fromkeys(("log.jsonl", "log.bag", "ros/ros.mcap", "sql/sql.db3"), _recording),
    **dict.fromkeys(("planar.urdf", "arm.yaml", "model/model.yaml", "data/twins.urdf"), _robot),
    **dict.fromkeys(("data/gantry.urdf", "data/tree.urdf", "data/full.xml"), _robot),
    **dict.fromkeys(("data/slider.yaml", "data/slider.xml", "data/drill.yaml"), _robot),
    **dict.fromkeys(("data/gripper.xml", "data/pan_tilt.urdf.xacro"), _robot),
    **dict.fromkeys(("data/bars/arm/bars.urdf.xacro", "data/bars/parts/links.xacro"), _robot),
    **dict.fromkeys(
        ("columns.yaml", "ms.csv"),
        lambda folder, _: _recording(folder, "ms.csv", load_column_map(folder / "columns.yaml")),
    ),
    **dict.fromkeys(
        ("trajectory.csv", "trajectory.json"),
        lambda folder, name: load_trajectory(folder / name, load_robot("planar_2r")),
    ),
    **dict.fromkeys(
        ("model/result.json", "model/series.npz"),
        lambda folder, _: page_of(*load_run(folder / "model")),
    ),
    "limits.yaml": lambda folder, name: load_limits(folder / name, load_robot("planar_2r")),
    "cell.yaml": lambda folder, name: load_obstacles(folder / name),
    "known.yaml": lambda folder, name: load_knowledge(folder / name, load_robot("planar_2r").links),
    "set/dataset.json": lambda folder, _: load_dataset(folder / "set").recordings(["run1.csv"]),
}
"""Files, and what reads them."""

_RUNS, _MOVE = "planar_2r run1.csv --validate run2.csv", "planar_2r trajectory.json"
_SEARCH = "--harmonics 2 --duration 4 --starts 1 --jobs 1 --time-limit 1"
COMMANDS: dict[str, tuple[str, ...]] = {
    "robots arm.yaml": ("planar.urdf", "arm.yaml"),
    f"design arm.yaml {_SEARCH} --limits limits.yaml": ("planar.urdf", "arm.yaml", "limits.yaml"),
    f"design planar_2r {_SEARCH} --obstacles cell.yaml": ("cell.yaml",),
    "check planar_2r trajectory.csv --limits limits.yaml": ("trajectory.csv", "limits.yaml"),
    f"check {_MOVE}": ("trajectory.json",),
    f"simulate {_MOVE}": ("trajectory.json",),
    "analyze arm.yaml --trajectory trajectory.csv": ("planar.urdf", "trajectory.csv"),
    "analyze planar_2r --recording run1.csv": ("run1.csv",),
    f"identify {_RUNS}": ("run1.csv", "run2.csv"),
    f"identify {_RUNS} --knowledge known.yaml": ("known.yaml",),
    "identify set": ("set/run1.csv", "set/dataset.json"),
    "identify planar_2r run1.csv": ("run1.csv",),
    "identify arm.yaml run1.csv --validate run2.csv": ("planar.urdf", "arm.yaml"),
    "diagnose planar_2r run1.csv --no-experiments": ("run1.csv",),
    "go planar_2r run1.csv": ("run1.csv",),
    f"rehearse {_MOVE}": ("trajectory.json",),
    "report model": ("model/result.json", "model/series.npz"),
}
"""Commands, and the files of them that are damaged."""


def fuzz(rng: Rng, folder: Path, corpus: Path) -> Case:
    """A file is damaged and read, or given to a command."""
    shutil.copytree(corpus, folder, dirs_exist_ok=True)
    line = str(rng.choice([*COMMANDS])) if rng.random() < VERBS else ""
    name = str(rng.choice([*(COMMANDS[line] if line else READERS)]))
    kind = damage(rng, folder / name)
    before = {*folder.rglob("*")}
    what = f"{line or 'read'}: {name} {kind}"
    if line:
        into = {"simulate": "out.csv", "report": ""}.get(line.split()[0], "out")
        own = folder / "out" if into == "out" else None
        found, said = command(f"{line} -o {into}" if into else line, own)
        recorded = line.startswith("identify") and name.endswith(".csv")
        if recorded and found == "result":
            arm = inputs.planar(load_robot("planar_2r").urdf)
            wrong = wrong_unseen(rng, arm, folder / "out")
            found, said = ("wrong in silence", wrong) if wrong else (found, said)
    else:
        found, said = attempt(partial(READERS[name], folder, name))
    new = {path.name for path in {*folder.rglob("*")} - before if "out" not in str(path)}
    if "ran" in new:
        found = "code was run"
    elif found in GOOD and new and line != "report model":
        found, said = "stray files", " ".join(sorted(new))
    yield what, found, said


def damage(rng: Rng, path: Path) -> str:
    """Damage a file as its kind can be damaged; how, in a word."""
    content = path.read_bytes()
    if path.name.startswith("run") and rng.random() < 0.8:
        words, table = inputs.damaged_table(rng, pd.read_csv(path))
        table.to_csv(path, index=False)
        return words
    binary = b"\0" in content or rng.random() < 0.1
    path.write_bytes((inputs.damaged_bytes if binary else inputs.damaged_text)(rng, content))
    return "bytes" if binary else "words"


def attempt(read: Callable[[], object]) -> tuple[str, str]:
    """Whether a reader gives a result or refuses in one line, without another word."""
    os.ftruncate(2, 0)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.simplefilter("ignore", FaultWarning)
            read()
    except ExcitantError as error:
        return ("several lines" if "\n" in str(error) else "refused"), str(error)
    except Exception:
        return "traceback", traceback.format_exc()
    sys.stderr.flush()
    noise = Path("/proc/self/fd/2").read_text(errors="replace")
    return ("noise of a library", noise) if noise else ("result", "")


def wrong_unseen(rng: Rng, arm: inputs.ExtremeArm, folder: Path) -> str:
    """How wrong a published model is on a motion by chance of the true arm."""
    states = inputs.motion(rng, np.arange(0, 10, 0.02), arm.scale)
    return wrong_model(folder, states, arm.torque(states))


# Extreme arms


def arms(rng: Rng, folder: Path, _: Path) -> Case:
    """Every verb on one extreme arm."""
    arm, t = inputs.extreme_arm(rng), np.arange(0, 12, 0.01)
    for name, text in arm.files.items():
        (folder / name).write_text(text)
    for name in ("run1", "run2"):
        table = arm.table(rng, t, inputs.motion(rng, t, arm.scale))
        table.to_csv(folder / f"{name}.csv", index=False)
    search = "--harmonics 3 --duration 6 --starts 1 --jobs 1 --time-limit 4 --ignore-collisions"
    move, runs = "arm.yaml design/trajectory.json", "arm.yaml run1.csv --validate run2.csv"
    lines = {
        "robots": "robots arm.yaml",
        "analyze": "analyze arm.yaml",
        "design": f"design arm.yaml {search}",
        "check": f"check {move} --ignore-collisions",
        "simulate": f"simulate {move} -o simulated.csv",
        "identify": f"identify {runs}",
        "auto": f"identify {runs} --effects auto",
        "diagnose": f"diagnose {runs} --no-experiments",
        "rehearse": f"rehearse {move}",
        "report": "report identify",
    }
    needs = dict.fromkeys(("check", "simulate", "rehearse"), "design") | {"report": "identify"}
    for verb, line in lines.items():
        if not (folder / needs.get(verb, "")).exists():
            continue
        own = folder / verb if verb not in ("simulate", "report") else None
        found, said = command(f"{line} -o {verb}" if own else line, own)
        if found == "refused" and verb in ("check", "rehearse") and (folder / verb).exists():
            found = "result"  # it was not passed
        if found == "result" and (wrong := _wrong_of_arm(rng, arm, folder, verb)):
            found, said = "wrong in silence", wrong
        yield f"{verb}: {arm.words}", found, said


def _wrong_of_arm(rng: Rng, arm: inputs.ExtremeArm, folder: Path, verb: str) -> str:
    if verb in ("identify", "auto"):
        return wrong_unseen(rng, arm, folder / verb)
    if verb == "diagnose":
        findings = json.loads((folder / verb / "result.json").read_text())["findings"]
        true = {"friction", "inertial_parameters", "payload", "rotor_inertia"}
        names = {f["effect"] for f in findings if f["verdict"] == "named"}
        wrong = sorted(n for n in names - true if not n.endswith("_friction"))
        return f"{', '.join(wrong)} named, which is not there" if wrong else ""
    return ""


# Limits


BUILT_IN = ("planar_2r", "ur10", "panda", "puma560", "scara")


def limits(rng: Rng, folder: Path, _: Path) -> Case:
    """A design within drawn limits, judged at 10 kHz by its file, differences and Pinocchio."""
    arm = load_robot(name := str(rng.choice(BUILT_IN)))
    low, high = np.clip(arm.limits.position, -3, 3).T
    middle, half = (low + high) / 2, (high - low) / 2 * rng.uniform(0.05, 1, arm.nv)
    middle = middle + (((high - low) / 2) - half) * rng.uniform(-1, 1, arm.nv)
    speed = np.minimum(arm.limits.velocity, 4.0) * 10 ** rng.uniform(-1.5, 0, arm.nv)
    given: dict[str, Array] = {
        "position": np.column_stack([middle - half, middle + half]),
        "velocity": speed,
        "acceleration": speed * 10 ** rng.uniform(0, 1.3, arm.nv),
    }
    if rng.random() < 0.4:
        given["jerk"] = given["acceleration"] * 10 ** rng.uniform(0.3, 1.5, arm.nv)
    if rng.random() < 0.6:
        given["torque"] = np.minimum(arm.limits.torque, 1e3) * rng.uniform(0.2, 1, arm.nv)
    file = {quantity: value.tolist() for quantity, value in given.items()}
    (folder / "limits.yaml").write_text(yaml.safe_dump(file))
    harmonics, duration = int(rng.integers(2, 6)), int(rng.integers(4, 13))
    line = (
        f"design {name} --limits limits.yaml --harmonics {harmonics} --rate 10000"
        f" --duration {duration} --starts 1 --jobs 1 --time-limit 3 --ignore-collisions --use 1"
    )
    found, said = command(f"{line} -o out", folder / "out")
    if found == "result":
        beyond = violations(arm, given, folder / "out" / "trajectory.csv")
        found, said = ("limit violated", beyond) if beyond else ("result", "")
    yield f"{line}: {', '.join(given)}", found, said


def violations(arm: Any, given: dict[str, Array], file: Path) -> str:
    """Limits that the samples of a trajectory exceed, derivatives by differences too."""
    table = np.loadtxt(file, delimiter=",", skiprows=1)
    t, (q, dq, ddq) = table[:, 0], np.split(table[:, 1:], 3, axis=1)
    step = t[1] - t[0]
    rnea = inputs.simulated(arm.model, (q, dq, ddq))
    tau = rnea + sum(e.torque(arm, Motion(t, q, dq, ddq)) for e in arm.effects)
    low, high = given["position"].T
    used = {
        "position": np.abs(q - (low + high) / 2) / ((high - low) / 2),
        "velocity": np.abs(dq) / given["velocity"],
        "velocity of positions": np.abs(np.diff(q, axis=0)) / step / given["velocity"],
        "acceleration": np.abs(ddq) / given["acceleration"],
        "acceleration of speeds": np.abs(np.diff(dq, axis=0)) / step / given["acceleration"],
        "torque": np.abs(tau) / given.get("torque", arm.limits.torque),
    }
    if "jerk" in given:
        used["jerk"] = np.abs(np.diff(ddq, axis=0)) / step / given["jerk"]
    rounding = 1e-6  # of a difference of two numbers in a file
    worst = {name: float(use.max()) for name, use in used.items()}
    return "; ".join(f"{name} {use:.8f}" for name, use in worst.items() if use > 1 + rounding)


# Kills

_MADE = "planar_2r --harmonics 3 --duration 6 --starts 4 --jobs 2"
KILLED = {  # the command, and what makes an old run and a new one of it
    "robots": ("robots planar_2r", "--mass 8", "--mass 9"),
    "design": (f"design {_MADE}", "--seed 1", "--seed 2"),
    "check": ("check planar_2r", "trajectory.json", "trajectory.csv"),
    "simulate": (f"simulate {_MOVE}", "--seed 1", "--seed 2"),
    "analyze": ("analyze planar_2r", "", "--trajectory trajectory.csv"),
    "identify": (f"identify {_RUNS}", "--cutoff 8", "--cutoff 9"),
    "diagnose": (f"diagnose {_RUNS} --no-experiments", "--cutoff 8", "--cutoff 9"),
    "rehearse": (f"rehearse {_MOVE}", "--seed 1", "--seed 2"),
    "report": ("report", "model set/model", "set/model model"),
    "go": (f"go {_RUNS}", "--cutoff 8", "--cutoff 9"),
    "show": ("show planar_2r", "trajectory.json", "trajectory.csv"),
    "demo": ("demo --robot planar_2r", "--seed 1", "--seed 2"),
}


def kills(rng: Rng, folder: Path, corpus: Path, verb: str = "") -> Case:
    """A command is ended at a random moment, over an old run or none, and then run again."""
    shutil.copytree(corpus, folder, dirs_exist_ok=True)
    shutil.copytree(folder / "model", folder / "set" / "model")
    verb = verb or str(rng.choice([*KILLED]))
    line, old, new = KILLED[verb]
    out = folder / "out"
    into = {"simulate": "-o out/run.csv", "show": "-o out/run.html"}.get(verb, "-o out")
    begun = time.monotonic()
    status, err, _ = ended(f"{line} {old} {into}", folder)
    took = time.monotonic() - begun
    before = contents(out)
    if not before:
        yield f"{verb}: before", "nothing written", f"status {status}: {err}"
        return
    if fresh := rng.random() < 0.5:
        shutil.rmtree(out)
    how = signal.Signals(rng.choice([signal.SIGKILL, *SIGNALS]))
    after = float(rng.uniform(0, 1.05 * took))
    status, err, orphans = ended(f"{line} {new} {into}", folder, how, after)
    amid, whole = contents(out), into != "-o out" or not half_written(out)
    status_again, err_again, _ = ended(f"{line} {new} {into}", folder)
    again = contents(out)
    left = [path.name for path in folder.glob(".excitant-*")]
    found = "refused" if status else "result"
    unheard = status in (-signal.SIGTERM, -signal.SIGHUP) and after < BEGINNING
    if orphans:
        found = "orphan"
    elif unheard or "Fatal Python error: init_" in err:  # Python itself had not begun yet
        found = "refused"
    elif "Traceback" in err or "a bug (" in err:
        found = "traceback"
    elif how != signal.SIGKILL and status not in (0, 1, 130):
        found = f"status {status}"
    elif amid and not (whole or (how == signal.SIGKILL and not (RUN - {*amid}))):
        found = "half-written"
    elif amid and not fresh and mixed(before, amid, again):
        found = "mixed"
    elif status_again not in (0, 1) or not again or left:
        found, err = "not run again", f"status {status_again}, {left}: {err_again}"
    where = "a fresh folder" if fresh else "an old run"
    yield f"{verb}: {how.name} after {after:.2f} of {took:.2f} s, over {where}", found, err


def mixed(before: Files, amid: Files, again: Files) -> bool:
    """Whether a folder holds some files of an old run and some of the new one."""
    changing = {name for name in {*before, *again} if before.get(name) != again.get(name)}
    untouched = {name for name in changing if amid.get(name) == before.get(name)}
    return untouched not in (set(), changing)


def contents(folder: Path) -> Files:
    return {path.name: path.read_bytes() for path in folder.glob("*") if path.is_file()}


def ended(
    words: str, folder: Path, how: signal.Signals | None = None, after: float = 0.0
) -> tuple[int, str, list[str]]:
    """Exit status and error stream of a command that may be ended, and processes it left."""
    with (folder / "stderr").open("w+") as err:
        process = subprocess.Popen(
            [sys.executable, "-m", "excitant", *words.split()], cwd=folder, stderr=err,
            stdout=subprocess.DEVNULL, start_new_session=True,
            preexec_fn=lambda: [signal.signal(number, signal.SIG_DFL) for number in SIGNALS],
        )  # fmt: skip
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(after if how else None)
        if how and process.poll() is None:
            # Ctrl-C is heard by all processes at a terminal
            (os.killpg if how == signal.SIGINT else os.kill)(process.pid, how)
            process.wait(HANG["kills"])
        end = time.monotonic() + ORPHANS
        while (family := session(process.pid)) and time.monotonic() < end:
            time.sleep(0.1)
        orphans = [" ".join(each.cmdline()[-3:]) for each in family]
        for each in family:
            each.kill()
        err.seek(0)
        return process.returncode, err.read(), orphans


def session(leader: int) -> list[psutil.Process]:
    """Living processes of a session."""
    found = []
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error, ProcessLookupError, PermissionError):
            if os.getsid(process.pid) == leader and process.status() != psutil.STATUS_ZOMBIE:
                found.append(process)
    return found


# The campaign

PARTS = {part.__name__: part for part in (fuzz, arms, limits, kills)}


def serve(part: str, seed: str, corpus: str, keep: str) -> None:
    """Run the cases of a part whose numbers stand on standard input, and print their answers.

    A case that takes too long, by processor time or by the clock, ends the process.
    """
    todo, answers = os.fdopen(os.dup(0)), os.fdopen(os.dup(1), "w")
    with tempfile.TemporaryDirectory() as home:
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for stream in (1, 2):
            with (Path(home) / str(stream)).open("w+") as file:
                os.dup2(file.fileno(), stream)
        for number in todo:
            usage = resource.getrusage(resource.RUSAGE_SELF)
            spent = int(usage.ru_utime + usage.ru_stime) + 1
            resource.setrlimit(resource.RLIMIT_CPU, (spent + HANG[part], resource.RLIM_INFINITY))
            signal.alarm(10 * HANG[part])
            folder = Path(keep or Path(home) / "case")
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            os.chdir(folder)
            rng = np.random.default_rng([int(seed), [*PARTS].index(part), int(number)])
            for answer in PARTS[part](rng, folder, Path(corpus)):
                peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
                print(json.dumps([*answer, peak]), file=answers, flush=True)
            print("null", file=answers, flush=True)
            os.chdir(home)


def attend(about: Sequence[object], queue: Queue[int | None], note: Callable[..., None]) -> None:
    """Have a process run cases of a queue; when it hangs or dies, another takes its place."""
    process = None
    for case in iter(queue.get, None):
        process = process or subprocess.Popen(
            [sys.executable, __file__, "serve", *map(str, about)], text=True, bufsize=1,
            stdin=subprocess.PIPE, stdout=subprocess.PIPE,
        )  # fmt: skip
        last = ""
        with contextlib.suppress(BrokenPipeError):
            process.stdin.write(f"{case}\n")
        for line in iter(process.stdout.readline, "null\n"):
            if not line:
                code = process.wait()
                hung = -code in (signal.SIGXCPU, signal.SIGALRM)
                note(case, "the worker", "hang" if hung else "crash", f"after '{last}': {code}")
                process = None
                break
            answer = json.loads(line)
            note(case, *answer)
            last = answer[0]
    if process:
        process.communicate()


def campaign(
    part: str, cases: Sequence[int], about: Sequence[object], jobs: int, output: Path | None
) -> list[dict[str, Any]]:
    """All cases of a part, each with its verdict."""
    queue, results = Queue[int | None](), list[dict[str, Any]]()
    for case in (*cases, *[None] * jobs):
        queue.put(case)

    def note(case: int, what: str, found: str, said: str, peak: float = 0.0) -> None:
        found = "memory" if found in GOOD and peak > MEMORY else found
        entry = {"part": part, "case": case, "what": what, "found": found, "said": said}
        common.note(entry | {"peak": peak}, results, output)

    with ThreadPoolExecutor(jobs) as pool:
        for worker in [pool.submit(attend, (part, *about), queue, note) for _ in range(jobs)]:
            worker.result()
    return results


def report(part: str, results: Sequence[dict[str, Any]]) -> Iterator[str]:
    n, counts = len(results), Counter(each["found"] for each in results)
    yield f"\n{part}: {n} answers to {len({each['case'] for each in results})} cases"
    broken = sum(count for word, count in counts.items() if word not in GOOD)
    for word, count in [*counts.most_common(), ("broken in any way", broken)]:
        yield f"  {word:24s} {count:6d} {wilson([True] * count + [False] * (n - count), 2):>20s} %"
    verbs = Counter((each["what"].split(":")[0].split()[0], each["found"]) for each in results)
    told = [f"{verb} {n} {word}" for (verb, word), n in sorted(verbs.items())]
    yield "  " + ", ".join(told)
    yield f"  peak memory {max((each['peak'] for each in results), default=0.0):.2f} GB"
    for each in results:
        if each["found"] not in GOOD:
            yield f"  {part} --case {each['case']}: {each['what']}: {each['found'].upper()}"
            yield "    " + "\n    ".join(each["said"].strip().splitlines()[-6:])


def main(
    *parts: Literal["fuzz", "arms", "limits", "kills"],
    count: int | None = None,
    seed: int | None = None,
    case: int | None = None,
    keep: Path | None = None,
    jobs: int = 2,
    output: common.Output = None,
) -> int:
    """Try promises at random; exit status 1 where one is broken.

    Args:
        parts: What to try; all by default.
        count: Number of cases of each part; by default 10 000, 200, 300 and 100.
        case: Only this case of the parts that are named.
        keep: Folder in which the files of a case are left.
    """
    seed = common.printed_seed(seed)
    every = list[dict[str, Any]]()
    with tempfile.TemporaryDirectory() as home:
        corpus = Path(home) / "corpus"
        with contextlib.redirect_stdout(None):
            inputs.write_corpus(corpus)
        for part in parts or PARTS:
            begun = time.perf_counter()
            cases = range(1, (count or COUNTS[part]) + 1) if case is None else [case]
            about = (seed, corpus, keep.resolve() if keep else "")
            results = campaign(part, cases, about, jobs, output)
            print(*report(part, results), sep="\n")
            print(f"  {(time.perf_counter() - begun) / 60:.1f} min", flush=True)
            every += results
    return int(any(each["found"] not in GOOD for each in every))


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        serve(*sys.argv[2:])
    else:
        common.run(main)
