"""The player in a real browser: the arm stands where its kinematics put it, limits are marked."""

import io
import json
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from marks import slow
from PIL import Image

from excitant.cli import main
from excitant.design import Trajectory, check, clearance, trajectory_json
from excitant.robots import Robot, builtin_robots, load_robot
from excitant.robots.geometry import floor, scene
from excitant.robots.obstacles_file import load_obstacles

driver = pytest.importorskip("playwright.sync_api", reason="Playwright is not installed")

DATA = Path(__file__).parents[1] / "robots" / "data"
ARMS = ("planar_2r", "panda", "ur10", "scara", "puma560", "no shapes", "meshes")
MESH = '<collision><geometry><mesh filename="wedge.stl"/></geometry></collision></link>'
EXACT = 1e-5  # m: single precision of 7 joints at 1.5 m, and cubics over 0.02 s
LIMIT, BEYOND = (230, 159, 0), (213, 94, 0)


def arm_of(name: str, folder: Path) -> str:
    """What the command line calls an arm."""
    if name in builtin_robots():
        return name
    text = (DATA / "gantry.urdf").read_text("utf-8")
    shutil.copy(DATA / "wedge.stl", folder)
    file = folder / f"{name.replace(' ', '_')}.urdf"
    file.write_text(text.replace("</link>", MESH) if name == "meshes" else text, "utf-8")
    return str(file)


@cache
def motion_of(robot: Robot) -> Trajectory:
    """A motion of 4 s around the middle of the ranges."""
    low, high = np.clip(robot.limits.position, -1.5, 1.5).T
    size = 0.3 * (high - low) / 2
    waves = np.random.default_rng(2).uniform(-1, 1, (4, robot.nv))
    return Trajectory(np.vstack([(low + high) / 2, size * waves]), 4.0)


class Shown:
    """A page that `excitant show` wrote, and the arm in it."""

    def __init__(self, name: str, folder: Path, *options: str) -> None:
        self.arm = arm_of(name, folder)
        self.robot = load_robot(self.arm)
        self.motion = motion_of(self.robot)
        file, self.file = folder / "trajectory.json", folder / "motion.html"
        file.write_text(trajectory_json(self.motion, self.robot), "utf-8")
        self.status = main(["show", self.arm, str(file), "-o", str(self.file), *options])

    def forward_kinematics(self, t: float) -> np.ndarray:
        """Placement of every joint, shape (nv, 4, 4)."""
        data = self.robot.model.createData()
        pin.forwardKinematics(self.robot.model, data, self.motion(t)[0])
        return np.array([place.homogeneous for place in list(data.oMi)[1:]])


class Played:
    """The page in the browser."""

    def __init__(self, page: Any, file: Path) -> None:
        self.page, self.said = page, []
        page.on("pageerror", lambda error: self.said.append(str(error)))
        page.goto(file.as_uri())
        self.until("document.querySelector('.player').player !== undefined")
        self.slider = page.get_by_label("Time")
        self.button = page.locator(".play")

    def until(self, condition: str) -> None:
        """Wait; Playwright's own way to do so is what the page's policy forbids."""
        for _ in range(200):
            if self.page.evaluate(condition):
                return
            self.page.wait_for_timeout(50)
        pytest.fail(f"{condition}: never; {self.said}")

    def ask(self, what: str) -> Any:
        return self.page.evaluate(f"document.querySelector('.player').player.{what}")

    @property
    def time(self) -> float:
        return float(self.ask("time()"))

    @property
    def placements(self) -> np.ndarray:
        return np.array(self.ask("placements()")).reshape(-1, 4, 4).transpose(0, 2, 1)

    @property
    def picture(self) -> np.ndarray:
        """What the canvas shows, shape (height, width, 3)."""
        self.page.wait_for_timeout(100)  # for the next frame
        shot = self.page.locator(".player canvas").screenshot()
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB")).astype(int)

    def differs(self, before: np.ndarray) -> bool:
        return (np.abs(self.picture - before).max(axis=2) > 30).sum() > 50

    def coloured(self, colour: tuple[int, ...]) -> int:
        """Pixels of a surface of this colour, light or in the shade."""
        seen, wanted = self.picture.astype(float), np.array(colour, float)
        bright = seen.max(axis=2)
        near = np.abs(seen / np.maximum(bright, 1)[..., None] - wanted / wanted.max()).max(axis=2)
        return int(((near < 0.06) & (bright > 60)).sum())


@pytest.fixture
def open_page(browser: Any) -> Iterator[Any]:
    opened = []

    def played(file: Path, **look: Any) -> Played:
        viewport = {"width": 900, "height": 800}
        opened.append(browser.new_page(viewport=viewport, offline=True, **look))
        return Played(opened[-1], file)

    yield played
    for page in opened:
        page.close()


@pytest.mark.slow
@pytest.mark.parametrize("arm", ARMS)
def test_the_arm_stands_where_its_kinematics_put_it(arm: str, tmp_path: Path, open_page: Any):
    """At any instant, scrubbed to, reached by keys, and while it plays."""
    shown = Shown(arm, tmp_path)
    assert shown.status == 0
    assert shown.file.stat().st_size < 3_000_000
    played = open_page(shown.file)

    def assert_there() -> None:
        there = shown.forward_kinematics(played.time)
        np.testing.assert_allclose(played.placements, there, atol=EXACT)

    for t in (0.0, *np.random.default_rng(0).uniform(0, 4, 5), 4.0):
        played.ask(f"seek({t})")
        assert played.time == t
        assert_there()
    for act, given, t in (("fill", "1.2345", 1.2345), ("press", "ArrowRight", 1.2545)):
        getattr(played.slider, act)(given)
        assert played.time == pytest.approx(t)
        assert_there()
    before = played.picture
    played.button.click()
    played.until("document.querySelector('.player').player.time() > 1.6")
    played.button.click()
    stopped = played.time
    assert_there()
    assert played.differs(before)
    assert stopped == played.time < 4.0
    assert played.said == []


@pytest.mark.slow
def test_a_joint_beyond_a_limit_is_marked_when_it_is(tmp_path: Path, open_page: Any) -> None:
    """In the picture, in words, in the table, and among the moments to go to."""
    limits = tmp_path / "limits.yaml"
    nominal = Shown("ur10", tmp_path)
    speeds = check(nominal.robot, nominal.motion).velocity
    top = np.abs([speeds.low, speeds.high]).max(axis=0)
    share = np.array([2.0, 2.0, 1.0, 0.5, 2.0, 2.0])
    limits.write_text(json.dumps({"velocity": (top * share).tolist()}), "utf-8")
    shown = Shown("ur10", tmp_path, "--limits", str(limits), "--ignore-collisions")
    assert shown.status == 0
    played = open_page(shown.file)
    moments = played.page.locator(".moments button")
    driver.expect(moments).to_have_count(2)
    for joint, used, level, colour in ((2, 100, "limit", LIMIT), (3, 200, "beyond", BEYOND)):
        name, words = shown.robot.joints[joint], f"{used}.0 % of its velocity limit"
        moment = moments.filter(has_text=f"{name}: {words}, at {speeds.times[joint]:.2f} s")
        driver.expect(moment).to_have_count(1)
        moment.click()
        assert played.time == speeds.times[joint]
        assert played.ask("levels()")[joint] == level
        said = played.page.locator(".player .said")
        driver.expect(said).to_contain_text(name)
        driver.expect(said).to_contain_text("of its velocity limit")
        row = played.page.locator("tbody tr").nth(joint)
        driver.expect(row).to_have_attribute("data-level", level)
        assert played.coloured(colour) > 100
    played.ask("seek(0)")
    k = np.flatnonzero(np.abs(shown.motion(np.linspace(0, 4, 4001), 1)[:, 3]) < 0.4 * top[3])[0]
    played.ask(f"seek({k / 1000})")
    assert "beyond" not in played.ask("levels()")
    assert played.coloured(BEYOND) < 20


@pytest.mark.slow
def test_the_nearest_bodies_are_those_of_the_check(tmp_path: Path, open_page: Any) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("- name: post\n  sphere: {radius: 0.1, position: [0.5, 0.5, 0.5]}\n", "utf-8")
    shown = Shown("panda", tmp_path, "--obstacles", str(cell), "--floor", "-2")
    around = scene(shown.robot, (*load_obstacles(cell), floor(-2.0)))
    near = clearance(around, shown.motion)
    played = open_page(shown.file)
    played.page.locator(".moments button").filter(has_text=" and ".join(near.bodies)).click()
    assert played.time == near.time
    said = played.page.locator(".player .said").text_content()
    assert " and ".join(near.bodies) in said
    distance = 1000 * near.distance / near.scale
    assert float(re.search(r"(\S+) mm", said)[1]) == pytest.approx(abs(distance), rel=6e-3)
    assert ("overlap" in said) == (distance < 0)


@pytest.mark.slow
def test_keys_play_and_turn_and_nothing_moves_by_itself(tmp_path: Path, open_page: Any) -> None:
    played = open_page(Shown("planar_2r", tmp_path).file, reduced_motion="reduce")
    played.page.wait_for_timeout(300)
    assert played.time == 0.0
    canvas = played.page.locator(".player canvas")
    canvas.focus()
    before = played.picture
    canvas.press("Shift+ArrowLeft")
    canvas.press("Shift+ArrowUp")
    assert played.differs(before)
    canvas.press(" ")
    played.until("document.querySelector('.player').player.time() > 0.1")
    canvas.press(" ")
    stopped = played.time
    played.page.wait_for_timeout(100)
    assert played.time == stopped
    for control in played.page.locator(".player :is(button, input, select, canvas)").all():
        named = "e => e.ariaLabel || e.textContent.trim() || e.labels[0].textContent.trim()"
        assert control.evaluate(named)
    played.button.focus()
    for name in ("button", "range", "speed", "view"):
        assert played.page.evaluate("(e => e.name || e.type)(document.activeElement)") == name
        played.page.keyboard.press("Tab")


@pytest.mark.slow
def test_at_the_end_it_stops_and_then_starts_again(tmp_path: Path, open_page: Any) -> None:
    played = open_page(Shown("planar_2r", tmp_path).file)
    played.ask("seek(3.9)")
    played.button.click()
    driver.expect(played.button).to_have_text("▶ Play")
    assert played.time == 4.0
    played.button.click()
    played.until("document.querySelector('.player').player.time() < 3")


@pytest.mark.slow
def test_without_3d_the_numbers_are_there(tmp_path: Path, open_page: Any, browser: Any) -> None:
    shown = Shown("scara", tmp_path)
    page = browser.new_page(offline=True)
    page.add_init_script("HTMLCanvasElement.prototype.getContext = () => null")
    played = Played(page, shown.file)
    driver.expect(page.locator(".player .view")).to_contain_text("WebGL is off")
    played.slider.fill("1.5")
    np.testing.assert_allclose(played.placements, shown.forward_kinematics(1.5), atol=EXACT)
    position = page.locator("tbody tr").nth(2).locator("td").first.text_content()
    assert position == f"{shown.motion(1.5)[0, 2]:.3f} m".replace("-", "−")
    page.close()


@pytest.mark.slow
def test_without_javascript_the_moments_are_a_list(tmp_path: Path, browser: Any) -> None:
    shown = Shown("ur10", tmp_path)
    page = browser.new_page(offline=True, java_script_enabled=False)
    page.goto(shown.file.as_uri())
    driver.expect(page.get_by_text("where JavaScript is on")).to_be_visible()
    assert page.locator(".moments li:visible").count() >= 1
    assert page.locator(".player :is(button, input, select, table):visible").count() == 0
    page.close()


@pytest.mark.parametrize("name", [slow(x) if x != "panda" else x for x in builtin_robots()])
def test_pages_of_built_in_arms_are_small(name: str, tmp_path: Path) -> None:
    shown = Shown(name, tmp_path)
    assert shown.status == 0
    assert shown.file.stat().st_size < 1_000_000


def test_obstacles_stand_around_an_arm_without_shapes_too(tmp_path: Path, capsys: Any) -> None:
    cell = tmp_path / "cell.yaml"
    cell.write_text("- box: {size: [1, 1, 1], position: [2, 0, 0]}\n", "utf-8")
    shown = Shown("no shapes", tmp_path, "--obstacles", str(cell), "--floor", "-0.5")
    assert "self-collision, no link has a collision shape; floor" in capsys.readouterr().out
    source = shown.file.read_text("utf-8")
    data = json.loads(re.search(r'<script type="application/json">(.*?)</script>', source)[1])
    assert [obstacle["shape"] for obstacle in data["obstacles"]] == ["box", "half_space"]
    assert "Without shapes, drawn as rods from joint to joint: base, " in source
