"""What pyproject.toml cannot say: the README as package indexes show it, away from its files."""

import re
import tomllib
from pathlib import Path

from setuptools import setup

HERE = Path(__file__).parent
HOME = tomllib.loads((HERE / "pyproject.toml").read_text("utf-8"))["project"]["urls"]["Source"]


def away(readme: str) -> str:
    """A README whose links to files lead to the repository."""
    link = re.compile(r"(!?)(\[[^]]*\]\()(?!https?:|#)")
    return link.sub(lambda m: f"{m[1]}{m[2]}{HOME}/{'raw' if m[1] else 'blob'}/HEAD/", readme)


setup(
    long_description=away((HERE / "README.md").read_text("utf-8")),
    long_description_content_type="text/markdown",
)
