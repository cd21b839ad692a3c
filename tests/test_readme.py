"""The README is true: its example runs as printed, and its commands and options exist."""

from __future__ import annotations

import argparse
import re
import shlex
from pathlib import Path

import pytest

from excitant.cli import parser

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
        assert parser().parse_args(shlex.split(command, comments=True)).verb in command


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_options_that_pages_mention_exist(page: Path) -> None:
    [verbs] = [a for a in parser()._actions if isinstance(a, argparse._SubParsersAction)]
    known = {word for verb in verbs.choices.values() for word in verb._option_string_actions}
    known |= set(parser()._option_string_actions) | OTHERS
    lines = [x for x in page.read_text(encoding="utf-8").splitlines() if "benchmarks/" not in x]
    named = set(re.findall(r"(?<![-\w|])--[a-z][a-z-]*", "\n".join(lines)))
    assert not named - known, f"{page.name} names options that excitant does not have"


def test_site_and_readme_lead_to_every_page() -> None:
    nav = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    pages = [str(p.relative_to(ROOT / "docs")) for p in PAGES if p != README]
    assert [p for p in pages if p not in nav] == []
    how_to = [p for p in pages if p.startswith("how-to/") or p == "tutorial.md"]
    assert [p for p in how_to if p not in TEXT] == []
