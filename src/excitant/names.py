"""Names that others chose, of joints, columns and files, as they can be shown and used."""

import json
import re
from collections.abc import Sequence

_LONGEST = 300  # characters of a word that is shown whole
_FOLDER = 40  # characters of a name that becomes part of a folder's
_HIDDEN = re.compile(  # control characters, marks of the direction of writing, lone surrogates
    "[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb"
    "\U000e0000-\U000e007f\ud800-\udfff]"
)
_ENDLESS = re.compile(rf"\S{{{_LONGEST + 1},}}")


def printable(text: str) -> str:
    """Text with what a terminal or a page would obey rather than show spelt out."""
    return _HIDDEN.sub(lambda found: json.dumps(found[0])[1:-1], text)


def one_line(text: str) -> str:
    """Text as one line for a terminal, words of absurd length cut in the middle."""
    return shortened(printable(" ".join(text.split())))


def shortened(text: str) -> str:
    """Text with words of absurd length cut in the middle."""
    half = _LONGEST // 2
    return _ENDLESS.sub(lambda found: f"{found[0][:half]}…{found[0][-half:]}", text)


def listed(names: Sequence[str], most: int) -> str:
    """The first of some names, and how many more there are."""
    more = len(names) - most
    return ", ".join(names[:most]) + f" and {more} more" * (more > 0)


def in_folder(name: str) -> str:
    """A name as part of the name of a folder: letters, digits and ``_ - .``, bounded in length."""
    return re.sub(r"[^\w.-]+", "_", name)[:_FOLDER].strip("._-") or "unnamed"
