"""The summary changes only where the result does, and the terminal says the main things."""

import difflib
import re
from functools import reduce
from operator import getitem

import pytest
from records import full

from excitant.reports import brief, html, page_of, summary


def text_of(result):
    return summary(page_of(result, {}))


def test_summary_is_plain_lines(run):
    text = text_of(run[0])
    assert (text[:2], text[-1]) == ("[[", "\n")
    assert not any(line != line.rstrip() for line in text.splitlines())
    assert not set("\t−\u00a0⁻") & set(text)


@pytest.mark.parametrize(
    ("verb", "path"),
    [
        ("design", ("condition_number", "initial")),
        ("check", ("limits", "velocity")),
        ("identify", ("joints", 2, "validate", "rms")),
        ("identify", ("parameters", 17, "value")),
        ("identify", ("base_parameters", 5, "std")),
        ("analyze", ("links", 1, "parameters", 2, "std")),
        ("diagnose", ("findings", 0, "parameters", 0, "value")),
        ("diagnose", ("extended", "joints", 3, "r2")),
    ],
)
@pytest.mark.parametrize("value", [123456.789, -1.5e-9, None])
def test_one_changed_value_changes_only_its_lines(verb, path, value, make):
    before, after = make[verb]()[0], make[verb]()[0]
    reduce(getitem, path[:-1], after)[path[-1]] = value
    lines = (text_of(result).splitlines() for result in (before, after))
    signs = [line[0] for line in difflib.ndiff(*lines)]
    most = 2 if path[0] == "condition_number" else 1  # the lead says it too
    assert 0 < signs.count("+") <= most
    assert signs.count("+") + signs.count("-") <= 2 * most


def test_time_taken_and_paths_do_not_count(make):
    before, after = make["design"]()[0], make["design"]()[0]
    after["wall_s"], after["files"] = 99.0, ["elsewhere/trajectory.csv"]
    assert text_of(before) == text_of(after)
    assert "99" in html(page_of(after, {}))


def test_every_accuracy_parameter_and_finding_is_in_it(make):
    result = make["demo"]()[0]
    text = text_of(result)
    said = [f"{row['rms']:.3g}" for row in result["diagnose"]["extended"]["joints"]]
    said += [f"[[Finding {k + 1}: " for k in range(len(result["diagnose"]["findings"]))]
    said += [x["expression"].replace("−", "-") for x in result["identify"]["base_parameters"]]
    assert [words for words in (*said, "✓ yes") if words not in text] == []
    head, *rows = text.partition("[[Standard parameters]]")[2].splitlines()[1:86]
    for word in ("Parameter", "Value", "± std", "Relative std", "Category", "Decided by"):
        assert word in head
    assert len(rows) == len(result["identify"]["parameters"])
    assert {row.split()[-1] for row in rows} == {"prior", "data", "both"}


def test_names_cannot_break_lines():
    result = full(verb="identify", robot="two\nlines", joints=[{"name": "a\nb"}])
    assert "two lines" in text_of(result)
    assert "    a b " in text_of(result)


def test_terminal_shows_leads_and_what_is_marked(make):
    assert brief(page_of(*make["rehearse"]())).splitlines() == [
        "failed       the motion would not do: 1 of 3 requirements is not met",
        "to change    Move wrist_roll_joint faster.",
        "met          velocity limits, shoulder_pan_joint: 99 % used",
        "met          viscous friction, elbow_joint",
        "NOT MET      viscous friction, wrist_roll_joint: too little",
    ]


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        ("robots", "checked      4 joints, "),
        ("design", "designed     condition number 171 → 9.31, limits used up to 100.0 %"),
        ("check", "checked      velocity of elbow_joint reaches 131 % of its limit"),
        ("identify", "identified   hold-out error > 999 % → 7.6 % (nrmse, worst joint, elbow_"),
        ("analyze", "identifiable 58 combinations of 84 parameters; "),
        ("diagnose", "diagnosed    elbow_joint has Stribeck friction"),
        ("diagnose", "data fault   saturation, elbow_joint: 41 samples at ±87 N·m"),
        ("go", "verdict      Of the torque, the given model misses 62 %."),
        ("go", "data fault   "),
        ("go", "next         record more"),
        ("demo", "hidden       Stribeck friction at elbow_joint (seed 7): named"),
    ],
)
def test_terminal_says_what_every_verb_came_to(verb, words, make):
    assert words in brief(page_of(make[verb]()[0], {})).replace("\u00a0", " ")


def test_a_terminal_shows_the_joints_of_an_examination_in_colour(make):
    page = page_of(make["go"]()[0], {})
    plain, coloured = (brief(page, terminal=yes) for yes in (False, True))
    assert (plain.count("\x1b"), "\x1b[31m" in coloured) == (0, True)
    assert re.search(r"^Joint +Given +Identified +Extended +Main cause$", plain, re.MULTILINE)
    assert len(plain.splitlines()) <= 20
    assert "diagnosed " not in plain
