"""Arguments of the commands about motions."""

from __future__ import annotations

from excitant.arguments import (
    Parser,
    Verbs,
    harmonics,
    limits_option,
    natural,
    new_verb,
    numbers,
    output_option,
    robot_argument,
    span,
    surroundings_options,
)


def design(verbs: Verbs[Parser]) -> None:
    """Arguments of ``design``."""
    verb = new_verb(verbs, "design", "an excitation trajectory within all limits",
                    "excitant design ur10 --duration 10 --harmonics 5 --time-limit 30",
                    "excitant design my_arm.urdf --limits limits.yaml --criterion a -o runs/motion",
                    "excitant design panda --after run1.parquet --formats ros2,npz",
                    "excitant design ur10 --from 0,-1.57,1.57,0,0,0 --repeat 5")  # fmt: skip
    robot_argument(verb)
    verb.add_argument("--duration", type=span, default=10.0, metavar="S[:S]",
                      help="period [s], or the shortest and the longest to choose from "
                      "(default: 10)")  # fmt: skip
    verb.add_argument("--harmonics", type=harmonics, default=5, metavar="H",
                      help="Fourier terms, or 'search' to add them while they pay "
                      "(default: 5)")  # fmt: skip
    verb.add_argument("--series", default="fourier", choices=("fourier", "spline"),
                      help="spline: B-splines of 2 H pieces, for tight cells")  # fmt: skip
    verb.add_argument("--max-frequency", type=float, default=2.5, metavar="HZ",
                      help="highest that a search for harmonics adds (default: 2.5)")  # fmt: skip
    verb.add_argument("--criterion", default="condition", choices=("condition", "d", "a", "e"),
                      help="what to make small: the condition number, or of the covariance the "
                      "determinant (d), the trace (a) or the largest eigenvalue (e) "
                      "(default: condition)")  # fmt: skip
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"),
                      help="what to make visible: all that identify estimates, or the links "
                      "only (default: friction)")  # fmt: skip
    verb.add_argument("--noise", type=numbers, metavar="S1,S2,...",
                      help="torque noise of each joint, which weights its equations")  # fmt: skip
    verb.add_argument("--after", nargs="+", metavar="RECORDING",
                      help="recordings made already: design what should run next")  # fmt: skip
    verb.add_argument("--link-by-link", action="store_true",
                      help="one motion per link, from the last inward, each of this "
                      "duration")  # fmt: skip
    limits_option(verb)
    verb.add_argument("--bound", action="store_true",
                      help="also a numerical lower bound on the condition number of any such "
                      "motion (a minute more)")  # fmt: skip
    surroundings_options(verb)
    verb.add_argument("--from", dest="start", metavar="Q1,Q2,...",
                      help="present pose: writes approach.csv and return.csv too")  # fmt: skip
    verb.add_argument("--formats", metavar="NAME,...",
                      help="further files: ros2 (YAML), mcap, urscript, npz")  # fmt: skip
    verb.add_argument("--rate", type=float, default=100.0, help="rate of trajectory.csv [Hz]")
    verb.add_argument("--repeat", type=int, default=1, metavar="N",
                      help="periods in trajectory.csv, for averaging (default: 1)")  # fmt: skip
    verb.add_argument("--starts", type=int, help="number of searches (default: 16)")
    verb.add_argument("--jobs", type=int, help="processes (default: all processors)")
    verb.add_argument("--cluster", metavar="ADDRESS", help="Dask scheduler to search on, "
                      "such as tcp://10.0.0.5:8786")  # fmt: skip
    verb.add_argument("--seed", type=natural, default=0)
    verb.add_argument("--time-limit", type=float, metavar="S", help="return the best so far [s]")
    output_option(verb)


def check(verbs: Verbs[Parser]) -> None:
    """Arguments of ``check``."""
    verb = new_verb(verbs, "check", "limits between samples and conditioning of any trajectory",
                    "excitant check ur10 trajectory.csv",
                    "excitant check my_arm.urdf trajectory.json --limits limits.yaml "
                    "--json")  # fmt: skip
    robot_argument(verb)
    verb.add_argument("trajectory", metavar="TRAJECTORY", help="CSV or JSON")
    limits_option(verb)
    surroundings_options(verb)
    verb.add_argument("--columns", default="friction", choices=("friction", "inertial"))
    output_option(verb)


def simulate(verbs: Verbs[Parser]) -> None:
    """Arguments of ``simulate``."""
    verb = new_verb(verbs, "simulate", "what a virtual arm would record",
                    "excitant simulate ur10 trajectory.csv -o recording.parquet",
                    "excitant simulate ur10 trajectory.csv --hidden --seed 3 "
                    "-o run1.csv")  # fmt: skip
    robot_argument(verb)
    verb.add_argument("trajectory", metavar="TRAJECTORY", help="CSV or JSON")
    verb.add_argument("-o", "--output", metavar="FILE", required=True, help=".parquet or .csv")
    verb.add_argument("--seed", type=natural, default=0, help="draws noise and what is hidden")
    verb.add_argument("--hidden", action="store_true",
                      help="let the arm differ from its model: values off by some per cent, and "
                      "one effect that is not in the model")  # fmt: skip


def rehearse(verbs: Verbs[Parser]) -> None:
    """Arguments of ``rehearse``."""
    verb = new_verb(verbs, "rehearse", "a motion tried on a virtual arm, up to what it recovers",
                    "excitant rehearse ur10 trajectory.csv",
                    "excitant rehearse my_arm.urdf trajectory.json --limits limits.yaml "
                    "--seed 3")  # fmt: skip
    robot_argument(verb)
    verb.add_argument("trajectory", metavar="TRAJECTORY", help="CSV or JSON, from rest to rest")
    limits_option(verb)
    verb.add_argument("--seed", type=natural, default=0,
                      help="draws the arm, its noise and the effect to name")  # fmt: skip
    output_option(verb)
