"""What a notebook shows: nouns as small tables, whole reports, one short import."""

import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

import excitant as ex
from excitant import api
from excitant.robots.shown import html_table

NOTEBOOK = """
import excitant as ex
import numpy as np

robot, rng = ex.load_robot("planar_2r"), np.random.default_rng(3)
design = ex.design_trajectory(robot, duration=8.0, harmonics=2, starts=1, jobs=1, time_limit=0.0)
table = ex.virtual_arm(robot, rng).record(design.trajectory, 8.0, rng)
run = ex.recording_from_table(table, robot.nv, file="run", name="run")
estimate = ex.identify_robot(robot, [run])
"""
SHOWN = {
    "robot": "Robot planar_2r: 2 joints",
    "design.trajectory": "Fourier trajectory of 8 s",
    "run": "Recording run: ",
    "estimate": "Estimate of planar_2r",
    "ex.analyze(robot, estimate=estimate)": "Identifiability of planar_2r",
    "ex.diagnose(robot, [run])": "Errors of the model of planar_2r",
}


@pytest.fixture(scope="module")
def shown() -> dict[str, str]:
    """What lines would show, as Jupyter asks for it."""
    names: dict[str, object] = {}
    exec(NOTEBOOK, names)
    return {line: eval(line, names)._repr_html_() for line in (*SHOWN, "ex.report(estimate)")}


@pytest.mark.slow
def test_every_noun_shows_itself(shown: dict[str, str]) -> None:
    for line, title in SHOWN.items():
        tags = list(ET.fromstring(f"<div>{shown[line]}</div>").iter())  # refuses what is not closed
        caption = next(tag for tag in tags if tag.tag == "caption")
        assert title in caption.text
        assert {tag.tag for tag in tags} >= {"table", "caption", "th"}
        assert not {tag.tag for tag in tags} & {"script", "img", "svg"}


def test_tables_hold_the_numbers_of_the_noun(shown: dict[str, str]) -> None:
    robot, texts = ex.load_robot("planar_2r"), set(ET.fromstring(shown["robot"]).itertext())
    for j, joint in enumerate(robot.joints):
        numbers = (robot.limits.velocity[j], robot.phi[10 * j])
        assert texts >= {joint, *(f"{number:.4g}" for number in numbers)}


def test_a_report_is_a_whole_page_in_a_frame(shown: dict[str, str], tmp_path: Path) -> None:
    assert shown["ex.report(estimate)"].startswith('<iframe srcdoc="&lt;!')
    assert "&lt;svg" in shown["ex.report(estimate)"]
    page = ex.report(ex.analyze(ex.load_robot("planar_2r")))
    assert page.save(tmp_path / "page.html").read_text("utf-8") == page.html
    assert not re.search(r"""(?:src|href)=["']https?:""", page.html)
    with pytest.raises(ex.ExcitantError, match=r"a int has no report"):
        ex.report(3)  # type: ignore[arg-type]


def test_texts_are_escaped() -> None:
    html = html_table("<b>", ["a & b"], [["<script>"], [1.23456], [None]])
    assert list(ET.fromstring(html).itertext()) == ["<b>", "a & b", "<script>", "1.235", "–"]


def test_names_are_those_of_the_packages() -> None:
    for name in ex.__all__:
        assert getattr(ex, name) is not None
        assert name in dir(ex)
    assert ex.design_trajectory is api.design_trajectory
    assert ex.identify_robot is api.identify_robot
    assert ex.load_recording is api.load_recording
    with pytest.raises(AttributeError, match="load_robots"):
        ex.load_robots  # noqa: B018


@pytest.mark.parametrize(
    ("code", "without"),
    [
        ("import excitant", "numpy"),
        ("ex.load_robot('planar_2r')._repr_html_()", "matplotlib"),
        ("ex.plot.torque", "matplotlib"),
    ],
)
def test_what_is_not_needed_is_not_imported(code: str, without: str) -> None:
    code = f"import sys, excitant as ex; {code}; print({without!r} in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "False\n"
