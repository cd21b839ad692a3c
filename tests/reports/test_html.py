"""The page is self-contained, accessible and complete, whatever the result lacks."""

import copy
import hashlib
import re
import time
from base64 import b64encode
from html.parser import HTMLParser
from itertools import pairwise

import numpy as np
import pytest

from excitant.reports import html, page_of, summary
from excitant.reports import values as v


def render(result, series):
    return html(page_of(result, series))


VOID = {"meta", "br", "wbr", "hr", "img", "link", "input"}


class Page(HTMLParser):
    """Elements of a page in order, checked to be closed as they were opened."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.text: list[str] = []
        self.feed(page)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "script"} & set(self.open):
            self.text.append(data)

    def all(self, *tags):
        return [attrs for tag, attrs in self.elements if tag in tags]

    @property
    def words(self):
        return " ".join("".join(self.text).split())


def test_page_needs_no_network_and_only_its_own_script_may_run(page):
    for _, attrs in Page(page).elements:
        for name in ("src", "href", "xlink:href", "action", "srcset", "data", "poster"):
            assert (attrs.get(name) or "#").startswith(("#", "data:image/png"))
    assert not re.search(r"https?://|@import|<link|url\((?!#)", page)
    scripts = re.findall(r"<script[^>]*>(.*?)</script>", page, re.DOTALL)
    policy = next(a["content"] for a in Page(page).all("meta") if "http-equiv" in a)
    assert len(scripts) == page.count("<script") == 1
    digest = b64encode(hashlib.sha256(scripts[0].encode()).digest()).decode()
    assert f"script-src 'sha256-{digest}'" in policy
    assert "default-src 'none'" in policy


def test_page_is_well_formed_and_small(page):
    assert len(page.encode()) < 2_000_000
    root, *_ = Page(page).elements
    assert root == ("html", {"lang": "en"})
    ids = [attrs["id"] for _, attrs in Page(page).elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    assert len(Page(page).all("meta")) >= 3
    levels = [int(tag[1]) for tag, _ in Page(page).elements if re.fullmatch("h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in pairwise(levels))


def test_contents_lead_to_every_heading_and_tables_scroll_in_their_container(page):
    page = Page(page)
    links = {(attrs["href"] or "")[1:] for attrs in page.all("a")}
    assert {attrs["id"] for attrs in page.all("h3")} <= links
    assert links <= {attrs.get("id") for _, attrs in page.elements}
    containers = [attrs for attrs in page.all("div") if "scroll" in (attrs.get("class") or "")]
    assert len(containers) == len(page.all("table"))
    assert all(attrs["tabindex"] == "0" and attrs["aria-label"] for attrs in containers)


def test_every_figure_says_what_it_shows_and_has_a_unit_on_its_axes(page):
    found = Page(page)
    drawings = [attrs for attrs in found.all("svg") if attrs.get("aria-hidden") != "true"]
    assert all(attrs["role"] == "img" and len(attrs["aria-label"] or "") > 20 for attrs in drawings)
    assert len(found.all("figure")) == len(found.all("figcaption"))
    panels = [a for a in found.all("div") if (a.get("class") or "").split()[:1] == ["panel"]]
    assert len(panels) == len(drawings)
    drawings = re.findall(r'<svg role="img".*?</svg>', page, re.DOTALL)
    for drawing in drawings:
        texts = re.findall(r"<text[^>]*>([^<]*)</text>", drawing)
        assert any(re.search(r"\[.+\]|share of", text) for text in texts), texts


@pytest.mark.parametrize("verb", ["diagnose", "demo"])
def test_every_finding_appears_with_its_evidence(verb, make, written):
    page = Page(written(verb))
    findings = make["diagnose"]()[0]["findings"]
    for k, finding in enumerate(findings):
        assert f"Finding {k + 1}: {finding['effect'].split('_')[-1]}" in re.sub(
            "(Stribeck|inertial) ", "", page.words
        )
        for rival in finding.get("rivals") or []:
            assert rival["effect"].replace("_", " ") in page.words
    labels = [attrs.get("aria-label") or "" for attrs in page.all("svg")]
    assert sum("with the fitted" in label for label in labels) == 2
    assert "Move wrist_roll_joint through" in page.words


def test_demo_says_first_what_was_hidden_and_whether_it_was_named(make, undrawn):
    result, _ = make["demo"]()
    top = Page(render(result, {})).words.split("Excitation design")[0]
    holdout = result["diagnose"]["findings"][0]["holdout"]
    assert result["diagnose"]["headline"] in top
    assert "Stribeck friction at elbow_joint" in top
    assert "✓ yes" in top
    assert f"{holdout['rms_before']:.2f} → {holdout['rms_after']:.2f}" in top
    result["verdict"]["correct"] = False
    assert "✗ no" in Page(render(result, {})).words.split("Excitation design")[0]


def test_joint_without_series_has_no_empty_panel(make, written):
    result, series = make["identify"]()
    full = len(Page(written("identify")).all("svg"))
    series["measured"] = series["measured"].copy()
    series["measured"][:, 2] = np.nan
    assert len(Page(render(result, series)).all("svg")) == full - 1


def test_page_stands_without_series(run, undrawn):
    result, _ = run
    assert Page(render(result, {})).words


def _paths(value, path=()):
    """Where a result holds values; of lists, only into the first item."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield (*path, key)
            yield from _paths(item, (*path, key))
    elif isinstance(value, list) and value:
        yield (*path, 0)
        yield from _paths(value[0], (*path, 0))


@pytest.mark.slow
@pytest.mark.parametrize("verb", ["design", "check", "identify", "analyze", "diagnose"])
def test_any_value_may_be_null(verb, make, undrawn):
    result, series = make[verb]()
    for key in ("starts", "joints", "links", "base_parameters", "parameters", "practical"):
        if isinstance(result.get(key), list):
            result[key] = result[key][:2]
    few = {key: values[:40] for key, values in series.items()}
    for path in _paths(result):
        if path == ("verb",):
            continue
        spoilt = copy.deepcopy(result)
        holder = spoilt
        for key in path[:-1]:
            holder = holder[key]
        holder[path[-1]] = None
        render(spoilt, few if path[0] == "limit_values" else {})
        summary(page_of(spoilt, {}))


def test_empty_results_render(make):
    for verb in make:
        assert "h1" in render({"verb": verb}, {})
        assert summary(page_of({"verb": verb}, {})).startswith("[[")


HOSTILE = '<script>alert("1")</script> & $\\frac{1}$ \'"><img src=x onerror=y>'


def _rename(value):
    if isinstance(value, dict):
        return {
            key: item if key in ("verb", "unit") else _rename(item) for key, item in value.items()
        }
    if isinstance(value, list):
        return [_rename(item) for item in value]
    return HOSTILE if isinstance(value, str) else value


@pytest.mark.parametrize("verb", ["design", "check", "identify", "analyze", "diagnose"])
def test_hostile_names_stay_text(verb, make):
    result, series = make[verb]()
    few = {key: values[:40] for key, values in series.items()}
    page = render(_rename(result), few)
    assert page.count("<script") == 1
    assert "<img" not in page
    found = Page(page)
    assert len(found.all("script")) == 1
    assert not found.all("img")
    assert not any(name.startswith("on") for _, attrs in found.elements for name in attrs)
    assert HOSTILE in found.words


def test_series_of_wrong_shape_are_left_out(make):
    result, series = make["diagnose"]()
    series |= {"measured": np.zeros(5), "finding0_fit": np.zeros(3), "t": series["t"][:, None]}
    page = Page(render(result, series))
    labels = [attrs.get("aria-label") or "" for attrs in page.all("svg")]
    assert not any("measured torque over time" in label for label in labels)


def test_nan_values_draw_no_warning(make, recwarn):
    result, series = make["diagnose"]()
    rng = np.random.default_rng(0)
    for key in series:
        series[key] = np.where(rng.random(series[key].shape) < 0.3, np.nan, series[key])
    series["t"] = make["diagnose"]()[1]["t"]
    render(result, series)
    assert [str(w.message) for w in recwarn] == []


def test_rendering_is_repeatable_takes_seconds_and_changes_no_setting(make, written):
    import matplotlib as mpl

    run = make["diagnose"]()
    before, start = dict(mpl.rcParams), time.process_time()
    assert render(*run) == written("diagnose")
    assert time.process_time() - start < 8
    assert dict(mpl.rcParams) == before


def test_a_quantity_without_a_limit_does_not_hold_it() -> None:
    result = {
        "verb": "check",
        "robot": "arm",
        "joints": ["a"],
        "limits": {"velocity": 0.5, "acceleration": 0.0},
        "worst": {"velocity": {"joint": "a", "t": 1.0}, "acceleration": None},
        "holds": True,
    }
    page = render(result, {})
    assert page.count("no limit given") == 1


@pytest.mark.parametrize("found", [{}, {"a": None}, {"a": {}}, {"a": {"b": None}}, None, "a"])
def test_an_absent_key_or_null_reads_as_none(found):
    assert v.at(found, "a", "b") is None
    assert v.real(found, "a", "b") is None
    assert v.text(found, "a", "b") == ""
    for read in (v.items, v.records, v.words, v.reals):
        assert len(read(found, "a", "b")) == 0
    assert v.median([{"a": None}, {}], "a") is None
    assert v.curve({}, "q") is v.array({}, "q", None) is v.times({}) is None
    assert v.number(v.at(found, "a", "b")) == v.NONE
