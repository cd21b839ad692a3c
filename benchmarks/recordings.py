"""Accuracy of `identify` on unseen data of real arms; see README.md for rows and marks."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import common
import numpy as np
from common import DATA

from excitant.analysis.effect_choice import choose_effects, described
from excitant.exceptions import ExcitantError
from excitant.identify import Estimate, Recording, identify_robot, load_dataset
from excitant.robots import Robot
from excitant.robots.parameters import violations

DIGITS = 3
SHARES = {0.6: "first 60 % → last 40 %", 0.7: "first 70 % → last 30 %"}

Row = tuple[float, ...]


@dataclass(frozen=True)
class Split:
    """What is fitted, what is judged (or the share that is fitted), and what others reach there.

    Cut-off of judging [Hz] is that of `identify` when None; published is the rms of a model [N·m].
    """

    dataset: str
    fit: str  # names with blanks between
    judge: str = ""
    share: float | None = None
    readme: Row = ()
    published_rms: Row = ()
    cutoff_hz: float | None = None
    note: str = ""


UR10E = "id_12harm_30s id_12harm_40s id_8harm_20s"
OTHER_LAB = "another lab's robot, logged at 30 Hz; at 5 Hz our quick fit comes to the README's"
SPLITS = (
    Split("ur10", "unisa_exciting", share=0.6, readme=(0.978, 0.992, 0.996, 0.983, 0.984, 0.882)),
    Split("ur10", "unisa_exciting", share=0.7, published_rms=(4.06, 3.18, 1.71, 0.48, 0.63, 0.99)),
    Split("panda", "gaz_traj1", share=0.6, readme=(0.992, 1.0, 0.999, 0.998, 0.994, 0.999, 0.966)),
    Split("panda", "gaz_traj1", "unisa_exciting", cutoff_hz=5.0, note=OTHER_LAB,
          readme=(-0.02, 0.998, 0.991, 0.962, 0.919, 0.882, 0.949)),
    Split("ur10e", UR10E, "id_12harm_50s", note="the README does not say which three runs",
          readme=(0.992, 0.987, 0.997, 0.986, 0.972, 0.988)),
    Split("ur10e", UR10E, "val_ptp_10_points", readme=(0.943, 0.987, 0.996, 0.962, 0.883, 0.728)),
    Split("rokae_xmate3", "rec01", share=0.6, note="README: .39 to 1.00"),
    Split("rokae_xmate3", "rec02", share=0.6, note="README: .39 to 1.00"),
    Split("rokae_xmate3", "rec02", "rec01", note="another robot; README: -.89 at joint 1"),
    Split("dualarm_v2", "exc_13p5 exc_15p7", "exc_52p2",
          readme=(0.958, 0.924, 0.987, 0.972, 0.983, 0.986, 0.986)),
)  # fmt: skip


def loaded(split: Split) -> tuple[Robot, list[Recording], list[Recording]]:
    dataset = load_dataset(DATA / split.dataset)
    robot, fit = dataset.robot, dataset.recordings(split.fit.split())
    if split.share is None:
        return robot, fit, dataset.recordings(split.judge.split())
    first, rest = SHARES[split.share].split(" → ")
    parts = [r.between(0, split.share, first) for r in fit]
    return robot, parts, [r.between(split.share, 1, rest) for r in fit]


def report(split: Split, chosen: bool) -> None:
    try:
        robot, fit, judge = loaded(split)
    except ExcitantError as error:
        print(f"\n{split.dataset}: left out, {error}")
        return
    options = {"validate": judge, "cutoff_hz": split.cutoff_hz}
    start = time.perf_counter()
    standard = identify_robot(robot, fit, **options)
    rows = {"given": (standard.baseline, "")}
    rows["standard"] = standard.validate, _said(standard, start)
    cutoff_hz, unit = standard.data.cutoff_hz, standard.data.unit
    what = split.judge.replace(" ", " + ") if split.share is None else SHARES[split.share]
    title = f"{split.dataset} {split.fit.replace(' ', ' + ')}: {what}"
    print(f"\n{title}  [judged at {cutoff_hz:.3g} Hz, {unit}]", flush=True)
    if split.note:
        print(f"  {split.note}")
    closing: list[str] = []
    if chosen:
        start = time.perf_counter()
        try:
            effects = choose_effects(robot, fit, cutoff_hz=split.cutoff_hz)
            best = identify_robot(robot, fit, effects=effects, **options)
            rows["chosen"] = best.validate, _said(best, start)
            closing = [f"    + {sentence}" for sentence in described(effects)]
        except ExcitantError as error:
            closing = [f"  chosen    failed: {error}"]
    total = float(np.sqrt(1 - np.minimum(split.readme or [1], 1 - 0.5 * 10.0**-DIGITS)).sum())
    if split.readme:
        _line("readme", np.array(split.readme), total, split.readme, "")
    for row, (accuracy, said) in rows.items():
        ratio = f"  ratio {accuracy.nrmse.sum() / total:.3f}" if split.readme else ""
        _line(row, accuracy.r2, accuracy.nrmse.sum(), split.readme, ratio + said)
    print("\n".join(closing), end="\n" if closing else "")
    if split.published_rms:
        spread = standard.validate.rms / standard.validate.nrmse
        errors = {"published": np.array(split.published_rms)}
        for row, rms in (errors | {row: a.rms for row, (a, _) in rows.items()}).items():
            cells = " ".join(f"{v:7.3f} " for v in rms)
            print(f"  rms {row:<9}{cells}  Σ nrmse {(rms / spread).sum():.3f}", flush=True)


def _said(estimate: Estimate, start: float) -> str:
    broken = violations(estimate.phi, estimate.given.links)
    return f"  consistent: {'NO' if broken else 'yes'}  {time.perf_counter() - start:.0f} s"


def _line(row: str, r2: np.ndarray, nrmse: float, readme: Row, extra: str) -> None:
    below = np.round(r2, DIGITS) < np.array(readme or [-np.inf] * len(r2))
    cells = " ".join(f"{v:7.4f}{'<' if b else ' '}" for v, b in zip(r2, below, strict=True))
    print(f"  {row:<9}{cells}  Σ nrmse {nrmse:.3f}{extra}", flush=True)


def main(*, sets: Sequence[str] = (), standard_only: bool = False) -> None:
    """Identify every set and judge it on unseen data.

    Args:
        sets: Data sets; all by default.
        standard_only: Choose no effects.
    """
    for split in SPLITS:
        if not sets or split.dataset in sets:
            report(split, not standard_only)


if __name__ == "__main__":
    common.run(main)
