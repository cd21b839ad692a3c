"""What is known of bodies holds in the fit, stays optimal, and contradictions are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from known_arms import Call, Whitened, assert_optimal, write_csv

from excitant.exceptions import BadInput, UnknownName
from excitant.identify.knowledge import (
    PRIORS,
    Box,
    Ellipsoid,
    Knowledge,
    LinkKnowledge,
    Quantity,
    load_knowledge,
)
from excitant.robots import Array, Robot
from excitant.robots.parameters import pseudo_inertia

KINDS = pytest.mark.parametrize("kind", PRIORS)


class Seen(Whitened):
    """An arm that differs from its model, and its friction."""

    def __init__(self) -> None:
        super().__init__("ur10", 0.1, n=300)
        rng = np.random.default_rng(0)
        self.truth = self.prior * rng.uniform(0.6, 1.5, (6, 1))
        x = np.concatenate([self.truth.ravel(), rng.uniform(0, 1, len(self.effects.mean))])
        self.z = self.R @ x + rng.standard_normal(len(self.R))

    def bodies(self, knowledge: Knowledge) -> Array:
        fit = self.fit(self.z, knowledge)
        assert_optimal(fit)
        return fit.x[: self.links].reshape(6, 10)


@pytest.fixture(scope="module")
def seen() -> Seen:
    return Seen()


@KINDS
def test_known_masses_hold_exactly_or_as_far_as_they_are_sure(kind: str, seen: Seen) -> None:
    free = seen.bodies(Knowledge(kind))[:, 0]
    total = 1.1 * float(free.sum())
    masses = (7.0, Quantity(12.0, 1e-4), Quantity(4.0, 1e6))
    about = {n: LinkKnowledge(mass=m) for n, m in zip(seen.robot.links, masses, strict=False)}
    fit = seen.fit(seen.z, Knowledge(kind, total, about))
    assert_optimal(fit)
    m = fit.x[: seen.links : 10]
    assert m.sum() == pytest.approx(total, abs=1e-7)
    assert m[0] == pytest.approx(7.0, abs=1e-8)
    assert m[1] == pytest.approx(12.0, abs=1e-3)
    C = fit.covariance[: seen.links : 10, : seen.links : 10]
    assert C[0, 0] <= 1e-12
    assert np.sqrt(C[1, 1]) <= 1e-4 * (1 + 1e-6)
    assert C.sum() <= 1e-10 * total**2
    unsure = seen.bodies(Knowledge(kind, Quantity(total, 1e6)))[:, 0]
    np.testing.assert_allclose(unsure, free, rtol=1e-4)


@KINDS
def test_centres_of_mass_stay_where_they_are_known_to_be(kind: str, seen: Seen) -> None:
    free = seen.bodies(Knowledge(kind))
    centre = free[:, 1:4] / free[:, :1]
    box = Box(tuple(centre[1] + 0.02), tuple(centre[1] + [0.05, 0.06, 0.02]))  # flat along z
    ball = Ellipsoid(tuple(centre[2] + 0.1), (0.03, 0.05, 0.04))
    shell = Ellipsoid(tuple(centre[3]), (0.02, 0.03, 0.01))
    about = ({"com_box": box}, {"com_ellipsoid": ball}, {"body_ellipsoid": shell})
    links = zip(seen.robot.links[1:], about, strict=False)
    phi = seen.bodies(Knowledge(kind, links={n: LinkKnowledge(**known) for n, known in links}))
    found = phi[:, 1:4] / phi[:, :1]
    tight = 1e-6
    assert (found[1] >= np.array(box.low) - tight).all()
    assert (found[1] <= np.array(box.high) + tight).all()
    inside = np.linalg.norm((found[2] - ball.centre) / np.array(ball.radii))
    assert 0.9 < inside <= 1 + tight  # the free centre lies outside
    P = pseudo_inertia(phi[3])
    offset = np.outer(shell.centre, P[:3, 3])
    second = P[:3, :3] - offset - offset.T + P[3, 3] * np.outer(shell.centre, shell.centre)
    assert np.sum(np.diag(second) / np.array(shell.radii) ** 2) <= phi[3, 0] * (1 + tight)


def test_constraints_that_do_not_bind_change_nothing(seen: Seen) -> None:
    far = Ellipsoid((0, 0, 0), (9, 9, 9))
    wide = LinkKnowledge(
        com_box=Box((-9, -9, -9), (9, 9, 9)), com_ellipsoid=far, body_ellipsoid=far
    )
    known = Knowledge(links=dict.fromkeys(seen.robot.links, wide))
    free, fit = (seen.fit(seen.z, each).x for each in (Knowledge(), known))
    np.testing.assert_allclose(fit, free, rtol=1e-5, atol=1e-6)


def test_masses_known_twice_agree_and_bring_the_truth_closer(seen: Seen) -> None:
    true = seen.truth[:, 0].tolist()
    about = {n: LinkKnowledge(mass=m) for n, m in zip(seen.robot.links, true, strict=True)}
    free = seen.bodies(Knowledge())
    found = seen.bodies(Knowledge(total_mass=sum(true), links=about))
    np.testing.assert_allclose(found[:, 0], true, atol=1e-7)
    gap, before = (np.linalg.norm((phi - seen.truth)[:, :4]) for phi in (found, free))
    assert gap < 0.5 * before


CORNER = [[0, 0, 0], [0.1, 0.1, 0.1]]
AWAY = {"centre": [0.5, 0, 0], "radii": [0.1, 0.1, 0.1]}
POINT = {
    "com_box": [[1, 0, 0], [1, 0, 0]],
    "body_ellipsoid": {"centre": [0, 0, 0], "radii": [0.2, 0.2, 0.2]},
}


@KINDS
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
    tmp_path: Path, seen: Seen, kind: str, total: float | None, about: dict[int, Any],
    named: tuple[str, ...], silent: str,
) -> None:  # fmt: skip
    links, file = seen.robot.links, tmp_path / "known.yaml"
    content = {"prior": kind, "links": {links[k]: v for k, v in about.items()}}
    file.write_text(yaml.safe_dump(content | ({"total_mass": total} if total else {})))
    with pytest.raises(BadInput, match="contradict each other") as refused:
        seen.fit(seen.z, load_knowledge(file, links))
    said = str(refused.value)
    assert said.startswith(str(file))
    assert "correct one of them" in said
    assert "\n" not in said
    assert all(word.format(*links) in said for word in named)
    assert f"of {silent.format(*links)} " not in said


def test_what_is_written_is_what_is_read(tmp_path: Path) -> None:
    file = tmp_path / "known.yaml"
    content = {
        "prior": "euclidean",
        "total_mass": {"value": 33.5, "std": 0.5},
        "links": {"forearm": {"mass": 2.3, "com_box": CORNER, "com_ellipsoid": AWAY} | POINT},
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


def test_missing_file_unknown_prior_and_unknown_link(seen: Seen) -> None:
    with pytest.raises(BadInput, match="no such file; give a YAML file of what is known"):
        load_knowledge("nowhere.yaml", [])
    with pytest.raises(UnknownName, match="unknown prior"):
        Knowledge("flat")
    with pytest.raises(BadInput, match="no link 'tail'"):
        seen.fit(seen.z, Knowledge(links={"tail": LinkKnowledge(mass=1.0)}))


def test_command(tmp_path: Path, planar: Robot, exact: Call, excitant: Call) -> None:
    log, file = tmp_path / "log.csv", tmp_path / "known.yaml"
    write_csv(log, exact(planar, np.arange(0, 12, 0.01)))
    content = {"prior": "euclidean", "total_mass": 7.5, "links": {"link2": {"mass": 2.5}}}
    file.write_text(yaml.safe_dump(content))
    call = ("identify planar_2r --json", log, "--knowledge", file)
    result = excitant(*call).result
    assert result["knowledge"] == content
    by_name = {p["name"]: p for p in result["parameters"]}
    assert by_name["link2.m"]["value"] == pytest.approx(2.5, abs=1e-6)
    assert by_name["link1.m"]["value"] == pytest.approx(5.0, abs=1e-6)
    assert by_name["link2.m"]["prior_dominated"]
    assert any("total mass 7.5 kg; link2: mass 2.5 kg" in note for note in result["notes"])
    ran = excitant(*call, "--online")
    assert ran.status == 1
    assert "--knowledge is for all rows at once" in ran.err
    file.write_text("total_mass: 1\nlinks: {link1: {mass: 2}}")
    ran = excitant(*call)
    assert ran.status == 1
    assert "contradict each other" in ran.err
    assert ran.err.count("\n") == 1
