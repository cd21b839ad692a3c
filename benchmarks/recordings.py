"""Accuracy of `identify` on unseen data of real arms; see README.md for rows and marks."""

import time
from collections.abc import Sequence
from dataclasses import dataclass

import common
import numpy as np
from common import DATA
from diagnosis import drawn

from excitant.analysis.diagnosis import diagnose
from excitant.analysis.effect_choice import choose_effects, described
from excitant.analysis.publication import publication_of
from excitant.identify import Recording, identify_robot, load_dataset
from excitant.identify.accuracy import series
from excitant.identify.least_squares import weighted_least_squares
from excitant.identify.regression import regression_of
from excitant.robots import Robot, base_parameters
from excitant.robots.effects import EFFECTS
from excitant.robots.parameters import violations

DIGITS = 3
SHARES = {0.6: "first 60 % → last 40 %", 0.7: "first 70 % → last 30 %"}

Row = tuple[float, ...]


@dataclass(frozen=True)
class Split:
    """What is fitted, what is judged (or the share that is fitted), and what others reach."""

    dataset: str
    fit: str  # names with blanks between
    judge: str = ""
    share: float | None = None
    readme: Row = ()
    published_rms: Row = ()  # of a model [N·m]
    cutoff_hz: float | None = None  # of judging [Hz]; that of `identify` when None
    note: str = ""


UR10E = "id_12harm_30s id_12harm_40s id_8harm_20s"
SPLITS = (
    Split("ur10", "unisa_exciting", share=0.6, readme=(0.978, 0.992, 0.996, 0.983, 0.984, 0.882)),
    Split("ur10", "unisa_exciting", share=0.7, published_rms=(4.06, 3.18, 1.71, 0.48, 0.63, 0.99)),
    Split("panda", "gaz_traj1", share=0.6, readme=(0.992, 1.0, 0.999, 0.998, 0.994, 0.999, 0.966)),
    Split("panda", "gaz_traj1", "unisa_exciting", cutoff_hz=5.0, note="another lab's, at 30 Hz",
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


def report(split: Split) -> None:
    robot, fit, judge = loaded(split)
    options = {"validate": judge, "cutoff_hz": split.cutoff_hz}
    chosen, rows = choose_effects(robot, fit, cutoff_hz=split.cutoff_hz), {}
    for row, effects in (("standard", None), ("chosen", chosen)):
        start = time.perf_counter()
        found = identify_robot(robot, fit, effects=effects, **options)
        consistent = "NO" if violations(found.phi, found.given.links) else "yes"
        said = f"  consistent: {consistent}  {time.perf_counter() - start:.0f} s"
        rows |= {"given": (found.baseline, ""), row: (found.validate, said)}
    what = split.judge.replace(" ", " + ") if split.share is None else SHARES[split.share]
    judged = f"[judged at {found.data.cutoff_hz:.3g} Hz, {found.data.unit}]"
    print(f"\n{split.dataset} {split.fit.replace(' ', ' + ')}: {what}  {judged}", flush=True)
    print(f"  {split.note}")
    total = float(np.sqrt(1 - np.minimum(split.readme or [1], 1 - 0.5 * 10.0**-DIGITS)).sum())
    if split.readme:
        _line("readme", np.array(split.readme), total, split.readme, "")
    for row, (accuracy, said) in rows.items():
        ratio = f"  ratio {accuracy.nrmse.sum() / total:.3f}" if split.readme else ""
        _line(row, accuracy.r2, accuracy.nrmse.sum(), split.readme, ratio + said)
    print("\n".join(f"    + {sentence}" for sentence in described(chosen)))
    if split.published_rms:
        spread = found.validate.rms / found.validate.nrmse
        errors = {"published": np.array(split.published_rms)}
        for row, rms in (errors | {row: a.rms for row, (a, _) in rows.items()}).items():
            cells = " ".join(f"{v:7.3f} " for v in rms)
            print(f"  rms {row:<9}{cells}  Σ nrmse {(rms / spread).sum():.3f}", flush=True)


def _line(row: str, r2: np.ndarray, nrmse: float, readme: Row, extra: str) -> None:
    below = np.round(r2, DIGITS) < np.array(readme or [-np.inf] * len(r2))
    cells = " ".join(f"{v:7.4f}{'<' if b else ' '}" for v, b in zip(r2, below, strict=True))
    print(f"  {row:<9}{cells}  Σ nrmse {nrmse:.3f}{extra}", flush=True)


def files(name: str, robot: Robot, fit: list[Recording], judge: list[Recording]) -> None:
    """Hold-out nrmse, summed over joints, of models, their files, and what their formats can."""
    chosen = [None, choose_effects(robot, fit)]
    nouns = [identify_robot(robot, fit, validate=judge, effects=effects) for effects in chosen]
    nouns += [diagnose(robot, fit, validate=judge)]
    for verb, noun in zip(("identify", "auto", "diagnose"), nouns, strict=True):
        gains = noun.holdout.gains if verb == "diagnose" else noun.gains
        parts = (noun.data.train, noun.data.validate)
        complete, *exported = publication_of(noun, force=True).exported
        for file in exported:
            kinds = [kind for kind in EFFECTS.values() if kind.export.joint_property]
            effects = [k(robot.joints) for k in kinds if file.file_format in k.export.formats]
            base = base_parameters(robot, effects).columns
            errors = [complete.accuracy.nrmse, file.accuracy.nrmse]
            for part in parts:
                rows = regression_of(robot, effects, part).counting(series(part).counts)
                rows = rows.select(base).with_torque(rows.tau * gains)
                beta = weighted_least_squares(rows).beta
                predicted = regression_of(robot, effects, parts[1]).select(base).torque(beta)
                errors.append(series(parts[1]).accuracy(predicted / gains).nrmse)
            cells = (f"{np.nansum(error):8.3f}" for error in errors)
            print(f"{name:16}{verb:9}{file.file_format:5}", *cells, flush=True)


def main(*, sets: Sequence[str] = (), arms: int | None = None) -> None:
    """Identify every set and judge it on unseen data.

    Args:
        sets: Data sets; all by default.
        arms: Judge the files that are written instead, and those of so many arms that hide effects.
    """
    for split in SPLITS:
        if not sets or split.dataset in sets:
            report(split) if arms is None else files(split.dataset, *loaded(split))
    for number in range(arms or 0):
        case = drawn(7, number)
        fit, judge = case.recordings
        files(f"{case.robot.name} {number}", case.robot, [fit], [judge])


if __name__ == "__main__":
    common.run(main)
