"""The page of identify: errors with intervals, on-line estimation, payload, link by link."""

import re

from records import full

from excitant.reports import page_of, summary
from excitant.reports.figure import Band
from excitant.reports.figures.torque import INTERVAL, Curves, torque_figure
from excitant.reports.page import Notes, Table
from excitant.reports.sections.identify import identify_section
from excitant.results import record_of

CURVES = Curves("given", "identified", "identified", "caption", band="half_width")
PARTS = {"Payload", "On-line estimation", "Estimates over time"}


def test_every_part_is_there_with_its_figure(make, show, written):
    page = written("identify")
    assert set(page.headings) >= PARTS
    assert "over time, at the end" in " ".join(page.labels)
    assert not re.search(r"\bnan\b", page.words.lower())
    result, series = make["identify"]()
    del result["online"], result["payload"]
    assert not set(show(result, series).headings) & PARTS


def test_poor_excitation_and_payload_are_in_words(written):
    said = written("identify").words
    assert "not exciting enough since 2.1 s: 3 of 40 visible <directions>" in said
    for part in ("1.5000 ± 0.0020 kg", "20.00 ± 0.10 mm", "200.0 ± 5.0 mm", "held by link7",
                 "Torque was recorded as current", "along z is known to ±10 mm only."):  # fmt: skip
        assert part in said, part


def test_estimates_shown_are_those_that_were_learnt(written):
    """Of every link one parameter at most, and of every joint; with their units."""
    titles = [label for label in written("identify").labels if "over time, at the end" in label]
    owners = [title.split(" over time")[0].rpartition(".")[0] for title in titles]
    assert 0 < len(set(owners)) == len(owners) <= 12
    assert all(re.search(r"± \S+ (kg|N)", title) for title in titles)


def test_the_torque_figure_explains_its_band(make):
    _, series = make["identify"]()
    half = series.pop("half_width")
    plain, figure, short = (
        torque_figure(["a", "b"], series | more, "N·m", CURVES)
        for more in ({}, {"half_width": half}, {"half_width": half[1:]})
    )
    assert {key.label for key in figure.legend} - {key.label for key in plain.legend} == {INTERVAL}
    assert INTERVAL in figure.panels[0].label
    for shown, bands in ((figure, 2), (plain, 0), (short, 0)):
        marks = [mark for axes in shown.panels[0].axes for mark in axes.marks]
        assert sum(isinstance(mark, Band) for mark in marks) == bands


def test_intervals_and_refusal_in_words(make):
    def blocks(result):
        return [b for part in identify_section(record_of(result), {}).parts for b in part.blocks]

    found = blocks(make["identify"]()[0])
    (table,) = (b for b in found if isinstance(b, Table) and "Hold-out inside" in dict(b.columns))
    assert [cell.text for cell in table.rows[0]][1:] == ["0.300", "0.100", "71\u00a0%"]
    refused = blocks(full(verb="identify", refusal="it is worse"))
    [refusal] = (b for b in refused if isinstance(b, Notes))
    assert (refusal.sentences, refusal.tone) == (["It is worse."], "poor")


def test_link_by_link_says_what_each_link_shows_and_what_is_missing(make):
    text = " ".join(summary(page_of(make["identify"]()[0], {})).split())
    for said in ("1 of 2 (1 + 0, from the last link inward)", "[Link l2]",
                 "Torque of j2: 100 rows of r.", "determined 1.00 0.10 l2.Izz",
                 "not shown - - l2.m",
                 "[Link l1] j1 does not move."):  # fmt: skip
        assert said in text, said


def test_absurd_numbers_of_a_saved_run_are_none(make):
    result, _ = make["identify"]()
    result["links"][0]["centre"]["given"] = [1e308, 0.1, None]
    assert "–, 100, –" in summary(page_of(result, {}))
