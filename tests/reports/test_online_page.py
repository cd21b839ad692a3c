"""The page of on-line estimation, payload and differentiators: what it draws and says."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest

from excitant.identify import Recording, choose_differentiator
from excitant.identify.differentiator_table import (
    differentiator_result,
    differentiator_series,
    differentiator_table,
)
from excitant.identify.online import regular
from excitant.reports import render
from excitant.reports.drawing import style
from excitant.reports.online_section import online_parts
from excitant.reports.payload_section import payload_parts

Run = tuple[dict[str, Any], dict[str, np.ndarray]]
LOOKS = 24


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Slow motion of seven joints with encoder noise, no period in it."""
    rng = np.random.default_rng(4)
    t = np.arange(0, 12, 0.005)
    f = rng.uniform(0.1, 1.0, (3, 7))
    q = np.sin(2 * np.pi * f * t[:, None, None] + f).sum(axis=1)
    return Recording("slow", "slow.csv", t, q + 1e-4 * rng.standard_normal(q.shape), q.copy())


def choice_of(recording: Recording) -> str:
    """Why which differentiator serves on line."""
    t, q, _ = regular(recording)
    return choose_differentiator(t, q, causal=True).why


@pytest.fixture
def online(make: Any, recording: Recording) -> Run:
    """A run of identify with everything that --online and --payload add."""
    result, series = make["identify"]()
    rng, rows = np.random.default_rng(2), len(result["base_parameters"])
    t = 1.0 + 0.5 * np.arange(LOOKS)
    std = np.exp(-t[:, None] / rng.uniform(2, 20, rows))
    value = 1 + 0.3 * std * rng.standard_normal((LOOKS, rows))
    level = np.where((t > 6) & (t < 9), 0.01, 30.0)
    history = {
        "t": t.tolist(),
        "value": value.tolist(),
        "std": std.tolist(),
        "excitation_level": [None] * 4 + level[4:].tolist(),
        "torque_uncertainty": (np.exp(-t)[:, None] * np.ones(7)).tolist(),
        "noise": (0.02 * np.ones((LOOKS, 7))).tolist(),
    }
    messages = [
        {"t": 4.0, "text": "converged: the estimate is surer of the torque than a row of data"},
        {"t": 6.5, "text": "not exciting enough since 2.1 s: 3 of 40 visible <directions>"},
    ]
    result["online"] = {
        "delay_s": 0.03, "converged": True, "messages": messages, "history": history,
        "differentiator": "",
    }  # fmt: skip
    why = choice_of(recording)
    table = differentiator_table(recording, why)
    result["differentiators"] = differentiator_result(table)
    result["payload"] = payload()
    more = {"online_t": t, "online_value": value, "online_std": std}
    return result, series | more | differentiator_series(table)


def payload() -> dict[str, Any]:
    values = [1.5, 0.03, -0.045, 0.3, 0.07, 0.001, 0.068, -0.006, 0.009, 0.008]
    names = ["m", "mcx", "mcy", "mcz", "Ixx", "Ixy", "Iyy", "Ixz", "Iyz", "Izz"]
    units = ["kg", *["kg·m"] * 3, *["kg·m²"] * 6]
    return {
        "link": "link7",
        "mass": {"value": 1.5, "std": 0.002, "unit": "kg"},
        "centre_of_mass": {"value": [0.02, -0.03, 0.2], "std": [1e-4, 1e-4, 5e-3], "unit": "m"},
        "parameters": [
            {"name": n, "value": v, "std": 0.01, "unit": u, "prior_dominated": n == "Izz"}
            for n, v, u in zip(names, values, units, strict=True)
        ],
        "shortcomings": ["centre of mass along z is known to ±10 mm only"],
        "notes": ["torque came as motor current: a gain that is wrong by 1 % makes mass wrong"],
    }


def words(page: str) -> str:
    return re.sub(r"\s+", " ", re.sub(r"<style.*?</style>|<[^>]*>", "", page, flags=re.DOTALL))


def labels(page: str) -> list[str]:
    return re.findall(r'<svg role="img" aria-label="([^"]*)"', page)


def test_every_part_is_there_with_its_figure(online: Run) -> None:
    page = render(*online)
    for part in (
        "Payload", "On-line estimation", "Estimates over time", "Excitation over time",
        "Convergence", "Differentiators",
    ):  # fmt: skip
        assert re.search(f"<h3[^>]*>{part}</h3>", page), part
    said = " ".join(labels(page))
    for start in (
        "standard deviation over time", "excitation level over time", "torque uncertainty falls",
        "gain of the velocity", "gain of the acceleration", "positions of joint", "payload from",
    ):  # fmt: skip
        assert start in said, start
    assert "nan" not in re.sub(r"[a-z]*nan[a-z]+|[a-z]+nan[a-z]*", "", words(page).lower())


def test_a_run_without_them_has_none_of_it(make: Any) -> None:
    page = render(*make["identify"]())
    for part in ("Payload", "On-line estimation", "Differentiators"):
        assert not re.search(f"<h3[^>]*>{part}</h3>", page)


def test_spans_of_poor_excitation_are_named_and_messages_written(online: Run) -> None:
    said = words(render(*online))
    assert "not exciting enough from 6.5 s to 9.0 s" in said
    assert "not exciting enough since 2.1 s: 3 of 40 visible &lt;directions&gt;" in said
    level = online[0]["online"]["history"]["excitation_level"]
    online[0]["online"]["history"]["excitation_level"] = [x and 30.0 for x in level]
    assert "here never below it" in words(render(*online))


def test_estimates_shown_are_those_that_were_learnt(online: Run) -> None:
    """Of every link one parameter at most, and of every joint; with their units."""
    titles = [label for label in labels(render(*online)) if "over time, at the end" in label]
    owners = [title.split(" over time")[0].rpartition(".")[0] for title in titles]
    assert 0 < len(titles) <= 12
    assert len(set(owners)) == len(owners)
    assert all(re.search(r"± \S+ (kg|N)", title) for title in titles)


def test_payload_in_words(online: Run) -> None:
    said = words(render(*online))
    for part in (
        "1.5000 ± 0.0020 kg", "20.00 ± 0.10 mm", "200.0 ± 5.0 mm", "held by link7",
        "Torque came as motor current", "Centre of mass along z is known to ±10 mm only.",
    ):  # fmt: skip
        assert part in said, part


def test_the_differentiator_that_served_is_marked_once(online: Run) -> None:
    rows = online[0]["differentiators"]["contestants"]
    chosen = [row for row in rows if row["chosen"]]
    assert len(chosen) == 1
    assert online[0]["differentiators"]["why"].startswith(chosen[0]["name"])
    assert chosen[0]["delay_s"] > 0
    page = render(*online)
    assert words(page).count("● served") + words(page).count("●served") == 1


def test_errors_and_gains_of_the_comparison_are_those_of_the_differentiators(
    recording: Recording,
) -> None:
    why = choice_of(recording)
    table = differentiator_table(recording, why)
    series, rate = differentiator_series(table), table.spectrum.rate_hz
    found = differentiator_result(table)
    # the sentence of the choice speaks about the same joint and the same error
    assert f"of joint {table.joint + 1}," in why
    served = next(row for row in found["contestants"] if row["chosen"])
    assert f"error {served['error']:.3g}" in why
    for k, each in enumerate(table.contestants):
        f = series["differentiator_f"]
        np.testing.assert_array_equal(
            series["differentiator_gain_velocity"][:, k], each.differentiator.gain(f, rate, 1)
        )
    by_label = {row["label"]: row for row in found["contestants"]}
    early, late = by_label["five-point"], by_label["five-point, causal"]
    assert late["delay_s"] == pytest.approx(2 / rate)
    assert early["noise_gain_velocity"] == late["noise_gain_velocity"]
    assert early["noise_gain_velocity"] == pytest.approx(np.sqrt(0.1) * rate)
    assert min(row["error"] for row in found["contestants"]) < early["error"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "damage",
    [
        lambda r, s: r["online"].clear(),
        lambda r, s: r["online"].update(history={"t": [1.0], "excitation_level": None}),
        lambda r, s: r["online"]["history"].update(noise=[[0.1]]),
        lambda r, s: s.pop("online_std"),
        lambda r, s: s.update(online_std=np.full_like(s["online_std"], np.nan)),
        lambda r, s: s.update(online_value=s["online_value"][:, :-1]),
        lambda r, s: s.pop("differentiator_gain_velocity"),
        lambda r, s: r["differentiators"].clear(),
        lambda r, s: r["payload"]["centre_of_mass"].update(std=[None, 1e-3, 1e-3]),
        lambda r, s: r["payload"]["mass"].update(value=None),
        lambda r, s: r["payload"].update(parameters=[], notes=None),
    ],
)
def test_what_is_missing_or_null_is_left_out(online: Run, damage: Any) -> None:
    damage(*online)
    assert "Identification" in render(*online)


def test_parts_are_empty_without_results() -> None:
    with style():
        assert online_parts({}, {}) == []
        assert payload_parts({}) == []
