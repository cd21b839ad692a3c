"""Hidden effects of a wanted size: how strongly one shows, and drawing one that shows so much.

The *visible size* of what a virtual arm hides is the root mean square of the torque it makes, at
the motion that was recorded, behind the filter that identification uses, in units of what the
torque noise leaves behind the same filter. At 1 it drowns; 2 is just visible; 30 is plain.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.interpolate
import scipy.signal

from excitant.exceptions import BadInput, UnknownName
from excitant.robots.motion import Array, freeze
from excitant.robots.plant.controller import Trajectory
from excitant.robots.plant.habits import habits, typical_trajectory
from excitant.robots.plant.hidden_effect import STRUCTURES, HiddenEffect
from excitant.robots.plant.nominal import industrial_sensors
from excitant.robots.plant.planting import plant
from excitant.robots.plant.recipe import Recipe
from excitant.robots.plant.recipes import RECIPES
from excitant.robots.plant.run import simulate
from excitant.robots.plant.sensors import Sensors, recorded
from excitant.robots.plant.truth import Truth
from excitant.robots.robot import Robot
from excitant.robots.virtual_arm import VirtualArm, virtual_arm

FAULTS = ("wrong_sign", "wrong_unit")
"""Data faults that can be planted; they have no size."""
KINDS = (*(kind for kind in RECIPES if kind not in (*STRUCTURES, *FAULTS)), "unknown")
"""Kinds of effects that `draw_effect` draws."""

_CUTOFF = 10.0  # Hz
_EDGE = 0.3  # s at either end where the filter has not settled
_STILL = 3e-3  # of the highest speed: a joint that stands
_DURATION = 6.0  # s of motion on which a drawn effect is measured
_PRECISION = 1.15  # to which a wanted size is met
_TRIALS, _DRAWS = 7, 16  # of scales, and of joints and shapes
_GROWTH = 3.0  # how much faster than its scale an effect may grow at most
_SMALLEST, _LARGEST = 2.0, 30.0  # visible sizes drawn


@dataclass(frozen=True, eq=False)
class VisibleSize:
    """How strongly something hidden shows.

    Attributes:
        rms: Filtered torque that it makes at the recorded motion, shape (nv,) [N·m].
        floor: What the torque noise leaves behind the filter, shape (nv,) [N·m].
    """

    rms: Array
    floor: Array

    def __post_init__(self) -> None:
        freeze(self, "rms", "floor")

    @property
    def ratio(self) -> Array:
        """Rms over floor, shape (nv,); infinite with sensors that tell the truth."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.rms > 0, self.rms / self.floor, 0.0)

    @property
    def size(self) -> float:
        """Largest ratio of all joints."""
        return float(self.ratio.max())


def visible_size(
    arm: VirtualArm,
    trajectory: Trajectory,
    duration: float,
    rng: np.random.Generator,
    effects: Sequence[HiddenEffect] | None = None,
    cutoff_hz: float = _CUTOFF,
) -> VisibleSize:
    """Torque that hidden effects make at the motion that is recorded with them.

    The arm is recorded without noise, then the same arm without the effects follows the recorded
    motion; the difference of what is recorded as torque is filtered. While a joint stands still
    its motion does not determine its torque, so no difference counts.

    Args:
        arm: The virtual arm; its sensors' noise sets the floor.
        trajectory: Desired motion; starts at rest.
        duration: Length of the run [s].
        rng: Decides what chance decides in the run.
        effects: The hidden effects to measure, beside which the others stay; all when not given.
        cutoff_hz: Cut-off of the zero-phase low-pass (Butterworth, fourth order) [Hz].
    """
    chosen = arm.hidden if effects is None else tuple(effects)
    kept = [effect for effect in arm.hidden if effect not in chosen]
    without = plant(arm.bare, arm.nominal.joints, kept)
    true = _noiseless(arm.sensors)
    table = replace(arm, sensors=true).record(trajectory, duration, rng)
    names = range(1, arm.nominal.nv + 1)
    t = table["t"].to_numpy(float)
    q, dq, tau = (table[[f"{c}{j}" for j in names]].to_numpy(float) for c in ("q", "dq", "tau"))
    expected = _torque_at(arm.nominal, without, t, q, true)
    still = np.abs(dq) < _STILL * np.abs(dq).max(axis=0)
    error = np.where(still, 0.0, tau - expected)
    rms = _filtered_rms(error, arm.sensors.rate_hz, cutoff_hz)
    return VisibleSize(rms, _noise_floor(arm.sensors, cutoff_hz))


def _noiseless(sensors: Sensors) -> Sensors:
    still = np.zeros_like(sensors.torque_noise)
    return replace(
        sensors, position_resolution=0.0, velocity_noise=0.0, torque_noise=still,
        torque_resolution=still, velocity="tachometer",
    )  # fmt: skip


def _torque_at(robot: Robot, truth: Truth, t: Array, q: Array, sensors: Sensors) -> Array:
    """Recorded torque of an arm that follows sampled positions, its controller knowing it."""
    path = scipy.interpolate.CubicSpline(t, q, bc_type="clamped")

    def trajectory(at: Array, order: int = 0) -> Array:
        return np.asarray(path(at, order), dtype=np.float64)

    believed, fine = (truth.model, truth.drives), bool(np.isfinite(sensors.torque_cutoff_hz))
    rate, quiet = sensors.rate_hz, np.random.default_rng(0)
    run = simulate(robot, believed, truth, trajectory, float(t[-1]), rate, fine=fine)
    table = recorded(run, sensors, truth.recorder, truth.drives.offset, quiet)
    return table[[f"tau{j + 1}" for j in range(robot.nv)]].to_numpy(float)


def _filtered_rms(error: Array, rate_hz: float, cutoff_hz: float) -> Array:
    """Root mean square behind the filter, away from the edges."""
    sections = scipy.signal.butter(4, cutoff_hz, fs=rate_hz, output="sos")
    edge = int(_EDGE * rate_hz)
    inner = scipy.signal.sosfiltfilt(sections, error, axis=0)[edge:-edge]
    return np.asarray(np.sqrt(np.mean(inner**2, axis=0)), dtype=np.float64)


def _noise_floor(sensors: Sensors, cutoff_hz: float) -> Array:
    """What the torque noise leaves behind the filter."""
    sections = scipy.signal.butter(4, cutoff_hz, fs=sensors.rate_hz, output="sos")
    _, H = scipy.signal.sosfreqz(sections, 4096)
    noise = np.sqrt(sensors.torque_noise**2 + sensors.torque_resolution**2 / 12)
    return np.asarray(np.sqrt(np.mean(np.abs(H) ** 4)) * noise, dtype=np.float64)


def draw_effect(
    robot: Robot,
    rng: np.random.Generator,
    kind: str | None = None,
    size: float | None = None,
    sensors: Sensors | None = None,
    trajectory: Trajectory | None = None,
    duration: float = _DURATION,
) -> HiddenEffect:
    """Draw a hidden effect: its kind, its joints and its parameters.

    Args:
        robot: The nominal arm.
        rng: Source of randomness.
        kind: Name of an effect, a structure of an unknown one, or a data fault; any of `KINDS`
            when not given.
        size: Wanted visible size, met within 15 %; when not given one between 2 and 30, or the
            next smaller one that the arm can show. Data faults have none.
        sensors: Their torque noise sets the floor; `industrial_sensors` when not given.
        trajectory: Motion that the size holds for, from rest; a typical one when not given.
        duration: Length of that motion [s].

    Raises:
        UnknownName: There is no such kind.
        BadInput: No joint of this arm can show so much of it.
    """
    kind = kind or str(rng.choice(KINDS))
    if kind == "unknown":
        kind = str(rng.choice(STRUCTURES))
    if kind not in RECIPES:
        raise UnknownName("kind of hidden effect", kind, (*RECIPES, "unknown"))
    sensors = sensors or industrial_sensors(robot)
    if trajectory is None:
        trajectory = typical_trajectory(robot, rng, duration)
    sizes = [size] if size else _sizes(rng)
    habit = habits(robot, trajectory, duration, sizes[0] * _noise_floor(sensors, _CUTOFF))
    if kind in FAULTS:
        return RECIPES[kind](habit, rng).make(1.0)

    def measure(effect: HiddenEffect) -> float:
        return _shown(robot, effect, sensors, trajectory, duration)

    for wanted in sizes:
        for _ in range(_DRAWS):
            found = _sized(RECIPES[kind](habit, rng), wanted, measure)
            if found is not None:
                return found
    raise BadInput(f"virtual arm: {robot.name} cannot show a {kind} of size {sizes[-1]:.3g}")


def _sizes(rng: np.random.Generator) -> list[float]:
    """A size by chance, and smaller ones for what no joint can show so much of."""
    size = float(np.exp(rng.uniform(np.log(_SMALLEST), np.log(_LARGEST))))
    return [max(size * share, _SMALLEST) for share in (1.0, 0.4, 0.1)]


def _shown(
    robot: Robot,
    effect: HiddenEffect,
    sensors: Sensors,
    trajectory: Trajectory,
    duration: float,
) -> float:
    """Visible size of one effect on an arm that is otherwise nominal; huge where it fails."""
    rng = np.random.default_rng(0)
    arm = virtual_arm(robot, rng, hidden=(effect,), sensors=sensors, tolerance=0.0)
    try:
        return visible_size(arm, trajectory, duration, rng).size
    except BadInput:
        return 1e6


def _sized(
    recipe: Recipe, size: float, measure: Callable[[HiddenEffect], float]
) -> HiddenEffect | None:
    """Effect of a recipe at the scale that shows as much as wanted; None beyond its bounds."""
    scale = min(recipe.guess, recipe.most)
    known: list[tuple[float, float]] = []
    for _ in range(_TRIALS):
        effect = recipe.make(scale)
        shown = max(measure(effect), 1e-9)
        if abs(np.log(shown / size)) < np.log(_PRECISION):
            return effect
        if shown * recipe.most / scale < size / _GROWTH or (scale >= recipe.most and shown < size):
            return None
        known.append((float(np.log(scale)), float(np.log(shown))))
        scale = min(_next_scale(known, float(np.log(size))), recipe.most)
    return None


def _next_scale(known: Sequence[tuple[float, float]], wanted: float) -> float:
    """Between the neighbours of the wanted size, all in logarithms; before, proportional."""
    below = max((k for k in known if k[1] < wanted), key=lambda k: k[1], default=None)
    above = min((k for k in known if k[1] >= wanted), key=lambda k: k[1], default=None)
    if below is None or above is None:
        return float(np.exp(known[-1][0] + np.clip(wanted - known[-1][1], -2.0, 2.0)))
    share = np.clip((wanted - below[1]) / (above[1] - below[1]), 0.1, 0.9)
    return float(np.exp(below[0] + share * (above[0] - below[0])))
