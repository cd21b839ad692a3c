"""The page is self-contained, accessible and complete, whatever the result lacks."""

import hashlib
import json
import re
import time
from base64 import b64encode

import matplotlib as mpl
import numpy as np
import pytest
from marks import refused
from records import full

from excitant.exceptions import BadInput
from excitant.reports import load_run, page_of, save_run, summary
from excitant.reports import page as p

MOTIONS = ("design", "check", "show", "rehearse")
VERBS = ("robots", *MOTIONS, "identify", "analyze", "diagnose", "fleet")
PLAYED = {"robots", "design", "show", "go", "demo"}
NAMESPACE = "http://www.w3.org/1999/xhtml"  # a name that three.js gives to elements, no address


def plays(page):
    return any(attrs.get("class") == "player" for attrs in page.all("figure"))


def test_page_needs_no_network_and_only_its_own_script_may_run(page):
    for _, attrs in page.elements:
        for name in ("src", "href", "xlink:href", "action", "srcset", "data", "poster"):
            assert not re.match(r"[a-z]+:(?!image/png)|/", attrs.get(name) or "#")
    source = page.source.replace(NAMESPACE, "")
    source = source.replace("/*! https://github.com/leeoniya/uPlot (v1.6.32) */", "")
    assert not re.search(r"https?://|@import|<link|url\((?!#)", source)
    scripts = re.findall(r"<script>(.*?)</script>", page.source, re.DOTALL)
    policy = next(a["content"] for a in page.all("meta") if "http-equiv" in a)
    data = page.source.count('<script type="application/json"')
    drawn = 'class="figure"' in page.source
    assert len(scripts) == 1 + 2 * drawn + 2 * plays(page)
    assert data >= drawn + plays(page)
    assert page.source.count("<script") == len(scripts) + data
    if drawn:
        assert "uPlot=function" in scripts[1]
        assert "MIT License" in scripts[1]
    digests = (b64encode(hashlib.sha256(text.encode()).digest()).decode() for text in scripts)
    allowed = " ".join(f"'sha256-{digest}'" for digest in digests)
    assert policy.endswith(f"script-src {allowed}")
    assert "default-src 'none'" in policy


def test_only_pages_that_play_a_motion_carry_its_library(written, make):
    assert {verb for verb in make if "WebGLRenderer" in written(verb).source} == PLAYED


def test_page_is_well_formed_and_small(page):
    assert len(page.source.encode()) < 3_000_000
    assert page.elements[0] == ("html", {"lang": "en"})
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert len(page.all("meta")) >= 3
    levels = [int(tag[1]) for tag, _ in page.elements if re.fullmatch("h[1-6]", tag)]
    assert (levels[0], levels.count(1)) == (1, 1)
    assert max(np.diff(levels)) <= 1


def test_contents_lead_to_every_heading_and_tables_scroll_in_their_container(page):
    hrefs = [attrs["href"] or "" for attrs in page.all("a")]
    links = {href[1:] for href in hrefs if href.startswith("#")}
    assert {attrs["id"] for attrs in page.all("h3")} <= links
    assert links <= {attrs.get("id") for _, attrs in page.elements}
    containers = [attrs for attrs in page.all("div") if "scroll" in (attrs.get("class") or "")]
    assert len(containers) == len(page.all("table"))
    assert all(attrs["tabindex"] == "0" and attrs["aria-label"] for attrs in containers)
    assert {attrs["scope"] for attrs in page.all("th")} <= {"col", "row", "colgroup"}
    heads = re.findall(r"<tr>((?:(?!<tr>).)*?)</tr></thead>", page.source, re.DOTALL)
    assert len(heads) == len(page.all("table"))
    assert not any(re.search("<th[^>]*></th>", head) or "<th" not in head for head in heads)


def test_every_figure_says_what_it_shows_and_has_a_unit_on_its_axes(page):
    assert all(attrs["aria-hidden"] == "true" for attrs in page.all("svg"))
    drawings = [attrs for attrs in page.all("div") if attrs.get("role") == "img"]
    assert all(len(attrs["aria-label"] or "") > 20 for attrs in drawings)
    assert (bool(page.labels) or plays(page)) != ("Comparison of runs" in page.words)
    assert len(page.all("figure")) == len(page.all("figcaption"))
    panels = [a for a in page.all("div") if (a.get("class") or "").split()[:1] == ["panel"]]
    assert len(panels) == len(drawings)
    figures = re.findall(r'class="figure">(.*?)</script>', page.source, re.DOTALL)
    for panel in (panel for source in figures for panel in json.loads(source)["panels"]):
        for axes in panel["axes"]:
            names = axes["x"]["label"] + axes["y"]["label"]
            inner = panel["shared"] and axes is not panel["axes"][-1]
            assert inner or "[" in names, names


@pytest.mark.parametrize("verb", ["diagnose", "go", "demo"])
def test_every_finding_appears_with_its_evidence(verb, make, written):
    page = written(verb)
    words = re.sub("(Stribeck|inertial) ", "", page.words)
    for k, finding in enumerate(make["diagnose"]()[0]["findings"]):
        assert f"Finding {k + 1}: {finding['effect'].split('_')[-1]}" in words
        for rival in finding.get("rivals") or []:
            assert rival["effect"].replace("_", " ") in words
    assert sum("with the fitted" in label for label in page.labels) == 2
    assert "Move wrist_roll_joint through" in words


@pytest.mark.parametrize(
    ("truth", "says", "last"),
    [
        ("named", "✓ yes", ": named"),
        ("undecided", "◐ among what is undecided", ": among what is left undecided"),
        ("missed", "✗ no", ": not found"),
    ],
)
def test_demo_says_first_what_was_hidden_and_whether_it_was_found(truth, says, last, make):
    result, _ = make["demo"]()
    result["verdict"]["truth"] = truth
    page = page_of(result, {})
    top = " ".join(summary(page).split("[[Robot]]")[0].split())
    for words in ("the given model misses 62 %", "Stribeck friction at elbow_joint", says):
        assert words in top
    assert dict(page.brief)["hidden"].endswith(last)


def test_go_shows_every_joint_with_its_cause_first(make):
    result, _ = make["go"]()
    [table] = [block for block in page_of(result, {}).summary if isinstance(block, p.Table)]
    causes = {row[0].text: row[-1].text for row in table.rows}
    assert causes["elbow_joint"].startswith("Stribeck friction")
    for row, joint in zip(table.rows, result["identify"]["joints"], strict=True):
        given = (joint["baseline"] or {}).get("nrmse")
        assert (row[0].text, row[1].value) == (joint["name"], given)


def test_series_without_values_or_of_wrong_shape_have_no_panel(make, show, written):
    result, series = make["identify"]()
    series["measured"][:, 2] = np.nan
    gone = set(written("identify").labels) - set(show(result, series).labels)
    assert [label.partition(":")[0] for label in gone] == [result["joints"][2]["name"]] * 2
    result, series = make["diagnose"]()
    series |= {"measured": np.zeros(5), "finding0_fit": np.zeros(3), "t": series["t"][:, None]}
    assert not any("measured torque over time" in x for x in show(result, series).labels)


@pytest.mark.parametrize(
    ("change", "where"),
    [
        (lambda r: r.pop("headline"), "`headline`"),
        (lambda r: r["findings"][0].pop("verdict"), r"`verdict` - at `\$.findings\[0\]`"),
        (lambda r: r["simulation"]["joints"][1].update(name=3), r"\$.simulation.joints\[1\].name"),
        (lambda r: r["faults"].append({}), r"\$.faults\[2\]"),
        (lambda r: r.update(more=1), "`more`"),
    ],
)
def test_what_is_no_record_is_refused_by_its_path(change, where, make, tmp_path):
    result, series = make["diagnose"]()
    save_run(tmp_path, result, series)
    change(result)
    refused(rf"^result.json: .*{where}", page_of, result, series, error=BadInput)
    (tmp_path / "result.json").write_text(json.dumps(result))
    refused(rf"^{tmp_path}/result.json: .*{where}", load_run, tmp_path, error=BadInput)


@pytest.mark.slow
@pytest.mark.parametrize("verb", VERBS)
def test_any_series_may_be_missing_or_spoilt(verb, make, show):
    result, series = make[verb]()
    few = {key: np.asarray(values, float)[:40] for key, values in series.items()}
    assert show(result, {}).words
    for key, values in few.items():
        for spoilt in (np.zeros(3), np.full_like(values, np.nan), values[..., :-1], values[:-1]):
            show(result, few | {key: spoilt})
        show(result, {k: x for k, x in few.items() if k != key})


def test_empty_results_render(make, show):
    for verb in make:
        assert "h1" in show(full(verb=verb), {}).source
        assert summary(page_of(full(verb=verb), {})).startswith("[[")


HOSTILE = '<script>alert("1")</script> & $\\frac{1}$ \'"><img src=x onerror=y>'


def _rename(value):
    if isinstance(value, dict):
        kept = ("verb", "unit", "kind", "category", "decided_by", "verdict", "shape")
        kept += ("first", "last")
        return {key: item if key in kept else _rename(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rename(item) for item in value]
    return HOSTILE if isinstance(value, str) else value


@pytest.mark.parametrize("verb", VERBS)
def test_hostile_names_stay_text(verb, make, show):
    result, series = make[verb]()
    page = show(_rename(result), {key: values[:40] for key, values in series.items()})
    data = page.source.count('<script type="application/json"')
    scripts = 1 + 2 * (verb in PLAYED) + 2 * ('class="figure"' in page.source)
    assert page.source.count("<script") == len(page.all("script")) == scripts + data
    assert "<img" not in page.source
    assert not any(name.startswith("on") for _, attrs in page.elements for name in attrs)
    assert HOSTILE in page.words


def test_rendering_is_repeatable_takes_seconds_and_changes_no_setting(make, show, written):
    run = make["diagnose"]()
    before, start = dict(mpl.rcParams), time.process_time()
    assert show(*run).source == written("diagnose").source
    assert time.process_time() - start < 8
    assert dict(mpl.rcParams) == before


def test_a_quantity_without_a_limit_does_not_hold_it(show):
    limits = {"velocity": 0.5, "acceleration": 0.0}
    worst = {"velocity": {"joint": "a", "t": 1.0}, "acceleration": None}
    result = full(verb="check", joints=["a"], limits=limits, worst=worst)
    assert show(result, {}).words.count("no limit given") == 1
