"""Arguments of the commands about recordings."""

from __future__ import annotations

import argparse

from excitant.arguments import (
    Parser,
    Verbs,
    columns_option,
    dataset_argument,
    names,
    new_verb,
    numbers,
    output_option,
)


def identify(verbs: Verbs[Parser]) -> None:
    """Arguments of ``identify``."""
    verb = new_verb(verbs, "identify", "from recordings to a physically consistent model",
                    "excitant identify ur10 run1.parquet --validate run2.parquet",
                    "excitant identify my_folder --effects auto -o runs/model",
                    "excitant identify ur10 run1.parquet --payload --unloaded empty.parquet",
                    "excitant identify ur10 run1.parquet --online --forgetting 5")  # fmt: skip
    _fit_options(verb)
    verb.add_argument("--effects", metavar="NAME,...",
                      help="effects to estimate (default: viscous_friction,coulomb_friction,"
                      "torque_offset,rotor_inertia), or auto: these and what an inner hold-out "
                      "calls for")  # fmt: skip
    verb.add_argument("--estimator", metavar="NAME",
                      help="of the base parameters: ols, wls, irls (robust), gls (coloured noise), "
                      "iv and oe (noisy positions), tls, ml (periods averaged), or auto: "
                      "that of wls, irls, iv, oe and ml that predicts an inner hold-out best, "
                      "where they can be compared (default: auto)")  # fmt: skip
    verb.add_argument("--trajectory", metavar="FILE",
                      help="trajectory.json that the arm was told: no cut-off is chosen below what "
                      "its harmonics need (without it, they are looked for in what "
                      "repeats)")  # fmt: skip
    verb.add_argument("--knowledge", metavar="FILE",
                      help="YAML with what is known of the bodies: masses, their sum, where "
                      "centres of mass lie; and the kind of prior")  # fmt: skip
    verb.add_argument("--formats", metavar="NAME,...",
                      help="files beside URDF and model.yaml (default: mjcf,sdf)")  # fmt: skip
    verb.add_argument("--force", action="store_true",
                      help="publish the model even if the given one predicts the hold-out "
                      "better")  # fmt: skip
    verb.add_argument("--online", action="store_true",
                      help="sample by sample, as in a control loop: estimates over time, and "
                      "where the motion did not excite enough")  # fmt: skip
    verb.add_argument("--link-by-link", action="store_true",
                      help="from the last link inward, each from its own joint's torque; one "
                      "joint at a time may move")  # fmt: skip
    verb.add_argument("--forgetting", type=float, metavar="S",
                      help="with --online: time constant of forgetting [s] (default: "
                      "nothing is forgotten)")  # fmt: skip
    verb.add_argument("--payload", action="store_true",
                      help="also what the last link carries in these recordings, on top of the "
                      "model given or of --unloaded")  # fmt: skip
    verb.add_argument("--unloaded", nargs="+", default=[], metavar="RECORDING",
                      help="with --payload: the arm without load, any motion")  # fmt: skip
    drive = verb.add_argument_group(
        "drive gains from a known payload (where currents are recorded)"
    )
    drive.add_argument("--payload-recording", nargs="+", default=[], metavar="RECORDING",
                       help="the arm with the payload, any motion")  # fmt: skip
    drive.add_argument("--payload-mass", type=float, metavar="KG", help="its mass [kg]")
    drive.add_argument("--payload-mass-std", type=float, default=0.0, metavar="KG",
                       help="standard deviation of the mass [kg] (default: 0)")  # fmt: skip
    drive.add_argument("--payload-com", type=numbers, metavar="X,Y,Z",
                       help="its centre of mass in the frame of the last joint [m]; write "
                       "--payload-com=X,Y,Z where X is negative")  # fmt: skip


def analyze(verbs: Verbs[Parser]) -> None:
    """Arguments of ``analyze``."""
    verb = new_verb(verbs, "analyze", "what can be known, link by link",
                    "excitant analyze panda",
                    "excitant analyze ur10 --trajectory trajectory.csv",
                    "excitant analyze ur10 --recording run1.parquet run2.parquet",
                    "excitant analyze cmu_dd_arm_ii --moving joint1,joint3")  # fmt: skip
    dataset_argument(verb)
    motion = verb.add_mutually_exclusive_group()
    motion.add_argument("--trajectory", metavar="FILE", help="how well this motion shows it")
    motion.add_argument("--recording", nargs="+", metavar="FILE", help="or these recordings")
    columns_option(verb)
    verb.add_argument("--noise", type=numbers, metavar="S1,S2,...",
                      help="with --trajectory: torque noise of each joint (default: 1 %% of its "
                      "limit)")  # fmt: skip
    verb.add_argument("--moving", type=names, metavar="J1,J2,...",
                      help="joints that move (default: all, or as the motion says)")  # fmt: skip
    verb.add_argument("--measured", type=names, metavar="J1,J2,...",
                      help="joints whose torque is measured (default: all)")  # fmt: skip
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"))
    output_option(verb)


def diagnose(verbs: Verbs[Parser]) -> None:
    """Arguments of ``diagnose``."""
    verb = new_verb(verbs, "diagnose", "what the given model gets wrong, by cause",
                    "excitant diagnose ur10 run1.parquet --validate run2.parquet",
                    "excitant diagnose my_folder --no-experiments --repair",
                    "excitant diagnose my_arm.urdf run1.csv --map columns.yaml")  # fmt: skip
    _fit_options(verb)
    verb.add_argument("--no-experiments", action="store_true",
                      help="look for no motion that would settle what is undecided")  # fmt: skip
    verb.add_argument("--experiment-time", type=float, default=15.0, metavar="S",
                      help="time to look for such motions (default: 15)")  # fmt: skip


def _fit_options(verb: argparse.ArgumentParser) -> None:
    dataset_argument(verb)
    verb.add_argument("recordings", nargs="*", metavar="RECORDING",
                      help="Parquet, CSV, NPZ, MAT, ROS bag or MCAP; all of the folder when none "
                      "is named")  # fmt: skip
    columns_option(verb)
    verb.add_argument("--validate", nargs="+", default=[], metavar="RECORDING",
                      help="hold-out (default: the last 30 %% of each recording)")  # fmt: skip
    verb.add_argument("--cutoff", type=float, metavar="HZ",
                      help="cut-off of the torque filter (default: 10 Hz, at which accuracy is "
                      "judged; identify chooses the fit's from the data)")  # fmt: skip
    verb.add_argument("--repair", action="store_true",
                      help="repair the faults of the recordings to fit that can be repaired, and "
                      "say so; without it they are only reported")  # fmt: skip
    output_option(verb)
