"""The summary changes only where the result does."""

import difflib

import pytest

from excitant.reports import summarize
from excitant.reports.reading import at


def changed(before, after):
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), lineterm="", n=0)
    return [line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---")]


def test_summary_is_plain_lines(run):
    text = summarize(run[0])
    assert text.startswith(f"[[excitant {run[0]['verb']}]]\n")
    assert text.endswith("\n")
    assert not any(line != line.rstrip() or "\t" in line for line in text.splitlines())


@pytest.mark.parametrize(
    ("verb", "path"),
    [
        ("design", ("condition_number", "final")),
        ("design", ("starts", 2, "condition_number")),
        ("check", ("limits", "velocity")),
        ("identify", ("joints", 3, "validate", "rms")),
        ("identify", ("parameters", 17, "value")),
        ("identify", ("base_parameters", 5, "std")),
        ("analyze", ("practical", 7, "rel_std")),
        ("diagnose", ("findings", 0, "parameters", 0, "value")),
        ("diagnose", ("extended", "joints", 6, "nrmse")),
    ],
)
@pytest.mark.parametrize("value", [123456.789, -1.5e-9, None])
def test_one_changed_value_changes_one_line(verb, path, value, make):
    before, after = make[verb]()[0], make[verb]()[0]
    holder = after
    for key in path[:-1]:
        holder = holder[key]
    holder[path[-1]] = value
    found = changed(summarize(before), summarize(after))
    assert [line[0] for line in found] == ["-", "+"]
    assert len(found[0]) == len(found[1]) or verb == "design"


def test_time_taken_and_paths_do_not_count(make):
    before, after = make["design"]()[0], make["design"]()[0]
    after["wall_s"], after["files"] = 99.0, ["elsewhere/trajectory.csv"]
    assert summarize(before) == summarize(after)


def test_every_accuracy_and_finding_is_in_it(make):
    result = make["demo"]()[0]
    text = summarize(result)
    for row in result["diagnose"]["extended"]["joints"]:
        assert f"{row['rms']:.5g}" in text
    for k, finding in enumerate(result["diagnose"]["findings"]):
        assert f"[[finding {k + 1}: {finding['effect']}]]" in text
    for row in result["identify"]["base_parameters"]:
        assert row["expression"] in text
    assert "correct                          = yes" in text


def test_names_cannot_break_lines():
    result = {"verb": "identify", "robot": "two\nlines", "joints": [{"name": "a\nb", "train": {}}]}
    assert "two lines" in summarize(result)
    assert "    a b " in summarize(result)


def test_missing_keys_are_none():
    assert at({"a": {"b": None}}, "a", "b", "c") is None
    assert at([1], "a") is None
