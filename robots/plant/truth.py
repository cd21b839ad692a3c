"""Truth: everything that makes the torque of the plant, and what its record shows of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from excitant.robots.motion import Array, freeze
from excitant.robots.plant.friction import CoupledShaft, Drives, DryLaw, Presliding
from excitant.robots.plant.loads import JointLoad, Telegraph, TipForce
from excitant.robots.plant.sensors import Encoder, Recorder
from excitant.robots.plant.transmission import Transmission


@dataclass(frozen=True, eq=False)
class Truth:
    """The physics of an arm.

    Attributes:
        model: Pinocchio's model of the rigid bodies; never edited.
        drives: Friction and rotor inertia of the joints.
        rotors: What turning rotors couple, added to the mass matrix, shape (nv, nv) [kg·m²].
        encoder: What the controller reads and records.
        recorder: How the record differs from that.
        dry: Further friction of single joints.
        presliding: Friction of single joints that remembers displacement.
        shafts: Friction on the sum of two joints' speeds.
        loads: Torques on single joints.
        forces: Forces on the tip.
        tip: Pinocchio's frame of the tip.
        transmissions: Elastic gears, one per joint at most.
    """

    model: Any
    drives: Drives
    rotors: Array
    encoder: Encoder
    recorder: Recorder
    dry: tuple[DryLaw, ...] = ()
    presliding: tuple[Presliding, ...] = ()
    shafts: tuple[CoupledShaft, ...] = ()
    loads: tuple[JointLoad, ...] = ()
    forces: tuple[TipForce, ...] = ()
    tip: int = 0
    transmissions: tuple[Transmission, ...] = ()

    def __post_init__(self) -> None:
        freeze(self, "rotors")

    @property
    def nv(self) -> int:
        """Number of joints."""
        return len(self.drives.rotor)

    @property
    def fine(self) -> bool:
        """Whether the record needs more instants than those of sampling."""
        return bool(self.recorder.delay.any())

    @property
    def distorted(self) -> bool:
        """Whether the encoders lie."""
        return bool((self.encoder.scale != 1).any() or self.encoder.offset.any())

    def drawn(self, rng: np.random.Generator, duration: float) -> Truth:
        """The truth of one run: what is left to chance is drawn."""
        if not any(isinstance(load, Telegraph) for load in self.loads):
            return self
        drawn = (x.drawn(rng, duration) if isinstance(x, Telegraph) else x for x in self.loads)
        return replace(self, loads=tuple(drawn))


def rigid_truth(model: Any, drives: Drives, tip: int) -> Truth:
    """Rigid bodies with drives and sensors that tell the truth."""
    n = len(drives.rotor)
    honest = Encoder(np.ones(n), np.zeros(n)), Recorder(np.eye(n), np.zeros(n))
    return Truth(model, drives, np.zeros((n, n)), *honest, tip=tip)
