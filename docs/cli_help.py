"""Hook of the site: the command line's own help, in the place of a mark on its page."""

from __future__ import annotations

import argparse
import os
from typing import Any

MARK = "<!-- help of every command -->"


def on_page_markdown(markdown: str, **_: Any) -> str:
    """The page with the help of every command where the mark is."""
    return markdown.replace(MARK, cli_help()) if MARK in markdown else markdown


def cli_help() -> str:
    """Help of every command as Markdown, a section each."""
    from excitant.cli import parser

    os.environ["COLUMNS"] = "96"  # so that it is the same in every terminal
    top = parser()
    [verbs] = [a for a in top._actions if isinstance(a, argparse._SubParsersAction)]
    pages = {"excitant": top, **{f"excitant {name}": verb for name, verb in verbs.choices.items()}}
    return "\n".join(
        f"## {name}\n\n```text\n{page.format_help()}```\n" for name, page in pages.items()
    )
