"""The page of a diagnosis: what is wrong with the given model, and findings large and small."""

from types import SimpleNamespace

import pytest
from records import full

from excitant.reports.figure import Figure
from excitant.reports.page import Notes
from excitant.reports.sections.diagnose import diagnose_section
from excitant.reports.sections.examination import _cause_at
from excitant.results import record_of


@pytest.fixture
def run(make):
    return make["diagnose"]()


def parts_of(result, series):
    parts = diagnose_section(record_of(full(**result)), series).parts
    return {part.title: part.blocks for part in parts}


def test_page_says_what_is_wrong_with_the_given_model(run):
    assert list(parts_of(*run))[1] == "What is wrong with the given model"
    [given] = parts_of(run[0], {})["What is wrong with the given model"]
    heads = [head for head, _ in given.columns]
    assert len(given.rows) == len(run[0]["error"]["joints"])
    for row in given.rows:
        cells = dict(zip(heads, row, strict=True))
        shown = [cells[head].text for head in ("rms [N·m]", "direction", "time")]
        assert shown == ["4.00", "81\u00a0%", "–"]  # time was not judged
        assert [head for head, cell in cells.items() if cell.tone] == ["direction"]


def test_small_findings_share_a_part(run):
    result, series = run
    lead = result["findings"][0]
    result["findings"] = [{**lead, "explained": share} for share in (0.7, 0.2, 0.1, 0.05, 0.004)]
    parts = parts_of(result, series)
    leading = [title[:10] for title in parts if title.startswith("Finding ")]
    assert leading == [f"Finding {k}:" for k in (1, 2, 3)]
    further = parts["Further findings"]
    assert [block.title[:10] for block in further] == ["Finding 4:", "Finding 5:"]
    assert "0.40\u00a0%" in further[1].title
    assert any(isinstance(block, Figure | Notes) for block in further[1].blocks)


def test_finer_friction_of_a_group_has_a_line_of_its_own_with_the_reason(run):
    lead = run[0]["findings"][0]
    kinds = ["coulomb_friction", "stribeck_friction", "friction_coupling"]
    parts = [{**lead, "effect": kind, "sentence": kind, "rivals": []} for kind in kinds]
    parts[1] |= {"verdict": "undecided", "doubt": "it is small"}
    run[0]["findings"] = [{**lead, "effect": "friction", "verdict": "named", "parts": parts}]
    assert diagnose_section(record_of(full(**run[0])), {}).brief[2:4] == (
        ("1, of this (undecided)", "stribeck_friction; it is small"),
        ("1, of this", "friction_coupling"),
    )


def test_nothing_found_shows_one_model(run, show):
    result, series = run
    result["findings"] = []
    result["extended"]["joints"] = result["simulation"]["joints"]
    parts = parts_of(result, series)
    assert list(parts)[1] == "Error of the given model"
    words = show(result, series).words.lower()
    assert not any(said in words for said in ("extended model", "closer on every joint"))
    (fact,) = (f for f in parts["Key figures"][0].facts if f.label == "Hold-out error")
    assert "→" not in fact.value


def test_noise_is_said_in_a_sentence(run):
    result, _ = run
    names = [row["name"] for row in result["simulation"]["joints"]]
    result["unexplained"] = [{"joint": n, "share": 1e-4, "structure": "noise-like"} for n in names]
    sentence, table = parts_of(result, {})["Not explained"]
    assert "looks like noise" in sentence.sentences[0]
    assert table.folded
    assert "Against the noise" not in [heading for heading, _ in table.columns]


def test_an_unknown_cause_claims_no_share(run):
    run[0]["findings"] = [{
        "effect": "unknown", "joints": ["joint1"], "explained": 0.0, "verdict": "unknown",
        "sentence": "joint1: 2.0 N·m remain unexplained", "doubt": "",
        "holdout": {"rms_before": 2.0, "rms_after": 2.0},
    }]  # fmt: skip
    parts = parts_of(run[0], {})
    (row,) = parts["Key figures"][-1].rows
    assert [row[k].text for k in (1, 3, 5)] == ["unknown cause", "–", "–"]
    (blocks,) = (blocks for title, blocks in parts.items() if title.startswith("Finding 1"))
    assert blocks[0].sentences[0] == "joint1: 2.0 N·m remain unexplained"


def test_the_cause_at_a_joint_is_doubted_by_its_kinds() -> None:
    plain = SimpleNamespace(effect="coulomb_friction", joints="ab", verdict="named")
    finer = SimpleNamespace(effect="asymmetric_friction", joints="bc", verdict="undecided")
    parts = [plain, finer]
    made = {"a": 3.0, "b": 1.0, "c": 1.0}
    whole = SimpleNamespace(effect="friction", verdict="named", parts=parts, by_joint=made)
    felt = {"a": 2.0, "b": 2.0}  # by joints other than its own, too
    load = SimpleNamespace(effect="payload", verdict="named", parts=[], by_joint=felt)
    causes = [_cause_at(joint, [whole, load]) for joint in "abcd"]
    assert causes == ["Coulomb friction", "payload", "asymmetric friction (undecided)", "–"]
