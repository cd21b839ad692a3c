"""The page on effects of one's own runs as printed, and its effect is diagnosed."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from excitant.analysis import diagnose
from excitant.analysis.diagnosis_result import diagnose_result
from excitant.robots.effects import EFFECTS

PAGE = Path(__file__).parents[1] / "docs" / "add-an-effect.md"


@pytest.fixture(scope="module")
def page() -> Iterator[dict[str, Any]]:
    """What the page's examples leave, in one namespace."""
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 3
    known, names, printed = dict(EFFECTS), {"__name__": "page"}, io.StringIO()
    try:
        with contextlib.redirect_stdout(printed):
            for block in blocks:
                exec(compile(block, str(PAGE), "exec", dont_inherit=True), names)
        yield {**names, "printed": printed.getvalue()}
    finally:
        EFFECTS.clear()
        EFFECTS.update(known)


def test_effect_of_the_page_is_known_and_written(page: dict[str, Any]) -> None:
    assert EFFECTS["taut_hose"] is page["TautHose"]
    entry = {"effect": "taut_hose", "joints": ["joint2"], "values": [12.0], "angle": 0.4}
    assert page["entries"] == [entry]
    assert str(entry) in page["printed"]


def test_effect_of_the_page_is_identified(page: dict[str, Any]) -> None:
    assert page["best"] == 0.4
    assert page["found"].values[0] == pytest.approx(12.0, rel=0.05)
    best, without = page["tried"][0.4].validate, page["without"].validate
    assert best.rms[1] < 0.7 * without.rms[1]
    assert all(
        tried.validate.rms[1] > best.rms[1] for a, tried in page["tried"].items() if a != 0.4
    )


def test_effect_of_the_page_is_diagnosed(page: dict[str, Any]) -> None:
    diagnosis = diagnose(page["given"], page["runs"][:1], validate=page["runs"][1:])
    lead = diagnosis.findings[0].effect
    assert (lead.name, lead.joints) == ("taut_hose", ("joint2",))
    assert lead.angle == pytest.approx(0.4, abs=0.1)
    assert lead.values[0] == pytest.approx(12.0, rel=0.1)
    (entry,) = [f for f in diagnose_result(diagnosis)["findings"] if f["effect"] == "taut_hose"]
    assert entry["parameters"][0]["name"] == "joint2.hose"
