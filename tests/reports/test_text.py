"""The summary changes only where the result does, and the terminal says the main things."""

import difflib

import pytest

from excitant.reports import brief, html, page_of, summary
from excitant.reports.page import Cell, Fact, Facts, Folded, Notes, Page, Section, Table


def text_of(result):
    return summary(page_of(result, {}))


def changed(before, after):
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def test_summary_is_plain_lines(run, undrawn):
    text = text_of(run[0])
    assert text.startswith("[[")
    assert text.endswith("\n")
    assert not any(line != line.rstrip() or "\t" in line for line in text.splitlines())
    assert not set("−\u00a0⁻") & set(text)


@pytest.mark.parametrize(
    ("verb", "path"),
    [
        ("design", ("condition_number", "initial")),
        ("check", ("limits", "velocity")),
        ("identify", ("joints", 2, "validate", "rms")),
        ("identify", ("parameters", 17, "value")),
        ("identify", ("base_parameters", 5, "std")),
        ("analyze", ("practical", 7, "rel_std")),
        ("diagnose", ("findings", 0, "parameters", 0, "value")),
        ("diagnose", ("extended", "joints", 3, "r2")),
    ],
)
@pytest.mark.parametrize("value", [123456.789, None])
def test_one_changed_value_changes_only_its_lines(verb, path, value, make, undrawn):
    before, after = make[verb]()[0], make[verb]()[0]
    holder = after
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    found = changed(text_of(before), text_of(after))
    most = 2 if path[0] == "condition_number" else 1  # the lead says it too
    assert 0 < len([line for line in found if line[0] == "+"]) <= most
    assert len(found) <= 2 * most
    table = [line for line in found if "=" not in line and " reaches " not in line]
    assert len({len(line.split("  ")[0]) for line in table}) <= 1


def test_time_taken_and_paths_do_not_count(make):
    before, after = make["design"]()[0], make["design"]()[0]
    after["wall_s"], after["files"] = 99.0, ["elsewhere/trajectory.csv"]
    assert text_of(before) == text_of(after)
    assert "99" in html(page_of(after, {}))


def test_every_accuracy_parameter_and_finding_is_in_it(make, undrawn):
    result = make["demo"]()[0]
    text = text_of(result)
    for row in result["diagnose"]["extended"]["joints"]:
        assert f"{row['rms']:.3g}" in text
    for k in range(len(result["diagnose"]["findings"])):
        assert f"[[Finding {k + 1}: " in text
    for row in result["identify"]["base_parameters"]:
        assert row["expression"].replace("−", "-") in text
    head, *rows = text.partition("[[Standard parameters]]")[2].splitlines()[1:42]
    for word in ("Parameter", "Value", "± std", "Relative std", "Category", "Decided by"):
        assert word in head
    assert len(rows) == len(result["identify"]["parameters"])
    assert {row.split()[-1] for row in rows} == {"prior", "data"}
    assert "✓ yes" in text


def test_names_cannot_break_lines():
    result = {"verb": "identify", "robot": "two\nlines", "joints": [{"name": "a\nb", "train": {}}]}
    text = text_of(result)
    assert "two lines" in text
    assert "    a b " in text


def test_terminal_shows_leads_and_what_is_marked():
    rows = ((Cell("run1"), Cell("dead channel"), Cell("–")),)
    heads = (("Recording", "name"), ("Fault", "name"), ("Joints", "name"))
    part = Folded(
        "Part",
        (
            Notes(("Shown.",), brief="hint"),
            Notes(("Hidden.",)),
            Facts((Fact("a", "1"),)),
            Table(heads, rows, brief="fault"),
            Table(heads, rows, brief=""),
            Table(heads, rows),
        ),
    )
    section = Section("Verb", "Lead.", (part,), (("done", "well"), ("", "so far")))
    assert brief(Page("Title", "", (), (section,), (("last", "word"),))).splitlines() == [
        "done         well",
        "             so far",
        "hint         Shown.",
        "fault        run1, dead channel",
        "run1         dead channel",
        "last         word",
    ]


def test_terminal_says_what_every_verb_came_to(make, undrawn):
    for verb, words in {
        "design": "designed     condition number 171 → 9.31, limits used up to 100.0 %",
        "check": "checked      velocity of elbow_joint reaches 131 % of its limit",
        "identify": "identified   hold-out error, sum of joints, ",
        "analyze": "identifiable 43 combinations of 70 parameters; ",
        "diagnose": "diagnosed    elbow_joint has Stribeck friction",
        "demo": "hidden       Stribeck friction at elbow_joint (seed 7): named",
    }.items():
        assert words in brief(page_of(make[verb]()[0], {})).replace("\u00a0", " ")
