"""What every verb says today, stored; and what another version of the code says otherwise.

    PYTHONPATH=TREE/src python benchmarks/freeze.py run OUT.json [--jobs 2] [--only TEXT] [--quick]
    python benchmarks/freeze.py compare A.json B.json [--rtol 1e-6]

Stored are of each command its exit status, the last line of its errors, the leaves of result.json
(else what it prints) but ``wall_s``, and the lines of summary.txt. A number may change by rtol of
the largest in its list, or of a thousandth of the largest on paths like its own.
"""

from __future__ import annotations

import json
import os
import re
import resource
import subprocess
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pandas as pd
from cyclopts import App

DATA = Path(os.environ.get("EXCITANT_DATA", Path(__file__).parents[2] / "shared" / "data"))
SETS = {
    "ur10": "data/ur10 unisa_exciting",
    "dualarm": "data/dualarm_v2 exc_13p5 --validate exc_52p2",
    "ur10e": "data/ur10e id_8harm_20s --validate val_ptp_10_points",
    "rokae": "data/rokae_xmate3 rec02",
    "panda": "data/panda gaz_traj1",
    "gen3": "data/gen3_joints joint2_alone exc01 --validate exc02 --map ms.yaml",
    "lwa4p": "data/lwa4p rec01 rec02 rec05 --validate rec06",
    "bam": "dh.yaml data/bam_xl330/rec01.parquet --validate data/bam_xl330/rec13.parquet --map pwm",
}
EACH = "; ".join(SETS.values())
DEMOS = """planar_2r; scara; cylindrical; ur3e --tip forearm_link; so100 --joints pitch,elbow;
    panda --joints panda_joint2,panda_joint4; cmu_dd_arm_ii --joints joint1,joint2; gen3 --joints
    joint_2,joint_4; iiwa14 --joints joint_4,joint_6; puma560 --joints joint2,joint3"""
COMMANDS = {  # names of commands and of their folders: verb-0, verb-1 and so on
    "design --seed 0 --jobs 1": """planar_2r --starts 1 --periods 1 --duration 8 --harmonics 4;
        ur10 --starts 4 --formats urscript; panda --starts 2; cmu_dd_arm_ii --starts 3; planar_2r
        --link-by-link --starts 1; planar_2r --starts 1 --periods 1 --harmonics search --noise 2,1;
        planar_2r --starts 4 --from 0.1,0 --formats ros2,npz --repeat 2; scara --starts 2 --series
        spline --criterion d --columns inertial --periods 1""",
    "simulate --json": """planar_2r design-0/trajectory.csv --hidden --seed 3;
        ur10 design-1/trajectory.json --hidden; ur10 design-1/trajectory.json --seed 2""",
    "diagnose": f"{EACH}; ".replace(";", " --no-experiments;") + "planar_2r simulate-0/run.csv",
    "go": "{ur10}; {panda}; {lwa4p} --repair",
    "demo --seed {k} --robot": f"{DEMOS}; {DEMOS}; ur10",
    "identify": f"""{EACH}; {{ur10}} --estimator irls; {{ur10}} --estimator iv;
        {{ur10}} --estimator oe; {{ur10}} --online --forgetting 5; {{dualarm}} --link-by-link;
        {{panda}} --payload; {{ur10e}} --payload --unloaded id_0131_unloaded; data/lwa4p rec03;
        {{ur10}} --effects auto; {{panda}} --cutoff 5 --effects auto; {{ur10}} --estimator best;
        {{ur10}} --mujoco --length-std 0.002 --formats mjcf,sdf,ros2_control;
        {{ur10}} --effects viscous_friction,spring --force; data/gen3_joints exc01 exc02 --repair;
        data/ur10e id_12harm_30s id_12harm_40s --validate id_12harm_50s;
        ur10 simulate-1/run.csv --validate simulate-2/run.csv""",
    "rehearse": "planar_2r design-0/trajectory.json; ur10 design-1/trajectory.json --seed 1",
    "fleet": "cells --jobs 1",
    "analyze": """ur10; panda --columns inertial; puma560; data/ur10 --recording unisa_exciting;
        cmu_dd_arm_ii --moving joint1,joint3 --frames dh; data/rokae_xmate3 --recording rec02;
        data/ur10e --recording id_8harm_20s; ur10 --trajectory design-1/trajectory.json;
        panda --trajectory design-2/trajectory.csv; cmu_dd_arm_ii --trajectory
        design-3/trajectory.json; planar_2r --trajectory design-0/trajectory.json --noise 1,0.5""",
    "check": """planar_2r design-0/trajectory.json; ur10 design-1/trajectory.json --floor 0.5;
        panda design-2/trajectory.csv --mass-uncertainty 10 --window 2""",
    "show --json": "planar_2r design-0/trajectory.json; ur10 design-1/trajectory.json",
    "report": "identify-0 identify-8 -o report-0; analyze-0 --tables csv",
    "robots": """; --json; ur10 --mass 30; ur11; ur10 --json; panda --json; puma560 --json;
        cmu_dd_arm_ii --json; identify-0/identified.urdf --json; identify-0/model.yaml --json""",
    "completion": "bash",
}
ENDS = {"simulate": "-o {name}/run.csv", "show": "-o {name}/motion.html"}
ENDS |= {"report": "", "robots": "", "completion": ""}
FILES = {
    "ms.yaml": "units: {t: ms}",
    "pwm": "{tau: 'pwm{1}', units: {tau: 0.00109}}",
    "dh.yaml": """{convention: standard, gravity: [9.81, 0, 0], limits: {velocity: 20, torque: 2},
        dh: [{a: 0.1, m: 0.49, com: [0, 0, 0], Ic: {xx: 2.0e-4, yy: 2.0e-4, zz: 2.0e-4}}]}""",
}  # beside the recordings
NAMES = ("name", "expression", "link", "effect", "joint", "joints", "label", "fault", "recording")
ROUNDING = 1e-12  # SI, below which a number is nothing but rounding
app = App(help=__doc__, help_format="plaintext", result_action="return_value")


def commands() -> dict[str, list[str]]:
    """Words of every command by its name."""
    found = {}
    for start, text in COMMANDS.items():
        verb = start.partition(" ")[0]
        for k, said in enumerate(text.split(";")):
            line = f"{start} {said} {ENDS.get(verb, '-o {name}')}"
            found[f"{verb}-{k}"] = line.format(name=f"{verb}-{k}", k=k, **SETS).split()
    return found


def prepare(folder: Path) -> None:
    """Write what commands read: files beside the recordings, and a cell at two dates."""
    (folder / "data").symlink_to(DATA)
    for name, text in FILES.items():
        (folder / name).write_text(text, "utf-8")
    table = pd.read_parquet(DATA / "ur10" / "unisa_exciting.parquet")
    for day in (1, 2):
        cell = folder / "cells" / "cell1" / f"2026-03-0{day}"
        cell.mkdir(parents=True)
        (cell / "robot.urdf").symlink_to(DATA / "ur10" / "robot.urdf")
        table[day - 1 :: 2].to_csv(cell / "run.csv", index=False)


def leaves(content: Any, path: str) -> Iterator[tuple[str, Any]]:
    """Paths and values of plain content; entries of a list by name where names tell them apart."""
    if isinstance(content, dict) and content:
        for key in content:
            if key != "wall_s":
                yield from leaves(content[key], f"{path}.{key}")
    elif isinstance(content, list) and any(type(each) not in (int, float) for each in content):
        entries = [entry if isinstance(entry, dict) else {} for entry in content]
        labels = [" ".join(str(e[key]) for key in NAMES if e.get(key)) for e in entries]
        if "" in labels or len({*labels}) < len(labels):
            labels = [str(k) for k in range(len(content))]
        yield f"{path}.order", ", ".join(labels)
        for label, entry in zip(labels, content, strict=True):
            yield from leaves(entry, f"{path}[{label.replace(']', ')')}]")
    else:
        yield path, [content] if type(content) in (int, float) else content


def perform(words: list[str], folder: Path, before: list[Future[Any]]) -> Any:
    """What a command comes to, once others are done."""
    wait(before)
    line = [sys.executable, "-m", "excitant", *words]
    began = time.monotonic()
    ran = subprocess.run(line, cwd=folder, capture_output=True, text=True, check=False)
    seconds = round(time.monotonic() - began, 1)
    print(f"{seconds:6.1f} s, exit {ran.returncode}: {' '.join(words)}", flush=True)
    result = folder / words[-1] / "result.json"
    text = result.read_text("utf-8") if result.exists() else ran.stdout
    found = {"words": " ".join(words), "status": [ran.returncode]}
    found["stderr"] = ran.stderr.strip().rpartition("\n")[2]
    found |= leaves(json.loads(text) if text.startswith("{") else text.splitlines(), "result")
    if result.exists():
        lines = result.with_name("summary.txt").read_text("utf-8").splitlines()
        found |= leaves([" ".join(each.split()) for each in lines], "summary")
    plain = json.dumps(found).replace(f"{folder}/", "").replace(str(DATA), "data")
    return {"seconds": seconds, "leaves": json.loads(plain)}


@app.command
def run(out: Path, *, jobs: int = 2, only: str = "", quick: bool = False) -> None:
    """Store what commands come to whose name has a pattern in it; quick: the first of each verb."""
    every = commands()
    reads = {name: {word.partition("/")[0] for word in every[name][1:]} for name in every}
    chosen = [n for n in every if re.search(only, n) and (n.endswith("-0") or not quick)]
    for name in chosen:
        chosen += [each for each in every if each in reads[name] and each not in chosen]
    print(f"{len(chosen)} commands of {find_spec('excitant')}", flush=True)
    os.environ["LOKY_MAX_CPU_COUNT"] = "1"  # commands run side by side, not their parts
    known: dict[str, Future[Any]] = {}
    with tempfile.TemporaryDirectory() as made, ThreadPoolExecutor(jobs) as pool:
        folder = Path(made).resolve()
        prepare(folder)
        for name in (name for name in every if name in chosen):
            before = [known[each] for each in reads[name] if each in known]
            known[name] = pool.submit(perform, every[name], folder, before)
        stored = {name: each.result() for name, each in known.items()}
    total = sum(len(each["leaves"]) for each in stored.values())
    used = sum(resource.getrusage(resource.RUSAGE_CHILDREN)[:2])
    print(f"{total} leaves; {used:.0f} s of processors")
    out.write_text(json.dumps(stored, indent=0, ensure_ascii=False), "utf-8")


def differences(old: dict[str, Any], new: dict[str, Any], rtol: float) -> dict[str, list[str]]:
    """Leaves that changed, were lost and were added, by what happened and the kind of path."""
    kinds = {path: re.sub(r"\[[^]]*\]", "[*]", path) for path in old | new}
    sizes = {path: max(map(abs, a), default=0.0) for path, a in old.items() if isinstance(a, list)}
    largest = defaultdict[str, float](float)
    for path, size in sizes.items():
        largest[kinds[path]] = max(largest[kinds[path]], size)
    found = defaultdict[str, list[str]](list)
    for path, kind in kinds.items():
        a = old.get(path)
        b = new.get(path)
        same = a == b
        if isinstance(a, list) and isinstance(b, list) and len(a) == len(b):
            room = ROUNDING + rtol * max(sizes[path], 1e-3 * largest[kind])
            same = all(abs(x - y) <= room for x, y in zip(a, b, strict=True))
        what = "changed" if path in old and path in new else "lost" if path in old else "added"
        if what != "changed" or not same:
            found[f"{what} {kind}"].append(f"{path}: {a!s:.70} -> {b!s:.70}")
    return found


@app.command
def compare(first: Path, second: Path, *, rtol: float = 1e-6) -> int:
    """Print what differs in the commands that two files have in common; 1 if anything does."""
    old = json.loads(first.read_text("utf-8"))
    new = json.loads(second.read_text("utf-8"))
    counts = Counter[str]()
    for name in (name for name in old if name in new):
        found = differences(old[name]["leaves"], new[name]["leaves"], rtol)
        own = Counter(kind.partition(" ")[0] for kind, each in found.items() for _ in each)
        lines = sorted(f"  {kind} ({len(each)}), {each[0]}" for kind, each in found.items())
        head = f"{name}, {new[name]['leaves']['words']}: {dict(own)}, {len(lines)} kinds"
        if lines:
            print(head, *lines[:12], sep="\n")
        counts += own
    print(f"{len(old.keys() & new.keys())} commands: {dict(counts) if counts else 'unchanged'}")
    print(f"not in both files: {', '.join(sorted(old.keys() ^ new.keys())) or 'none'}")
    return int(bool(counts))


if __name__ == "__main__":
    raise SystemExit(app())
