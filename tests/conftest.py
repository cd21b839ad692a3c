"""Recordings: where those of real arms are, and those of virtual arms."""

import json
import os
import shlex
import socket
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import hypothesis
import numpy as np
import pytest

from excitant.cli import main
from excitant.design import random_trajectory
from excitant.identify import Recording, recording_from_table
from excitant.robots import DHChain, Robot, load_robot
from excitant.robots.dh import Convention
from excitant.robots.parameters import from_pseudo_inertia
from excitant.robots.virtual_arm import HiddenEffect, Sensors, ideal_sensors, virtual_arm

hypothesis.settings.register_profile("excitant", deadline=None, derandomize=True, max_examples=25)
hypothesis.settings.load_profile("excitant")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--every", type=int, default=1, help="of a slow test of many cases, each N-th")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out, and count as deselected, what ``--every`` asks to."""
    number, kept, left = Counter[str](), list[pytest.Item](), list[pytest.Item]()
    for item in items:
        name = item.nodeid.partition("[")[0]
        marks = {mark.name for mark in item.iter_markers()}
        whole = "slow" not in marks or "whole" in marks
        (kept if whole or number[name] % config.getoption("every") == 0 else left).append(item)
        number[name] += not whole
    config.hook.pytest_deselected(items=left)
    items[:] = kept


@pytest.fixture(scope="session")
def data_folder() -> Path:
    """Recordings of real arms: required in continuous integration, else skipped without them."""
    beside = Path(__file__).parents[2] / "shared" / "data"
    folder = Path(os.environ.get("EXCITANT_DATA", beside))
    if not folder.is_dir():
        reason = f"no recordings of real arms in {folder}; set EXCITANT_DATA"
        if os.environ.get("CI") or os.environ.get("EXCITANT_DATA_REQUIRED") == "1":
            pytest.fail(reason)
        pytest.skip(reason)
    return folder


@pytest.fixture(scope="session", autouse=True)
def no_network() -> Iterator[None]:
    """No test opens a connection to another machine."""
    real = socket.socket.connect

    def connect(self: socket.socket, address: Any) -> None:
        assert self.family == socket.AF_UNIX or address[0] in ("127.0.0.1", "::1"), address
        real(self, address)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(socket.socket, "connect", connect)
        yield


@pytest.fixture(scope="session", autouse=True)
def coarse_steps() -> Iterator[None]:
    """Virtual arms take a quarter of their steps: torque feels it by 1e-3 of its size at most."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("excitant.robots.plant.arm.LONGEST_STEP", 2e-3)
        yield


@pytest.fixture(scope="module")
def own_steps() -> Iterator[None]:
    """Virtual arms take the steps of which their laws are told."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("excitant.robots.plant.arm.LONGEST_STEP", 5e-4)
        yield


@pytest.fixture(scope="session")
def planar() -> Robot:
    return load_robot("planar_2r")


@pytest.fixture(scope="session")
def ur10() -> Robot:
    return load_robot("ur10")


class Ran(NamedTuple):
    """What a command came to."""

    status: int
    out: str
    err: str

    @property
    def result(self) -> Any:
        """What ``--json`` printed."""
        return json.loads(self.out)


@pytest.fixture
def own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    """Time limits of a design in this process count its processor time, whatever else runs."""
    clock = SimpleNamespace(time=time.process_time)
    for module in ("bound", "optimal", "search"):
        monkeypatch.setattr(f"excitant.design.{module}.time", clock)


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder of its own."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def excitant(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ran]:
    """``excitant("analyze planar_2r", "-o", folder)``: one command, run in this process."""

    def run(line: str, *more: object) -> Ran:
        capsys.readouterr()
        status = main([*shlex.split(line), *map(str, more)])
        return Ran(status, *capsys.readouterr())

    return run


@pytest.fixture(scope="session")
def runs() -> Callable[..., list[Recording]]:
    """``runs(robot, seed, hidden=..., sensors=..., tolerance=...)``: two motions, or one, recorded.

    The arm is virtual and shares no code with the effects that are fitted; by default it is its
    nominal description, seen by true sensors.
    """

    def recorded(
        robot: Robot, seed: int | Sequence[int], hidden: Sequence[HiddenEffect] | None = (),
        sensors: Sensors | None = None, tolerance: float = 0.0, duration: float = 10.0,
        names: Sequence[str] = ("excitation", "holdout"),
    ) -> list[Recording]:  # fmt: skip
        rng = np.random.default_rng(seed)
        sensors = sensors or ideal_sensors(robot)
        arm = virtual_arm(robot, rng, hidden=hidden, sensors=sensors, tolerance=tolerance)
        found = []
        for name in names:
            table = arm.record(random_trajectory(robot, rng, duration, 5), duration, rng)
            file = f"{name}.parquet"
            found.append(recording_from_table(table, robot.nv, file=file, name=name))
        return found

    return recorded


@pytest.fixture(scope="session")
def random_bodies() -> Callable[[int, int], np.ndarray]:
    """``random_bodies(seed, links)``: physically consistent standard parameters (10 links,)."""

    def bodies(seed: int, links: int) -> np.ndarray:
        rng = np.random.default_rng(seed)
        size = np.array([0.1, 0.1, 0.1, 1.0])
        root = rng.standard_normal((links, 4, 4)) * size
        P = root @ root.transpose(0, 2, 1) * size[:, None] * size
        return from_pseudo_inertia(P + 1e-3 * np.eye(4)).ravel()

    return bodies


def _random_pose(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    T[:3, 0] *= np.linalg.det(T[:3, :3])
    T[:3, 3] = rng.standard_normal(3)
    return T


@pytest.fixture(scope="session")
def random_chain(random_bodies: Callable[[int, int], np.ndarray]) -> Callable[..., DHChain]:
    """``random_chain(seed, joints, convention)``: joints of both kinds, any twist, any mounting."""

    def chain(seed: int, nv: int, convention: Convention = "standard") -> DHChain:
        rng = np.random.default_rng(seed)
        special = rng.choice([0.0, np.pi / 2, -np.pi / 2, np.pi], nv)
        a, d = rng.uniform(-0.6, 0.6, (2, nv)) * rng.choice([0.0, 1.0, 1.0], (2, nv))
        names = (tuple(f"{letter}{i}" for i in range(nv)) for letter in "jl")
        return DHChain(
            "chain", convention, *names, revolute=rng.random(nv) < 0.7, a=a, d=d,
            alpha=np.where(rng.random(nv) < 0.5, special, rng.uniform(-3, 3, nv)),
            theta=rng.uniform(-3, 3, nv), phi=random_bodies(seed, nv),
            gravity=rng.uniform(-10, 10, 3), base=_random_pose(rng), tool=_random_pose(rng),
        )  # fmt: skip

    return chain
