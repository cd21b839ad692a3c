"""Results before and after a change of structure: freeze them, then compare.

    python benchmarks/golden.py inputs FOLDER          trajectories and recordings of virtual arms
    python benchmarks/golden.py freeze FOLDER OUT      result.json of each case into OUT
    python benchmarks/golden.py compare OLD NEW        what differs

``--only PREFIX`` keeps the cases whose name starts so. Inputs are made once, by the code that is
frozen; both sides read the same files.
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

DATA = Path(os.environ.get("EXCITANT_DATA", "../shared/data")).resolve()
TOLERANCE = 1e-6
IGNORED = {"wall_s", "files", "version", "command", "created", "seconds", "duration_s", "inputs"}
ARMS = ("planar_2r", "puma560", "ur10", "panda")
SEEDS = range(1, 6)


def cases(inputs: Path) -> dict[str, list[str]]:
    """Command line of each case, by its name."""

    def data(name: str, *recordings: str) -> list[str]:
        return [str(DATA / name), *recordings]

    sets = {
        "ur10": data("ur10"),
        "panda": data("panda", "unisa_exciting.parquet"),
        "ur10e": [
            *data(
                "ur10e", "id_10harm_20s.parquet", "id_8harm_20s.parquet", "id_12harm_30s.parquet"
            ),
            *("--validate", "id_12harm_50s.parquet"),
        ],
        "dualarm": data("dualarm_v2", "exc_13p5.parquet", "exc_15p7.parquet"),
        "xmate": data("rokae_xmate3", "rec01.parquet"),
        "pendulum": data("bam_xl330", "rec01.parquet", "rec02.parquet"),
    }
    found = {}
    for name, arguments in sets.items():
        found[f"identify/{name}"] = ["identify", *arguments, "--estimator", "wls"]
        found[f"diagnose/{name}"] = ["diagnose", *arguments, "--no-experiments"]
    found["auto/ur10"] = ["identify", *sets["ur10"], "--estimator", "wls", "--effects", "auto"]
    found["modes/links"] = ["identify", *sets["ur10"], "--link-by-link"]
    found["modes/online"] = ["identify", *sets["ur10"], "--online"]
    found["modes/analyze"] = [
        "analyze",
        str(DATA / "ur10"),
        "--recording",
        "unisa_exciting.parquet",
    ]
    for arm in ("planar_2r", "cmu_dd_arm_ii", "scara", "panda"):
        found[f"analyze/{arm}"] = ["analyze", arm]
    found["analyze/seed"] = ["analyze", "cmu_dd_arm_ii", "--moving", "joint1,joint3"]
    for arm in ("planar_2r", "cmu_dd_arm_ii", "ur10", "panda"):
        found[f"design/{arm}"] = ["design", arm, "--starts", "2", "--jobs", "1", "--seed", "1"]
    for arm in ARMS:
        for seed in SEEDS:
            recording = str(inputs / f"{arm}-{seed}.parquet")
            found[f"hidden/{arm}-{seed}"] = ["diagnose", arm, recording, "--no-experiments"]
    return found


def excitant(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command line."""
    command = [sys.executable, "-m", "excitant", *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=False, timeout=1800)


def make_inputs(folder: Path) -> None:
    """A designed motion per arm, and recordings of virtual arms that hide something."""
    folder.mkdir(parents=True, exist_ok=True)
    for arm in ARMS:
        run = folder / arm
        trajectory = run / "trajectory.json"
        if not trajectory.exists():
            design = excitant(
                *("design", arm, "--starts", "1", "--jobs", "1", "--duration", "15"),
                *("--time-limit", "40", "-o", str(run)),
            )
            print(arm, design.returncode, design.stderr[-300:])
        for seed in SEEDS:
            target = folder / f"{arm}-{seed}.parquet"
            if not target.exists():
                excitant(
                    *("simulate", arm, str(trajectory), "--hidden", "--seed", str(seed)),
                    *("-o", str(target)),
                )


def freeze(inputs: Path, out: Path, only: str) -> None:
    """Run each case and keep what its result.json says."""
    out.mkdir(parents=True, exist_ok=True)
    for name, arguments in cases(inputs).items():
        target = out / f"{name.replace('/', '-')}.json"
        if name.startswith(only) and not target.exists():
            scratch = out / "run" / name.replace("/", "-")
            run = excitant(*arguments, "--json", "-o", str(scratch))
            text = (
                run.stdout
                if run.stdout.startswith("{")
                else json.dumps({"error": run.stderr[-400:]})
            )
            target.write_text(text)
            print(name, run.returncode, flush=True)


def leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Every leaf with its path."""
    if isinstance(value, dict):
        for key, inner in value.items():
            if key not in IGNORED:
                yield from leaves(inner, f"{path}.{key}")
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            label = inner.get("name", i) if isinstance(inner, dict) else i
            yield from leaves(inner, f"{path}[{label}]")
    else:
        yield path, value


def findings(result: dict[str, Any]) -> list[str]:
    """Names and verdicts of a diagnosis."""
    return [
        f"{f['verdict']} {f['effect']} {','.join(f['joints'])}" for f in result.get("findings", [])
    ]


def compare(old: Path, new: Path, only: str) -> None:
    """Print what differs, case by case."""
    for file in sorted(old.glob("*.json")):
        if not file.stem.startswith(only) or not (new / file.name).exists():
            continue
        before, after = (json.loads((folder / file.name).read_text()) for folder in (old, new))
        a, b = dict(leaves(before)), dict(leaves(after))
        changed = []
        for path in a.keys() & b.keys():
            x, y = a[path], b[path]
            if isinstance(x, float | int) and isinstance(y, float | int):
                change = abs(x - y) / max(abs(x), abs(y), 1e-9)
                if change > TOLERANCE:
                    changed.append((change, path, x, y))
            elif x != y:
                changed.append((9.0, path, x, y))
        lost, gained = sorted(a.keys() - b.keys()), sorted(b.keys() - a.keys())
        verdict = "same" if not changed and not lost else f"{len(changed)} of {len(a)} differ"
        print(f"{file.stem}: {verdict}; {len(lost)} lost, {len(gained)} gained")
        if findings(before) != findings(after):
            for sign, here, there in (("-", before, after), ("+", after, before)):
                for line in findings(here):
                    if line not in findings(there):
                        print(f"  {sign} {line}")
        for change, path, x, y in sorted(changed, key=lambda c: -c[0])[:4]:
            print(f"    {change:.2g} {path}: {str(x)[:70]} -> {str(y)[:70]}")
        if lost:
            print("    lost:", ", ".join(lost[:4]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("verb", choices=["inputs", "freeze", "compare"])
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    if options.verb == "inputs":
        make_inputs(options.folders[0].resolve())
    elif options.verb == "freeze":
        freeze(options.folders[0].resolve(), options.folders[1].resolve(), options.only)
    else:
        compare(*options.folders, options.only)


if __name__ == "__main__":
    main()
