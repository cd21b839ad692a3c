"""`examine`: all that recordings say of a given model, with one verdict on the model to use."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from excitant.analysis.diagnosis import Diagnosis, diagnose
from excitant.analysis.explanation import placeholders
from excitant.analysis.identifiability import Identifiability, analyze
from excitant.analysis.publication import extended_publication
from excitant.identify.accuracy import Accuracy
from excitant.identify.estimate import Estimate, identify_robot
from excitant.identify.export import Publication, publication
from excitant.identify.faults import proven
from excitant.identify.faults.fault import is_modelled
from excitant.identify.objections import MISSED
from excitant.identify.recording import Recording
from excitant.robots.check import ModelCheck
from excitant.robots.effects import plain
from excitant.robots.motion import Array
from excitant.robots.robot import Robot
from excitant.robots.shown import Shown, Table, worst_and_median

_SAME = 0.05  # of the error: a model that gains no more is not worth a change
_POOR = 0.5  # nrmse from which on it is said that a joint is hardly predicted
_NAMED = 3  # effects that are said to be lacking in a file
_COMPLETE = {"identified": "model.yaml", "extended": "extended.yaml"}


@dataclass(frozen=True, eq=False, repr=False)
class Examination(Shown):
    """A given model examined by recordings.

    Attributes:
        check: What looks wrong in its description.
        estimate: The identified model.
        identifiability: What the recordings show of it.
        diagnosis: What is wrong with the given model; the extended model has it amended.
        faults: Faults of the recordings, with whether they are repaired, as in `Checked.entries`.
        publications: Files of the identified and of the extended model, or why there are none.
        notes: Remarks on the recordings, as sentences.
    """

    check: ModelCheck
    estimate: Estimate
    identifiability: Identifiability
    diagnosis: Diagnosis
    faults: Sequence[Mapping[str, Any]]
    publications: Mapping[str, Publication]
    notes: tuple[str, ...] = ()

    @property
    def accuracies(self) -> dict[str, Accuracy]:
        """Accuracy on the hold-out of the given, the identified and the extended model."""
        return {
            "given": self.estimate.baseline,
            "identified": self.estimate.validate,
            "extended": self.diagnosis.extended,
        }

    @property
    def wrong(self) -> list[Mapping[str, Any]]:
        """Faults of the data by which every figure is wrong.

        How the arm is set up is judged by all recordings together, in the diagnosis.
        """
        return [f for f in self.faults if not is_modelled(f) and proven([f])]

    @cached_property
    def use(self) -> str:
        """The model to use: ``given``, ``extended`` or ``identified``; empty where none may be.

        Of the given one and those that are published, the least changed that predicts the hold-out
        about as well as any. None, where the recordings are wrong, or only the given one is left
        and it misses most of a joint's torque.
        """
        errors = {
            name: float(np.nansum(a.nrmse)) for name, a in self.accuracies.items()
        }
        kept = [
            "given",
            *(n for n, each in self.publications.items() if each.published),
        ]
        useless = (self.accuracies["given"].nrmse > MISSED).any()
        if self.wrong or (len(kept) == 1 and useless):
            return ""
        most = (1 + _SAME) * min(errors[name] for name in kept)
        return next(name for name in kept if errors[name] <= most)

    @property
    def files(self) -> dict[str, str]:
        """Files of the models that are published, by name."""
        return {
            n: text
            for each in self.publications.values()
            for n, text in each.files.items()
        }

    @property
    def sentences(self) -> list[str]:
        """The verdict in plain words."""
        if self.wrong:
            return [
                "The recordings are wrong, and so is what they say of any model."
            ]
        joints = self.check.robot.joints
        given, identified, extended = (
            worst_and_median(joints, accuracy.nrmse)
            for accuracy in self.accuracies.values()
        )
        advice = (
            "Keep the given model: no other is better"
            if self.use
            else "Use none of them"
        )
        if self.recommended:
            missed = self.accuracies[self.use].nrmse > _POOR
            poor = np.array(joints)[missed].tolist()
            advice = f"Use {self.recommended[0]}"
            if poor:
                advice += (
                    f", except at {', '.join(poor)}, where it misses more than half"
                )
            advice += self._without
        return [
            f"Of the torque, the given model misses at most {given}, the identified one "
            f"{identified}, the extended one {extended}.",
            f"Main cause: {self._cause}.",
            f"{advice}.",
        ]

    @property
    def _cause(self) -> str:
        """The main finding with its verdict in brackets."""
        if note := placeholders(self.diagnosis):
            return note.partition(":")[0]
        findings = self.results["diagnose"]["findings"]
        if not findings:
            return "none stands out; values are off within their tolerance"
        lead = findings[0]
        if lead["verdict"] == "unknown":
            return "none that is known"
        alike = [
            f": {plain(rival['effect'])} at {', '.join(rival['joints'])} would look the same"
            for rival in lead["rivals"]
        ]
        return f"{lead['sentence']} ({lead['verdict']}{''.join(alike[:1])})"

    @property
    def recommended(self) -> tuple[str, ...]:
        """Files of the model to use, the one that holds all of it first; none for the given one."""
        if self.use not in _COMPLETE:
            return ()
        both = [_COMPLETE[self.use], f"{self.use}.urdf"]
        written = [name for name in both if name in self.files]
        return tuple(written if self._lacking else written[::-1])

    @property
    def refusal(self) -> str:
        """Why no model may be used, where none may."""
        for fault in self.wrong:
            where = f" ({', '.join(fault['joints'])})" if fault["joints"] else ""
            return f"{plain(fault['fault'])} in {fault['recording']}{where}"
        return self._notes[0]

    def _lines(self) -> list[str]:
        return [
            f"Examination of {self.check.robot.name}: use {self.use or 'no model'}",
            " ".join(self.sentences),
            self.next_step,
        ]

    def _table(self) -> Table:
        joints = self.check.robot.joints
        errors = [accuracy.nrmse.tolist() for accuracy in self.accuracies.values()]
        heads = ("joint", *(f"nrmse, {name}" for name in self.accuracies))
        return heads, zip(joints, *errors, strict=True)

    @property
    def _notes(self) -> list[str]:
        """Why models are not published, without what only the single commands can do."""
        notes = filter(None, (each.refusal for each in self.publications.values()))
        return [note.removesuffix(", or give --force") for note in notes]

    @property
    def next_step(self) -> str:
        """What to do where something is open; else empty."""
        findings = self.results["diagnose"]["findings"]
        if self.use and findings and findings[0]["verdict"] == "undecided":
            return "excitant diagnose, with the same arguments, looks for the motion that decides"
        faults = [f for f in self.faults if f["repair"] and not f["repaired"]]
        maps = dict.fromkeys(f["map"] for f in faults if f["map"])
        stated = (
            f"; for good, a file for --map: {' and '.join(maps)}" if maps else ""
        )
        return f"--repair repairs what can be repaired{stated}" if faults else ""

    @property
    def _without(self) -> str:
        """What the URDF of the model to use is without, in words; empty where that is nothing."""
        urdf = f"{self.use}.urdf"
        drive = self.estimate.drive
        if drive is not None and not drive.known.any():
            why = (
                "no drive gain is known, so that the model predicts currents alone"
            )
            return f"; {urdf} is not written: {why}"
        few = self._lacking[:_NAMED]
        few += ["and more"] * (len(self._lacking) > _NAMED)
        written = urdf in self.recommended
        unwritten = "" if written else ", so much that it is not written"
        return f"; {urdf} lacks {', '.join(few)}{unwritten}" if few else ""

    @property
    def _lacking(self) -> list[str]:
        """Effects of the model to use that its URDF cannot hold, in words."""
        models = {
            "identified": self.estimate.model,
            "extended": self.diagnosis.extension.model,
        }
        own = [
            e
            for e in models[self.use].effects
            if e.role == "torque" and any(e.values or ())
        ]
        lacking = [plain(e.name) for e in own if "urdf" not in e.export.formats]
        return list(dict.fromkeys(lacking))

    @cached_property
    def results(self) -> dict[str, dict[str, Any]]:
        """Results of the commands, by name."""
        results = {verb: noun.result() for verb, noun in self._nouns.items()}
        results["diagnose"]["faults"] = [dict(fault) for fault in self.faults]
        for model, verb in (("identified", "identify"), ("extended", "diagnose")):
            exported = self.publications[model].exported
            results[verb]["exported"] = [file.entry() for file in exported]
        return results

    @property
    def _nouns(self) -> dict[str, Any]:
        return {
            "robots": self.check,
            "identify": self.estimate,
            "analyze": self.identifiability,
            "diagnose": self.diagnosis,
        }

    def result(self) -> dict[str, Any]:
        """Contents of result.json."""
        findings = self.results["diagnose"]["findings"]
        lead = (
            findings[0]
            if findings
            else {"effect": None, "joints": [], "verdict": None}
        )
        return {
            "verb": "go",
            "robot": self.check.robot.name,
            "verdict": {
                "sentences": self.sentences,
                "use": self.use or None,
                "files": list(self.recommended),
                "refused": self._notes,
                "next": self.next_step,
                **{key: lead[key] for key in ("effect", "joints", "verdict")},
            },
            **self.results,
            "notes": list(self.notes),
        }

    def series(self) -> dict[str, Array]:
        """Arrays of the commands' figures, by ``command/key``."""
        series = {verb: noun.series() for verb, noun in self._nouns.items()}
        return {
            f"{verb}/{key}": a
            for verb, own in series.items()
            for key, a in own.items()
        }


def examine(
    robot: Robot,
    recordings: Sequence[Recording],
    *,
    validate: Sequence[Recording] = (),
    cutoff_hz: float | None = None,
    faults: Sequence[dict[str, Any]] = (),
    notes: Sequence[str] = (),
    progress: Callable[[float, str], None] = lambda share, words: None,
) -> Examination:
    """Identify an arm, say what its recordings can show, and diagnose its given model.

    Args:
        robot: The given model.
        recordings: Recordings to fit.
        validate: Recordings to judge on; the last 30 % of each recording when empty.
        cutoff_hz: Cut-off of the torque filter [Hz].
        faults: Faults of the recordings, as `Checked.entries` tells them.
        notes: Remarks on the recordings, as sentences.
        progress: Called with the share of the work that is done, and what is next.

    Raises:
        RankDeficient: A motion that leaves parameters open.
        BadRecording: Recordings that cannot be used.
        BadRobot: Links without mass.
    """
    options: dict[str, Any] = {"validate": validate, "cutoff_hz": cutoff_hz}
    progress(0.0, "identifying")
    estimate = identify_robot(robot, recordings, **options)
    progress(0.3, "diagnosing")
    diagnosis = diagnose(robot, recordings, **options)
    turned = diagnosis.set_up is not None and diagnosis.set_up.robot is not robot
    data = [fault for fault in faults if not is_modelled(fault)]
    publications = {
        "extended": extended_publication(diagnosis, data),
        "identified": publication(
            estimate, faults=proven(faults if turned else data)
        ),
    }
    progress(0.8, "analysing")
    return Examination(
        ModelCheck(robot),
        estimate,
        analyze(robot, estimate=estimate),
        diagnosis,
        faults,
        publications,
        tuple(notes),
    )
