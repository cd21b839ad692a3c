"""The page of a diagnosis: what is wrong with the given model, and findings large and small."""

import copy
import re

import pytest

from excitant.reports import html, page_of
from excitant.reports.diagnose import diagnose_section
from excitant.reports.drawing import style
from excitant.reports.error_figures import share_figure
from excitant.reports.page import Figure, Notes

SHARES = {"constant": 0.02, "direction": 0.81, "velocity": 0.83, "position": 0.0, "load": 0.8,
          "reversal": 0.82}  # fmt: skip
BANDS = {"slower": 0.0, "motion": 0.9, "faster": 0.1}


def render(result, series):
    return html(page_of(result, series))


def shape(rms):
    return {"rms": rms, "shares": SHARES, "bands": BANDS, "telling": "direction"}


@pytest.fixture
def run(make):
    result, series = make["diagnose"]()
    names = [row["name"] for row in result["simulation"]["joints"]]
    velocity = {"given": 0.2, "extended": 0.02, "unit": "rad/s"}
    result |= {
        "error": {"joints": [{"name": n, **shape(4.0), "left": shape(1.0)} for n in names]},
        "refit": {
            "sentence": "Re-fitting the inertias alone would hardly help.",
            "joints": [
                {"name": n, "given": 4.0, "inertias": 3.9, "bodies": 3.95, "extended": 1.0}
                for n in names
            ],
            "links": [
                {
                    "link": "forearm",
                    "mass_kg": 0.2,
                    "centre_mm": 31.0,
                    "inertia": 0.1,
                    "deviations": {"mass": 1.0, "centre": 9.0, "inertia": None},
                }
            ],
        },
        "forward": {
            "joints": [
                {"name": n, "given": 0.05, "extended": 0.002, "unit": "rad", "velocity": velocity}
                for n in names
            ],
            "windows": 4,
            "window_s": 0.6,
            "bandwidth_hz": 4.0,
            "notes": [],
        },
    }
    return result, series


def titles(result, series):
    with style():
        return [part.title for part in diagnose_section(result, series).parts]


def test_page_says_what_is_wrong_with_the_given_model(run, undrawn):
    page = render(*run)
    words = re.sub(r"<[^>]*>", " ", page)
    assert "What is wrong with the given model" in words
    assert "Re-fitting the inertias alone would hardly help." in words
    assert "31" in words
    assert titles(*run)[1] == "What is wrong with the given model"


def test_shares_are_drawn_for_both_models(run):
    result, _ = run
    with style():
        figure = share_figure(result, "N·m")
    given, left = figure.panels
    for panel in (given, left):
        assert panel.svg.count(">81</text>") == len(result["error"]["joints"])
        assert "by direction" in panel.label
    assert "25" in left.svg  # percent of the given model's error


def test_what_was_not_judged_is_a_dash(run):
    result, _ = run
    with style():
        figure = share_figure(result, "N·m")
    assert figure.panels[0].svg.count(">–</text>") == len(result["error"]["joints"])


@pytest.mark.parametrize("count", [1, 4])
def test_any_number_of_joints_can_be_drawn(run, count):
    result, _ = copy.deepcopy(run)
    result["error"]["joints"] = result["error"]["joints"][:count]
    with style():
        assert len(share_figure(result, "A").panels) == 2


def wrong(result):
    """Blocks on what is wrong with the given model, the forward simulation last."""
    with style():
        return diagnose_section(result, {}).parts[1].blocks


def test_divergence_is_said(run, undrawn):
    result, _ = copy.deepcopy(run)
    result["forward"]["joints"][0]["given"] = None
    result["forward"]["notes"] = ["The given model leaves the motion for good."]
    table, notes = wrong(result)[-2:]
    assert table.rows[0][1].text == "diverges"
    assert table.rows[0][2].text == "2.00"
    assert isinstance(notes, Notes)


def test_joints_where_the_extended_model_is_no_closer_are_named(run, undrawn):
    result, _ = copy.deepcopy(run)
    assert "closer on every joint" in wrong(result)[-1].caption
    result["forward"]["joints"][1]["extended"] = 0.06
    caption = wrong(result)[-1].caption
    assert f"no closer at {result['forward']['joints'][1]['name']}" in caption


@pytest.mark.parametrize("key", ["error", "refit", "forward"])
def test_page_does_without(run, key, undrawn):
    result, _ = copy.deepcopy(run)
    for nothing in ({}, None):
        result[key] = nothing
        assert "Error step by step" in titles(result, {})


def test_small_findings_share_a_part(run, undrawn):
    result, series = copy.deepcopy(run)
    lead = result["findings"][0]
    result["findings"] = [{**lead, "explained": share} for share in (0.7, 0.2, 0.1, 0.05, 0.004)]
    found = titles(result, series)
    assert [title[:10] for title in found if title.startswith("Finding ")] == [
        f"Finding {k}:" for k in (1, 2, 3)
    ]
    with style():
        parts = diagnose_section(result, series).parts
    (further,) = (part for part in parts if part.title == "Further findings")
    assert [block.title[:10] for block in further.blocks] == ["Finding 4:", "Finding 5:"]
    assert "0.40\u00a0%" in further.blocks[1].title
    assert any(isinstance(block, Figure | Notes) for block in further.blocks[1].blocks)


def test_nothing_found_shows_one_model(run, undrawn):
    result, series = copy.deepcopy(run)
    result["findings"] = []
    result["extended"]["joints"] = copy.deepcopy(result["simulation"]["joints"])
    page = render(result, series)
    assert titles(result, series)[1] == "Error of the given model"
    assert "Error step by step" not in titles(result, series)
    words = " ".join(re.sub(r"<[^>]*>", " ", page.split("<main", 1)[1]).split())
    assert "extended model" not in words.lower()
    assert "closer on every joint" not in words
    (row,) = (f for f in summary_facts(result, series) if f.label == "Hold-out error")
    assert "→" not in row.value


def summary_facts(result, series):
    with style():
        parts = diagnose_section(result, series).parts
    return parts[0].blocks[0].facts


def test_noise_is_said_in_a_sentence(run, undrawn):
    result, series = copy.deepcopy(run)
    names = [row["name"] for row in result["simulation"]["joints"]]
    result["unexplained"] = [{"joint": n, "share": 1e-4, "structure": "noise-like"} for n in names]
    with style():
        parts = diagnose_section(result, series).parts
    (left,) = (part for part in parts if part.title == "Not explained")
    sentence, table = left.blocks
    assert "looks like noise" in sentence.sentences[0]
    assert table.folded
    assert "Against the noise" not in [heading for heading, _ in table.columns]


def test_an_unknown_cause_claims_no_share(run, undrawn):
    result, series = copy.deepcopy(run)
    unknown = {"effect": "unknown", "joints": ["joint1"], "explained": 0.0, "verdict": "unknown",
               "structure": "structured: stays correlated over 0.4 s",
               "holdout": {"rms_before": 2.0, "rms_after": 2.0}}  # fmt: skip
    result["findings"] = [unknown]
    with style():
        parts = diagnose_section(result, series).parts
    table = parts[0].blocks[-1]
    assert [cell.text for cell in table.rows[0]][1] == "unknown cause"
    assert [cell.text for cell in table.rows[0]][3] == "–"
    assert [cell.text for cell in table.rows[0]][5] == "–"
    (part,) = (part for part in parts if part.title.startswith("Finding 1"))
    assert part.blocks[0].sentences[0].endswith("explains: it stays correlated over 0.4 s.")


def test_long_waterfalls_are_cut(run):
    result, series = copy.deepcopy(run)
    steps = [{"label": f"+ spring at joint{k}", "rms": 1 - k / 40} for k in range(30)]
    result["waterfall"] = steps
    page = render(result, series)
    assert "smaller causes" in page
    assert "joint29" in page
    assert "joint20" not in page
