"""README and every page do what they say: code runs as printed, links lead somewhere, it builds.

A page is followed from top to bottom in an empty folder of its own; its Python blocks share one
namespace. ``console`` blocks hold commands after ``$`` and what they print, ``text`` blocks what
the block before them prints; lines may be left out, ``...`` stands for anything, and numbers hold
to 10 %. Blocks with a ``title`` are files. ``bash`` blocks are for other machines and do not run.
"""

import contextlib
import importlib.util
import inspect
import io
import json
import math
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any
from unittest import mock

import pytest
from run_notebooks import NOTEBOOKS, outputs_of

from excitant.analysis import diagnose
from excitant.cli import app, main
from excitant.identify.reading.mapping import ColumnMap, column_map
from excitant.robots.effects import EFFECTS
from excitant.robots.schema import parsed_yaml

# each page says something of its own, and what its reader will see
pytestmark = [pytest.mark.whole, pytest.mark.usefixtures("own_steps")]
ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
README = ROOT / "README.md"
EFFECT_PAGE = "add-an-effect.md"  # followed in a test of its own
# of programs that pages mention beside excitant
OTHERS = {"--nthreads", "--seconds", "--tacho", "--storage", "--param-file", "--csv"}
OTHERS |= {"--go", "--scale", "--tolerance", "--controller", "--states", "--motions"}  # ros2_client

BLOCK = re.compile(r"^```(\w+)(?: title=\"(.*?)\")?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
COMMAND = re.compile(r"^\$ excitant ((?:.*\\\n)*.*)\n((?:(?!\$ ).*\n)*)", re.MULTILINE)
NUMBER = re.compile(r"(-?[0-9]+(?:\.[0-9]+)?(?:e[-+]?[0-9]+)?)")
LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)")

PAGES = sorted(str(page.relative_to(DOCS)) for page in DOCS.rglob("*.md"))
FOLLOWED = [p for p in PAGES if p != EFFECT_PAGE and BLOCK.search((DOCS / p).read_text("utf-8"))]


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
                with self._listening():
                    exec(compile(text, self.page, "exec", dont_inherit=True), self.names)
            elif kind == "text":
                assert_shown(text, self.printed, self.page)
            elif kind == "console":
                self._commands(text)
            elif kind == "sh":
                pytest.fail(f"{self.page}: write commands as console, with $ before each")

    def _commands(self, text: str) -> None:
        commands = COMMAND.findall(text)
        assert len(commands) == len(re.findall(r"^\$", text, re.MULTILINE)) > 0, text
        for words, shown in commands:
            with self._listening():
                status = main(shlex.split(words.replace("\\\n", " ")))
            refusals = "excitant: |failed |the identified model is not |use no model "
            unmet = re.search(rf"^({refusals})", shown, re.MULTILINE)
            assert status == bool(unmet), f"{self.page}: {words}\n{self.printed}"
            assert_shown(shown, self.printed, f"{self.page}: excitant {words}")

    @contextlib.contextmanager
    def _listening(self) -> Iterator[None]:
        heard = io.StringIO()
        with contextlib.redirect_stdout(heard), contextlib.redirect_stderr(heard):
            yield
        self.printed = heard.getvalue()


@pytest.mark.slow
@pytest.mark.parametrize("page", FOLLOWED)
def test_a_page_does_what_it_says(page: str, here: Path) -> None:
    shutil.copytree(ROOT / "examples", here / "examples")
    Reader(page).follow()


def test_maps_of_the_page_on_recordings_are_understood() -> None:
    page = (DOCS / "how-to" / "my-recording.md").read_text("utf-8")
    maps = re.findall(r"^\|.*\| `(\{.*\})` \|$", page, re.MULTILINE)
    assert len(maps) >= 10
    for text in maps:
        assert column_map(parsed_yaml(text), "columns.yaml") != ColumnMap(), text


def test_wrong_pages_are_seen() -> None:
    assert says("error 0.52 at joint2, r² ...", "  error 0.51 at joint2, r² 0.99")
    assert not says("error 0.52 at joint2", "error 0.6 at joint2")
    assert not says("error 0.52 at joint2", "error 0.52 at joint1")
    with pytest.raises(pytest.fail.Exception, match="second"):
        assert_shown("first\nsecond", "second\nfirst", "page")


@pytest.mark.parametrize("page", [*PAGES, "../README.md"])
def test_links_lead_to_files(page: str) -> None:
    path = DOCS / page
    targets = LINK.findall(path.read_text(encoding="utf-8"))
    missing = [target for target in targets if not (path.parent / target).exists()]
    assert not missing, f"{page} links to what is not there: {missing}"


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_what_it_says(path: Path, here: Path) -> None:
    notebook = json.loads(path.read_text("utf-8"))
    kept = [cell["outputs"] for cell in notebook["cells"] if cell["cell_type"] == "code"]
    for shown, found in zip(kept, outputs_of(notebook), strict=True):
        kinds = [[sorted(o.get("data", o)) for o in outputs] for outputs in (shown, found)]
        assert kinds[0] == kinds[1]
        for expected, output in zip(map(_text, shown), map(_text, found), strict=True):
            assert_shown(expected, output, path.name)
    pictures = [o["data"].get("image/png", "") for cell in kept for o in cell if "data" in o]
    assert max(map(len, pictures)) < 300_000


def _text(output: dict[str, Any]) -> str:
    return "".join(output.get("text", ())) or output["data"]["text/plain"]


@pytest.mark.slow
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
        module = import_module(f"excitant.{name}")
        offered = [n for n, v in vars(module).items() if n[0] != "_" and not inspect.ismodule(v)]
        public = set(getattr(module, "__all__", offered))
        assert public <= {identifier.rpartition(".")[2] for identifier in shown}
    assert "--mass-uncertainty" in (tmp_path / "reference" / "cli.html").read_text("utf-8")
    for page in tmp_path.rglob("*.html"):
        loaded = r"""<(?:script|link|img)[^>]*(?:src|href)=["']?https?:"""
        outside = re.findall(loaded, page.read_text(encoding="utf-8"))
        assert not outside, f"{page} needs the network: {outside}"


@pytest.mark.slow
def test_effect_of_the_page_is_known_identified_and_diagnosed(here: Path) -> None:
    reader = Reader(EFFECT_PAGE)
    page = reader.names
    with mock.patch.dict(EFFECTS):
        reader.follow()
        assert EFFECTS["taut_hose"] is page["TautHose"]
        diagnosis = diagnose(page["given"], page["runs"][:1], validate=page["runs"][1:])
        (entry,) = [f for f in diagnosis.result()["findings"] if f["effect"] == "taut_hose"]
    written = {"effect": "taut_hose", "joints": ["joint2"], "values": [12.0], "angle": 0.4}
    assert page["entries"] == [written]
    errors = {angle: tried.validate.rms[1] for angle, tried in page["tried"].items()}
    assert page["best"] == 0.4 == min(errors, key=errors.get)
    assert page["found"].values[0] == pytest.approx(12.0, rel=0.05)
    assert errors[0.4] < 0.7 * page["without"].validate.rms[1]
    verdict, lead = diagnosis.findings[0].verdict, diagnosis.findings[0].effect
    assert (verdict, lead.name, lead.joints) == ("named", "taut_hose", ("joint2",))
    assert lead.angle == pytest.approx(0.4, abs=0.1)
    assert lead.values[0] == pytest.approx(12.0, rel=0.1)
    assert entry["parameters"][0]["name"] == "joint2.hose"


@pytest.mark.slow
def test_python_example_of_the_readme_names_the_payload(capsys: pytest.CaptureFixture[str]) -> None:
    [block] = re.findall(r"```python\n(.*?)```", README.read_text("utf-8"), re.DOTALL)
    assert len(block.splitlines()) <= 15
    exec(compile(block, str(README), "exec"), {"__name__": "readme"})
    assert "named payload ('wrist_3_joint',)" in capsys.readouterr().out


@cache
def known_options() -> set[str]:
    verbs = [app[name] for name in app if not name.startswith("-")]
    arguments = [argument for verb in verbs for argument in verb.assemble_argument_collection()]
    known = {name for argument in arguments for name in argument.names}
    return known | {"--help", "--version", "--debug"} | OTHERS


@pytest.mark.parametrize("page", [*PAGES, "../README.md"])
def test_options_that_pages_mention_exist(page: str) -> None:
    lines = [x for x in (DOCS / page).read_text("utf-8").splitlines() if "benchmarks/" not in x]
    named = set(re.findall(r"(?<![-\w|])--[a-z][a-z-]*", "\n".join(lines)))
    assert not named - known_options(), f"{page} names options that excitant does not have"


def test_site_and_start_page_lead_to_every_page_and_the_readme_fits_on_a_screen() -> None:
    nav, start = ((ROOT / p).read_text("utf-8") for p in ("mkdocs.yml", "docs/index.md"))
    pages = [p for p in PAGES if p != "index.md"]
    assert [p for p in pages if p not in nav] == []
    assert [p for p in pages if f"({p})" not in start] == []
    assert len(README.read_text("utf-8").splitlines()) <= 65
