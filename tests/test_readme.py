"""The README is true: its example runs as printed, and its commands and options exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from excitant.cli import app

ROOT = Path(__file__).parents[1]
README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
PAGES = [README, *sorted((ROOT / "docs").rglob("*.md"))]
OTHERS = {"--nthreads", "--seconds"}  # of programs that pages mention beside excitant


@pytest.mark.slow
def test_python_example_of_the_readme_names_the_payload(capsys: pytest.CaptureFixture[str]) -> None:
    [block] = re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL)
    assert len(block.splitlines()) <= 15
    exec(compile(block, str(README), "exec"), {"__name__": "readme"})
    printed = capsys.readouterr().out
    assert "named payload ('wrist_3_joint',)" in printed


def test_commands_of_the_readme_are_understood() -> None:
    commands = re.findall(r"^    excitant (.*)$", TEXT, re.MULTILINE)
    assert len(commands) >= 8
    for command in commands:
        words = shlex.split(command, comments=True)
        verb, *_ = app.parse_args(words, print_error=False, exit_on_error=False)
        assert verb.__name__ == words[0]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_options_that_pages_mention_exist(page: Path) -> None:
    verbs = [app[name] for name in app if not name.startswith("-")]
    arguments = [argument for verb in verbs for argument in verb.assemble_argument_collection()]
    known = {name for argument in arguments for name in argument.names}
    known |= {"--help", "--version", "--debug"} | OTHERS
    lines = [x for x in page.read_text(encoding="utf-8").splitlines() if "benchmarks/" not in x]
    named = set(re.findall(r"(?<![-\w|])--[a-z][a-z-]*", "\n".join(lines)))
    assert not named - known, f"{page.name} names options that excitant does not have"


def test_site_and_readme_lead_to_every_page() -> None:
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [str(p.relative_to(ROOT / "docs")) for p in PAGES if p != README]
    assert [p for p in pages if p not in nav] == []
    how_to = [p for p in pages if p.startswith("how-to/") or p == "tutorial.md"]
    assert [p for p in how_to if p not in TEXT] == []
