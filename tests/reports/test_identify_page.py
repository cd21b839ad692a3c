"""The page of identify: errors with intervals, on-line estimation, payload, link by link."""

import re

import numpy as np
import pytest

from excitant.reports import html, page_of, summary
from excitant.reports.drawing import axes, style
from excitant.reports.error_figures import INTERVAL, Curves, draw_band, torque_figure
from excitant.reports.identify import identify_section
from excitant.reports.page import Notes, Table

LOOKS, N = 24, 400
CURVES = Curves("given", "identified", "identified", "caption", band="half_width")


def extra_run(make):
    """A run of identify with everything that --online and --payload add."""
    result, series = make["identify"]()
    rng, rows = np.random.default_rng(2), len(result["base_parameters"])
    t = 1.0 + 0.5 * np.arange(LOOKS)
    std = np.exp(-t[:, None] / rng.uniform(2, 20, rows))
    value = 1 + 0.3 * std * rng.standard_normal((LOOKS, rows))
    level = np.where((t > 6) & (t < 9), 0.01, 30.0)
    history = {
        "t": t.tolist(),
        "excitation_level": [None] * 4 + level[4:].tolist(),
        "torque_uncertainty": (np.exp(-t)[:, None] * np.ones(4)).tolist(),
        "noise": (0.02 * np.ones((LOOKS, 4))).tolist(),
    }
    messages = [
        {"t": 4.0, "text": "converged: the estimate is surer of the torque than a row of data"},
        {"t": 6.5, "text": "not exciting enough since 2.1 s: 3 of 40 visible <directions>"},
    ]
    result["online"] = {"delay_s": 0.03, "converged": True, "messages": messages}
    result["online"]["history"] = history
    result["payload"] = payload()
    more = {"online_t": t, "online_value": value, "online_std": std}
    return result, series | more


def payload():
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


def render(result, series):
    return html(page_of(result, series))


@pytest.fixture
def extra(make):
    return extra_run(make)


@pytest.fixture(scope="module")
def page(make):
    return render(*extra_run(make))


def words(page):
    return re.sub(r"\s+", " ", re.sub(r"<style.*?</style>|<[^>]*>", "", page, flags=re.DOTALL))


def labels(page):
    return re.findall(r'<svg role="img" aria-label="([^"]*)"', page)


def test_every_part_is_there_with_its_figure(page, written):
    parts = ("Payload", "On-line estimation", "Estimates over time", "Excitation over time",
             "Convergence")  # fmt: skip
    for part in parts:
        assert re.search(f"<h3[^>]*>{part}</h3>", page), part
    said = " ".join(labels(page))
    for start in (
        "over time, at the end",
        "excitation level over time",
        "torque uncertainty falls",
    ):
        assert start in said, start
    assert "nan" not in re.sub(r"[a-z]*nan[a-z]+|[a-z]+nan[a-z]*", "", words(page).lower())
    without = written("identify")
    assert not any(re.search(f"<h3[^>]*>{part}</h3>", without) for part in parts)


def test_spans_of_poor_excitation_are_named_and_messages_written(extra, page, undrawn):
    said = words(page)
    assert "not exciting enough from 6.5 s to 9.0 s" in said
    assert "not exciting enough since 2.1 s: 3 of 40 visible &lt;directions&gt;" in said
    level = extra[0]["online"]["history"]["excitation_level"]
    extra[0]["online"]["history"]["excitation_level"] = [x and 30.0 for x in level]
    assert "here never below it" in words(render(*extra))


def test_estimates_shown_are_those_that_were_learnt(page):
    """Of every link one parameter at most, and of every joint; with their units."""
    titles = [label for label in labels(page) if "over time, at the end" in label]
    owners = [title.split(" over time")[0].rpartition(".")[0] for title in titles]
    assert 0 < len(titles) <= 12
    assert len(set(owners)) == len(owners)
    assert all(re.search(r"± \S+ (kg|N)", title) for title in titles)


def test_payload_in_words(page):
    said = words(page)
    for part in (
        "1.5000 ± 0.0020 kg", "20.00 ± 0.10 mm", "200.0 ± 5.0 mm", "held by link7",
        "Torque came as motor current", "Centre of mass along z is known to ±10 mm only."
    ):  # fmt: skip
        assert part in said, part


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
        lambda r, s: r["payload"]["centre_of_mass"].update(std=[None, 1e-3, 1e-3]),
        lambda r, s: r["payload"]["mass"].update(value=None),
        lambda r, s: r["payload"].update(parameters=[], notes=None),
    ],
)
def test_what_is_missing_or_null_is_left_out(extra, damage, undrawn):
    damage(*extra)
    assert "Identification" in render(*extra)


def test_the_band_holds_every_edge():
    (ax,) = axes(2.0)
    t = np.arange(1000) / 100
    centre, half = np.sin(7 * t), 0.1 + 0.05 * np.cos(3 * t)
    half[333] = 2.0
    draw_band(ax, t, [400], centre, half)
    corners = np.vstack([path.vertices for c in ax.collections for path in c.get_paths()])
    assert corners[:, 1].max() == (centre + half).max()
    assert corners[:, 1].min() == (centre - half).min()
    assert len(ax.collections) == 2  # broken where recordings were joined


def test_the_torque_figure_explains_its_band():
    t = np.concatenate([np.linspace(0, 5, N // 2), np.linspace(0, 5, N // 2)])
    wave = np.sin(t)[:, None] * [1.0, 2.0]
    series = {"t": t, "measured": wave, "given": 1.1 * wave, "identified": wave}
    plain, figure, short = (
        torque_figure(["a", "b"], series | more, "N·m", CURVES)
        for more in ({}, {"half_width": np.full((N, 2), 0.3)}, {"half_width": np.ones((N - 1, 2))})
    )
    assert INTERVAL in [key.label for key in figure.legend]
    assert INTERVAL in figure.panels[0].label
    assert len(plain.legend) == len(figure.legend) - 1
    assert "#c3dcec" in figure.panels[0].svg
    for other in (plain, short):
        assert "#c3dcec" not in other.panels[0].svg


def test_intervals_and_essential_parameters_in_words():
    interval = {"half_width": 0.3, "half_width_parameters": 0.1, "coverage": 0.712}
    essential = {"kept": ["m1"], "dropped": ["m2", "m3"], "nrmse_all": 0.05,
                 "nrmse_essential": 0.049}  # fmt: skip
    joints = [{"name": "a", "validate": {"interval95": interval}}]

    def blocks(result):
        with style():
            return [b for part in identify_section(result, {}).parts for b in part.blocks]

    found = blocks({"joints": joints, "essential": essential})
    (table,) = (b for b in found if isinstance(b, Table) and "Hold-out inside" in dict(b.columns))
    assert [cell.text for cell in table.rows[0]] == ["a", "0.300", "0.100", "71\u00a0%"]
    (line,) = (b for b in found if isinstance(b, Notes))
    assert "1 of 3 base parameters" in line.sentences[0]
    assert not any(isinstance(b, Notes) for b in blocks({"joints": [{"name": "a"}]}))


def test_link_by_link_says_what_each_link_shows_and_what_is_missing():
    seen = [{"expression": "l2.Izz", "value": 1.0, "std": 0.1}]
    last = {"link": "l2", "joint": "j2", "recordings": ["r"], "rows": 100, "mode": "swings",
            "determined": seen, "missing": ["l2.m"], "needed": ["turn the base"]}  # fmt: skip
    joints = [{"name": "j1", "given": 1.0, "all_at_once": 0.5, "link_by_link": 0.4}]
    found = {"determined": 1, "base_parameters": 2, "stages": [last, {"link": "l1", "joint": "j1"}],
             "comparison": {"joints": joints}}  # fmt: skip
    text = " ".join(summary(page_of({"verb": "identify", "link_by_link": found}, {})).split())
    for said in ("1 of 2 (1 + 0, from the last link inward)", "j1 1.00 0.500 0.400", "[Link l2]",
                 "Torque of j2: 100 rows of r; j2 swings.", "determined 1.00 0.10 l2.Izz",
                 "not shown - - l2.m", "To identify the rest, turn the base.",
                 "[Link l1] j1 does not move."):  # fmt: skip
        assert said in text, said
