"""Draw the figure of the page on identifiability: arms that no motion tells apart.

python docs/explanation/identifiability_figure.py
"""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from PIL import Image

import excitant as ex
from excitant.robots import Array, Motion, Robot, regressor

MOVED = (0.0, 1.2, -0.6)  # kg at the elbow, from link 1 to link 2
ADDED = 1.2  # kg at the elbow of arm D
LINKS = ("#1b4965", "#ca6702")
ARMS = ("#9db4c0", "#ca6702", "#1b4965")
WIDTHS, STYLES = (7, 3, 1), ("-", "--", "-")
POSE = np.array([0.5, 0.7])  # rad


def moved(robot: Robot, mass: float) -> Array:
    """Parameters after link 2 took mass at the elbow that link 1 gave there, shape (20,)."""
    length, phi = 0.5, np.array(robot.phi)
    link1, link2 = phi[:10], phi[10:]
    link2[0] += mass
    link1[[0, 1, 6, 9]] -= mass * np.array([1.0, length, length**2, length**2])
    return phi


def draw_arm(axes: plt.Axes, phi: Array) -> None:
    """Both links from the side, a disc of the mass's area at each centre of mass."""
    a, b = POSE[0], POSE.sum()
    elbow = 0.5 * np.array([np.cos(a), np.sin(a)])
    tip = elbow + 0.4 * np.array([np.cos(b), np.sin(b)])
    axes.plot(
        *np.array([[0, 0], elbow, tip]).T,
        "-o",
        color="0.6",
        lw=2,
        ms=5,
        mfc="w",
        zorder=1,
    )
    for start, angle, link, colour in (
        (0, a, phi[:10], LINKS[0]),
        (elbow, b, phi[10:], LINKS[1]),
    ):
        centre = start + link[1] / link[0] * np.array([np.cos(angle), np.sin(angle)])
        axes.scatter(*centre, s=110 * link[0], color=colour, alpha=0.55, zorder=2)
        axes.annotate(
            f"{link[0]:.1f} kg",
            centre,
            (10, -16),
            textcoords="offset points",
            fontsize=9,
        )
    axes.set(
        aspect="equal", xlim=(-0.08, 0.72), ylim=(-0.12, 0.72), xticks=[], yticks=[]
    )
    axes.spines[:].set_visible(False)


def draw_torques(axes: plt.Axes, robot: Robot) -> None:
    """Torques of both joints along one motion, of all arms."""
    t = np.linspace(0, 5, 251)
    path = ex.random_trajectory(robot, np.random.default_rng(5), 5.0, 3)
    Y = regressor(robot, Motion(t, path(t), path(t, 1), path(t, 2)))
    heavier = moved(robot, ADDED)
    heavier[:10] = robot.phi[:10]
    axes.plot(t, (Y @ heavier)[:, 0], ":", color="0.35", lw=1.5)
    for mass, colour, width, style in zip(MOVED, ARMS, WIDTHS, STYLES, strict=True):
        axes.plot(t, Y @ moved(robot, mass), style, color=colour, lw=width)
    for text, place, colour in (
        ("arm D, joint 1", (3.8, 42.0), "0.35"),
        ("arms A, B, C, joint 1", (4.05, 24.0), "black"),
        ("arms A, B, C, joint 2", (2.75, 10.0), "black"),
    ):
        axes.annotate(text, place, fontsize=9, color=colour)
    axes.set(xlabel="time [s]", ylabel="torque [N·m]", xlim=(0, 5))
    axes.spines[["top", "right"]].set_visible(False)


def main() -> None:
    """Write the figure beside this file."""
    robot = ex.load_robot("planar_2r")
    figure = plt.figure(figsize=(8.0, 4.4), layout="constrained")
    axes = figure.subplot_mosaic([["A", "B", "C"], ["tau", "tau", "tau"]])
    for name, mass in zip("ABC", MOVED, strict=True):
        draw_arm(axes[name], moved(robot, mass))
        axes[name].set_title(f"arm {name}", fontsize=10)
    draw_torques(axes["tau"], robot)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=100)
    target = Path(__file__).with_name("identifiability.png")
    Image.open(drawn).convert("RGB").quantize(64).save(target, optimize=True)


if __name__ == "__main__":
    main()
