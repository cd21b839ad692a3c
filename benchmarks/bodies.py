"""Whether identified links are nearer to the true ones than given links; see README.md."""

from collections.abc import Sequence
from dataclasses import replace

import common
import numpy as np
import pandas as pd

from excitant.design import random_trajectory
from excitant.identify import identify_robot, recording_from_table
from excitant.identify.regression import regression_of
from excitant.robots import Robot, load_robot
from excitant.robots.effects import CoulombFriction, ViscousFriction
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.virtual_arm import typical_torque, virtual_arm

OFF = 0.3  # of masses, of central inertias, and of centres of mass in radii of gyration
FRICTION = 0.1  # of a joint's typical torque, viscous and Coulomb
DURATION, HARMONICS = 20.0, 5
Array = np.ndarray


def distance(phi: Array, truth: Array) -> Array:
    """Distances to the true links in units of mass and radius of gyration, (10 nv,) → (nv,)."""
    found = []
    for P, true in zip(*(pseudo_inertia(x.reshape(-1, 10)) for x in (phi, truth)), strict=True):
        mass = true[3, 3]
        radius = np.sqrt(np.trace(true[:3, :3]) / mass - (true[:3, 3] ** 2).sum() / mass**2)
        scale = np.diag([1 / radius] * 3 + [1.0]) / np.sqrt(mass)
        found.append(np.linalg.norm(scale @ (P - true) @ scale))
    return np.array(found)


def known_friction(robot: Robot) -> Robot:
    """The arm without effects but with viscous and Coulomb friction in proportion to its torque."""
    size = FRICTION * typical_torque(robot)
    return robot.with_effects(
        [kind(robot.joints, values=tuple(size)) for kind in (ViscousFriction, CoulombFriction)]
    )


def case(name: str, seed: int) -> tuple[pd.DataFrame, dict[str, float]]:
    """A virtual arm near an arm as given, recorded on two motions, identified from the first.

    Errors of its links, and nrmse of the motion not fitted, the median over joints.
    """
    robot, rng = known_friction(load_robot(name).with_effects(())), np.random.default_rng(seed)
    arm = virtual_arm(robot, rng, hidden=(), tolerance=OFF)
    runs = []
    for k in range(2):
        motion = random_trajectory(robot, rng, DURATION, HARMONICS)
        log = arm.record(motion, DURATION, rng)
        runs.append(replace(recording_from_table(log, robot.nv, file="x", name=f"run{k}"), dq=None))
    estimate = identify_robot(robot.with_effects(()), runs[:1], validate=runs[1:])
    bodies = list(arm.truth.model.inertias)[1:]
    truth = np.concatenate([body.toDynamicParameters() for body in bodies])
    W = regression_of(estimate.model, estimate.model.effects, estimate.data.validate).W
    free = W[:, :, estimate.base.columns] @ estimate.least_squares.beta
    models = {"given": robot.phi, "identified": estimate.phi}
    links = {model: distance(phi, truth) for model, phi in models.items()}
    links |= {f"mass {model}": phi[::10] / truth[::10] - 1 for model, phi in models.items()}
    fits = {"torque": estimate.validate, "free": estimate.holdout.accuracy(free)}
    torque = {kind: float(np.median(accuracy.nrmse)) for kind, accuracy in fits.items()}
    return pd.DataFrame(links, index=robot.links), torque


def table(name: str, draws: int) -> pd.DataFrame:
    """Root mean squares over draws, link by link; means of the torque's errors as attributes."""
    links, torques = zip(*(case(name, seed) for seed in range(draws)), strict=True)
    rms = np.sqrt(sum(errors**2 for errors in links) / draws)
    nearer = [errors["identified"] < errors["given"] for errors in links]
    rms.insert(2, "nearer", sum(nearer) / draws)
    rms.attrs = dict(pd.DataFrame(torques).mean())
    return rms


def main(
    *, arms: Sequence[str] = ("ur10", "panda", "ur5e", "iiwa14", "gen3"), draws: int = 20
) -> None:
    """Identify arms whose links are off by 30 %.

    Args:
        draws: Number of each.
    """
    for name in arms:
        found = table(name, draws)
        print(f"\n{name}, {draws} arms off by {OFF:.0%}")
        print(found.round(3).to_string())
        torque = (f"{kind} {100 * value:.2f} %" for kind, value in found.attrs.items())
        print("torque not fitted, nrmse:", ", ".join(torque))


if __name__ == "__main__":
    common.run(main)
