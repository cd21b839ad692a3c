"""Every page does what it says: its code runs as printed, its links lead somewhere, it builds.

A page is followed from top to bottom in an empty folder of its own; its Python blocks share one
namespace. ``console`` blocks hold commands after ``$`` and what they print, ``text`` blocks what
the block before them prints; lines may be left out, ``...`` stands for anything, and numbers hold
to 10 %. Blocks with a ``title`` are files. ``bash`` blocks are for other machines and do not run.
"""

from __future__ import annotations

import contextlib
import importlib.util
import io
import math
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest

from excitant.analysis import diagnose
from excitant.cli import main
from excitant.robots.effects import EFFECTS

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGE = DOCS / "add-an-effect.md"
SLOW = ("how-to/next-experiment.md", "how-to/rehearse.md")  # more than 10 s

BLOCK = re.compile(r"^```(\w+)(?: title=\"(.*?)\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^\$ excitant ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
NUMBER = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?)")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")


def pages() -> list[str]:
    return sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))


def followed() -> list[Any]:
    """Pages with something to run; the one with fixtures of its own is followed below."""
    found = [p for p in pages() if DOCS / p != PAGE and BLOCK.search((DOCS / p).read_text("utf-8"))]
    return [pytest.param(p, marks=pytest.mark.slow) if p in SLOW else p for p in found]


def says(shown: str, line: str) -> bool:
    """Whether a line says what a page shows: the same words, and numbers to 10 %."""
    shown, line = (" ".join(text.split()) for text in (shown, line))
    parts = [NUMBER.split(part) for part in shown.split("...")]
    pattern = ".*".join(
        "".join(NUMBER.pattern if k % 2 else re.escape(text) for k, text in enumerate(part))
        for part in parts
    )
    found = re.fullmatch(pattern, line)
    numbers = [float(text) for part in parts for text in part[1::2]]
    return found is not None and all(
        math.isclose(float(text), number, rel_tol=0.1, abs_tol=1e-12)
        for text, number in zip(found.groups(), numbers, strict=True)
    )


def assert_shown(shown: str, printed: str, where: str) -> None:
    """Refuse a page that shows what is not printed, or not in this order."""
    lines = iter(printed.splitlines())
    for expected in shown.splitlines():
        if expected.strip() and not any(says(expected, line) for line in lines):
            pytest.fail(f"{where}: not printed after the lines before it: {expected}\n{printed}")


@dataclass
class Reader:
    """Someone who does what a page says."""

    page: str
    names: dict[str, Any] = field(default_factory=lambda: {"__name__": "page"})
    printed: str = ""

    def follow(self) -> None:
        for kind, title, text in BLOCK.findall((DOCS / self.page).read_text(encoding="utf-8")):
            if title:
                Path(title).write_text(text, encoding="utf-8")
            elif kind == "python":
                self.printed = self._output(lambda code=text: self._execute(code))
            elif kind == "text":
                assert_shown(text, self.printed, self.page)
            elif kind == "console":
                self._commands(text)
            elif kind == "sh":
                pytest.fail(f"{self.page}: write commands as console, with $ before each")

    def _execute(self, code: str) -> None:
        exec(compile(code, self.page, "exec", dont_inherit=True), self.names)

    def _commands(self, text: str) -> None:
        commands = COMMAND.findall(text)
        assert len(commands) == len(re.findall(r"^\$", text, re.MULTILINE)) > 0, text
        for words, shown in commands:
            status: list[int] = []
            call = shlex.split(words.replace("\\\n", " "))
            self.printed = self._output(lambda call=call, to=status: to.append(main(call)))
            unmet = re.search(r"^(excitant: |failed )", shown, re.MULTILINE)
            assert status == [1 if unmet else 0], f"{self.page}: {words}\n{self.printed}"
            assert_shown(shown, self.printed, f"{self.page}: excitant {words}")

    @staticmethod
    def _output(act: Any) -> str:
        printed = io.StringIO()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            act()
        return printed.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("page", followed())
def test_a_page_does_what_it_says(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Reader(page).follow()


def test_wrong_pages_are_seen() -> None:
    assert says("error 0.52 at joint2, r² ...", "  error 0.51 at joint2, r² 0.99")
    assert not says("error 0.52 at joint2", "error 0.6 at joint2")
    assert not says("error 0.52 at joint2", "error 0.52 at joint1")
    with pytest.raises(pytest.fail.Exception, match="second"):
        assert_shown("first\nsecond", "second\nfirst", "page")


@pytest.mark.parametrize("page", [*pages(), "../README.md"])
def test_links_lead_to_files(page: str) -> None:
    path = DOCS / page
    targets = LINK.findall(path.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (path.parent / target).exists()]
    assert not missing, f"{page} links to what is not there: {missing}"


def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    missing = [m for m in ("mkdocs", "material", "mkdocstrings") if not importlib.util.find_spec(m)]
    if missing:
        pytest.skip(f"{', '.join(missing)} not installed: pip install 'excitant[docs]'")
    words = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir"]
    built = subprocess.run([*words, tmp_path], cwd=ROOT, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr  # --quiet would hide warnings from --strict, too
    for name in ("robots", "robots.effects", "design", "identify", "analysis", "reports"):
        page = tmp_path / "reference" / f"{name.rpartition('.')[2]}.html"
        shown = re.findall(r'id="(excitant\.[\w.]+)"', page.read_text(encoding="utf-8"))
        public = set(import_module(f"excitant.{name}").__all__)
        assert public <= {identifier.rpartition(".")[2] for identifier in shown}
    assert "--mass-uncertainty" in (tmp_path / "reference" / "cli.html").read_text("utf-8")
    for page in tmp_path.rglob("*.html"):
        loaded = r"""<(?:script|link|img)[^>]*(?:src|href)=["']?https?:"""
        outside = re.findall(loaded, page.read_text(encoding="utf-8"))
        assert not outside, f"{page} needs the network: {outside}"


@pytest.fixture(scope="module")
def page() -> Iterator[dict[str, Any]]:
    """What the examples of the page on effects leave, in one namespace."""
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
    assert diagnosis.findings[0].verdict == "named"
    lead = diagnosis.findings[0].effect
    assert (lead.name, lead.joints) == ("taut_hose", ("joint2",))
    assert lead.angle == pytest.approx(0.4, abs=0.1)
    assert lead.values[0] == pytest.approx(12.0, rel=0.1)
    (entry,) = [f for f in diagnosis.result()["findings"] if f["effect"] == "taut_hose"]
    assert entry["parameters"][0]["name"] == "joint2.hose"
