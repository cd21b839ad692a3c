"""What is known of bodies holds in the fit, stays optimal, and contradictions are named."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from excitant.cli import main
from excitant.exceptions import BadInput, UnknownName
from excitant.identify import Recording
from excitant.identify.knowledge import (
    PRIORS,
    Box,
    Ellipsoid,
    Knowledge,
    LinkKnowledge,
    Quantity,
    load_knowledge,
)
from excitant.identify.physical import PhysicalFit, fit_physical
from excitant.identify.prior import EffectPrior, prior_parameters
from excitant.robots import Array, Motion, Robot, load_robot
from excitant.robots.effects import standard_effects
from excitant.robots.parameters import pseudo_inertia
from excitant.robots.torque import observation_columns

KKT = 1e-8
NOISE = 0.1  # N·m


class Data:
    """Whitened rows of an arm that differs from its model, and of its friction."""

    def __init__(self, robot: Robot, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        effects = standard_effects(robot.joints)
        motion = Motion(np.arange(300) / 100, *robot.random_motion(rng, 300))
        W = observation_columns(robot, effects, motion)
        W = W.reshape(-1, W.shape[2])
        parameters = [p for e in effects for p in e.parameters(robot)]
        e = len(parameters)
        self.robot, self.prior = robot, prior_parameters(robot)
        truth = np.concatenate([(self.prior * rng.uniform(0.6, 1.5, (robot.nv, 1))).ravel()])
        self.truth = np.concatenate([truth, rng.uniform(0, 1, e)])
        self.R = np.linalg.qr(W, mode="r") / NOISE
        self.z = self.R @ self.truth + rng.standard_normal(len(self.R))
        lower = np.array([p.lower for p in parameters])
        self.effects = EffectPrior(np.zeros(e), np.full(e, 1e3), lower)

    def fit(self, knowledge: Knowledge, sigma: float = 1.0) -> PhysicalFit:
        return fit_physical(
            self.R, self.z, self.prior, self.effects, sigma,
            knowledge=knowledge, links=self.robot.links,
        )  # fmt: skip


@pytest.fixture(scope="module")
def ur10_data() -> Data:
    return Data(load_robot("ur10"))


def masses(fit: PhysicalFit, robot: Robot) -> Array:
    return fit.x[: 10 * robot.nv : 10]


def assert_optimal(fit: PhysicalFit) -> None:
    assert fit.kkt.stationarity <= KKT
    assert fit.kkt.complementarity <= KKT
    assert fit.kkt.primal <= KKT


@pytest.mark.parametrize("kind", PRIORS)
def test_known_masses_hold_exactly_or_as_far_as_they_are_sure(kind: str, ur10_data: Data) -> None:
    d = ur10_data
    first, second, third = d.robot.links[:3]
    free = d.fit(Knowledge(kind))
    total = 1.1 * float(masses(free, d.robot).sum())
    known = Knowledge(
        kind,
        Quantity(total),
        {
            first: LinkKnowledge(mass=Quantity(7.0)),
            second: LinkKnowledge(mass=Quantity(12.0, 1e-4)),
            third: LinkKnowledge(mass=Quantity(4.0, 1e6)),
        },
    )
    fit = d.fit(known)
    assert_optimal(fit)
    m = masses(fit, d.robot)
    assert m.sum() == pytest.approx(total, abs=1e-7)
    assert m[0] == pytest.approx(7.0, abs=1e-8)
    assert m[1] == pytest.approx(12.0, abs=1e-3)
    assert fit.covariance[0, 0] <= 1e-12
    assert np.sqrt(fit.covariance[10, 10]) <= 1e-4 * (1 + 1e-6)
    row = np.zeros(len(fit.x))
    row[: 10 * d.robot.nv : 10] = 1
    assert row @ fit.covariance @ row <= 1e-10 * total**2
    unsure = d.fit(Knowledge(kind, Quantity(total, 1e6)))
    np.testing.assert_allclose(masses(unsure, d.robot), masses(free, d.robot), rtol=1e-4)


@pytest.mark.parametrize("kind", PRIORS)
def test_centres_of_mass_stay_where_they_are_known_to_be(kind: str, ur10_data: Data) -> None:
    d = ur10_data
    free = d.fit(Knowledge(kind)).x[: 10 * d.robot.nv].reshape(-1, 10)
    centre = free[:, 1:4] / free[:, :1]
    names = d.robot.links
    box = Box(tuple(centre[1] + 0.02), tuple(centre[1] + [0.05, 0.06, 0.02]))  # flat along z
    ball = Ellipsoid(tuple(centre[2] + 0.1), (0.03, 0.05, 0.04))
    shell = Ellipsoid(tuple(centre[3]), (0.02, 0.03, 0.01))
    known = Knowledge(
        kind,
        links={
            names[1]: LinkKnowledge(com_box=box),
            names[2]: LinkKnowledge(com_ellipsoid=ball),
            names[3]: LinkKnowledge(body_ellipsoid=shell),
        },
    )
    fit = d.fit(known)
    assert_optimal(fit)
    phi = fit.x[: 10 * d.robot.nv].reshape(-1, 10)
    found = phi[:, 1:4] / phi[:, :1]
    tight = 1e-6
    assert (found[1] >= np.array(box.low) - tight).all()
    assert (found[1] <= np.array(box.high) + tight).all()
    inside = np.linalg.norm((found[2] - ball.centre) / np.array(ball.radii))
    assert 0.9 < inside <= 1 + tight  # the free centre lies outside
    P = pseudo_inertia(phi[3])
    reach = np.array(shell.radii)
    offset = np.outer(shell.centre, P[:3, 3])
    second = P[:3, :3] - offset - offset.T + P[3, 3] * np.outer(shell.centre, shell.centre)
    assert np.sum(np.diag(second) / reach**2) <= phi[3, 0] * (1 + tight)


def test_constraints_that_do_not_bind_change_nothing(ur10_data: Data) -> None:
    d = ur10_data
    wide = LinkKnowledge(
        com_box=Box((-9, -9, -9), (9, 9, 9)),
        com_ellipsoid=Ellipsoid((0, 0, 0), (9, 9, 9)),
        body_ellipsoid=Ellipsoid((0, 0, 0), (9, 9, 9)),
    )
    known = Knowledge(links=dict.fromkeys(d.robot.links, wide))
    np.testing.assert_allclose(d.fit(known).x, d.fit(Knowledge()).x, rtol=1e-5, atol=1e-6)


CORNER = [[0, 0, 0], [0.1, 0.1, 0.1]]
AWAY = {"centre": [0.5, 0, 0], "radii": [0.1, 0.1, 0.1]}
POINT = {
    "com_box": [[1, 0, 0], [1, 0, 0]],
    "body_ellipsoid": {"centre": [0, 0, 0], "radii": [0.2, 0.2, 0.2]},
}


@pytest.mark.parametrize("kind", PRIORS)
@pytest.mark.parametrize(
    ("total", "about", "named", "silent"),
    [
        (5.0, {1: {"mass": 3.0}, 2: {"mass": 4.0}}, ("total_mass", "{1}", "{2}"), "{0}"),
        (
            None,
            {0: {"com_box": CORNER}, 2: {"com_box": CORNER, "com_ellipsoid": AWAY}},
            ("com_box of {2}", "com_ellipsoid of {2}"),
            "{0}",
        ),
        (40.0, {3: POINT}, ("com_box of {3}", "body_ellipsoid of {3}"), "total_mass"),
    ],
)
def test_contradictions_are_named_in_one_line(
    tmp_path: Path, ur10_data: Data, kind: str, total: float | None, about: dict,
    named: tuple[str, ...], silent: str,
) -> None:  # fmt: skip
    links, file = ur10_data.robot.links, tmp_path / "known.yaml"
    content = {"prior": kind, "links": {links[k]: v for k, v in about.items()}}
    file.write_text(yaml.safe_dump(content | ({"total_mass": total} if total else {})))
    with pytest.raises(BadInput, match="contradict each other") as refused:
        ur10_data.fit(load_knowledge(file, links))
    said = str(refused.value)
    assert said.startswith(str(file))
    assert "correct one of them" in said
    assert "\n" not in said
    assert all(word.format(*links) in said for word in named)
    assert f"of {silent.format(*links)} " not in said


def test_known_twice_over_is_no_contradiction(ur10_data: Data) -> None:
    """All masses and their sum, exactly."""
    d = ur10_data
    values = np.array([7.0, 12.0, 4.0, 2.0, 2.0, 0.3])
    about = {
        link: LinkKnowledge(mass=Quantity(value))
        for link, value in zip(d.robot.links, values.tolist(), strict=True)
    }
    fit = d.fit(Knowledge(total_mass=Quantity(float(values.sum())), links=about))
    np.testing.assert_allclose(masses(fit, d.robot), values, atol=1e-7)
    assert_optimal(fit)


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    file = tmp_path / "known.yaml"
    content = {
        "prior": "euclidean",
        "total_mass": {"value": 33.5, "std": 0.5},
        "links": {
            "forearm": {
                "mass": 2.3,
                "com_box": [[-0.1, -0.1, 0.0], [0.1, 0.1, 0.4]],
                "com_ellipsoid": {"centre": [0.0, 0.0, 0.2], "radii": [0.1, 0.1, 0.2]},
                "body_ellipsoid": {"centre": [0.0, 0.0, 0.2], "radii": [0.1, 0.1, 0.3]},
            }
        },
    }
    file.write_text(yaml.safe_dump(content))
    known = load_knowledge(file, ["base", "forearm"])
    assert known.total_mass == Quantity(33.5, 0.5)
    assert known.masses["mass of forearm"] == Quantity(2.3)
    assert known.entry() == content
    assert Knowledge().entry() == {"prior": "pullback"}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: [", "not valid YAML .line 1: "),
        ("- 1", "expected entries 'name: value'"),
        ("prior: euclid", "did you mean 'euclidean'"),
        ("totalmass: 3", "did you mean 'total_mass'"),
        ("total_mass: -3", "total_mass: expected a number above 0"),
        ("total_mass: {value: 3, std: -1}", "total_mass.std: expected a number >= 0"),
        ("total_mass: {value: heavy}", "total_mass.value: expected a number, got text"),
        ("total_mass: .inf", "total_mass: expected a finite number"),
        ("links: {fore: {mass: 1}}", "did you mean 'forearm'"),
        ("links: {forearm: {weight: 1}}", "links.forearm: unknown entry 'weight'"),
        ("links: {forearm: {com_box: [[0, 0, 1], [1, 1, 0]]}}", "along z .* exchange them"),
        ("links: {forearm: {com_box: [0, 1]}}", "links.forearm.com_box.* expected a list"),
        ("links: {forearm: {com_box: 3}}", "com_box: expected a list"),
        ("links: {forearm: {com_ellipsoid: {centre: [0, 0, 0]}}}", "lacks 'radii'"),
        (
            "links: {forearm: {body_ellipsoid: {centre: [0, 0, 0], radii: [0, 1, 1]}}}",
            "body_ellipsoid.radii.*: expected a number above 0",
        ),
    ],
)
def test_errors_name_file_key_and_remedy(tmp_path: Path, text: str, said: str) -> None:
    file = tmp_path / "known.yaml"
    file.write_text(text)
    with pytest.raises(BadInput, match=said) as refused:
        load_knowledge(file, ["base", "forearm"])
    assert str(refused.value).startswith(str(file))


def test_missing_file_unknown_prior_and_unknown_link(ur10_data: Data) -> None:
    with pytest.raises(BadInput, match="no such file; give a YAML file of what is known"):
        load_knowledge("nowhere.yaml", [])
    with pytest.raises(UnknownName, match="unknown prior"):
        Knowledge("flat")
    with pytest.raises(BadInput, match="no link 'tail'"):
        ur10_data.fit(Knowledge(links={"tail": LinkKnowledge(mass=Quantity(1.0))}))


def test_command(
    tmp_path: Path, planar: Robot, exact: Callable[..., Recording],
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    recording = exact(planar, np.arange(0, 12, 0.01))
    columns = {"t": recording.t}
    for k in range(2):
        columns |= {f"q{k + 1}": recording.q[:, k], f"tau{k + 1}": recording.tau[:, k]}
    log, file, out = tmp_path / "log.csv", tmp_path / "known.yaml", tmp_path / "run"
    pd.DataFrame(columns).to_csv(log, index=False)
    content = {"prior": "euclidean", "total_mass": 7.5, "links": {"link2": {"mass": 2.5}}}
    file.write_text(yaml.safe_dump(content))
    call = ["identify", "planar_2r", str(log), "--knowledge", str(file), "-o", str(out)]
    assert main(call) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["knowledge"] == content
    value = {p["name"]: p["value"] for p in result["parameters"]}
    assert value["link2.m"] == pytest.approx(2.5, abs=1e-6)
    assert value["link1.m"] == pytest.approx(5.0, abs=1e-6)
    known = {p["name"]: p["prior_dominated"] for p in result["parameters"]}
    assert known["link2.m"]
    assert any("total mass 7.5 kg; link2: mass 2.5 kg" in note for note in result["notes"])
    assert main([*call, "--online"]) == 1
    assert "--knowledge is for all rows at once" in capsys.readouterr().err
    file.write_text("total_mass: 1\nlinks: {link1: {mass: 2}}")
    assert main(call) == 1
    said = capsys.readouterr().err
    assert "contradict each other" in said
    assert said.count("\n") == 1
