"""Writes the example in cell3/: the model of an arm, and two recordings of an arm that is not it.

The arm is virtual. Its elbow has 8 N·m more dry friction than the model, and every mass and length
of a lever is off by up to 3 %. It is recorded as a controller of a cell logs: in milliseconds that
come irregularly, in degrees, with noise.

    python examples/cell3.py
"""

from pathlib import Path

import numpy as np
import pandas as pd

import excitant as ex
from excitant.robots.virtual_arm import HiddenEffect, industrial_sensors

FOLDER = Path(__file__).with_suffix("")
MORE = HiddenEffect("coulomb_friction", "elbow_joint", (("Fc", 8.0),))
STEP, JITTER = 8, 1  # ms between samples, and the most by which one comes early or late


def logged(table: pd.DataFrame, rng: np.random.Generator) -> pd.DataFrame:
    """A recording of a sample each millisecond as the controller logs it."""
    rows = np.arange(JITTER, len(table) - JITTER, STEP)
    kept = table.iloc[rows + rng.integers(-JITTER, JITTER + 1, len(rows))]
    columns = {"Time [ms]": (1e3 * kept["t"]).round().astype(int)}
    for j in range(1, 7):
        columns[f"J{j} pos [deg]"] = np.degrees(kept[f"q{j}"]).round(4)
    for j in range(1, 7):
        columns[f"J{j} torque [Nm]"] = kept[f"tau{j}"].round(2)
    return pd.DataFrame(columns)


def main() -> None:
    """Write the model and both recordings."""
    FOLDER.mkdir(exist_ok=True)
    (FOLDER / "robot.urdf").write_text(ex.load_robot("ur5e").urdf, encoding="utf-8")
    robot, rng = ex.load_robot(FOLDER / "robot.urdf"), np.random.default_rng(3)
    sensors = industrial_sensors(robot, rate_hz=1000.0)
    arm = ex.virtual_arm(robot, rng, hidden=[MORE], sensors=sensors)
    for name, duration in (("run1", 20.0), ("run2", 10.0)):
        motion = ex.random_trajectory(robot, rng, 10.0, 5)
        logged(arm.record(motion, duration, rng), rng).to_csv(
            FOLDER / f"{name}.csv", index=False
        )


if __name__ == "__main__":
    main()
