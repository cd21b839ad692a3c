"""Names of others: shown spelt out, and safe as the name of a folder."""

import json
from pathlib import Path
from typing import Any

import pytest

from excitant.exceptions import BadInput
from excitant.names import in_folder, one_line, printable

EVIL = ["\0", "\x1b[2J", "\x9b31m", "\u202etxt", "\u2066a", "\ud800", "\x7f", "\u200fb", "\r"]


@pytest.mark.parametrize("text", EVIL)
def test_what_a_terminal_would_obey_is_spelt_out(text: str) -> None:
    for shown in (printable(f"a{text}b"), str(BadInput(f"a{text}b"))):
        assert shown.isprintable()
        assert shown.startswith("a")
    assert json.loads(f'"{printable(text)}"') == text
    assert printable("wrist_ü 関節 – r²") == "wrist_ü 関節 – r²"


def test_a_name_without_end_is_cut() -> None:
    assert len(one_line(f"{'x' * 10**5} is long")) < 400


@pytest.mark.parametrize("name", ["../../etc", "/abs", "-rf", ".hid", "a\nb", "…", "", "关" * 500])
def test_a_folder_is_named_safely(name: str) -> None:
    safe = in_folder(name)
    assert Path(safe).name == safe
    assert safe[0] not in "-."
    assert ".." not in safe
    assert len(safe.encode()) < 200


def test_a_robot_of_odd_name_is_shown_and_saved(here: Path, excitant: Any) -> None:
    name, inertia = "../\u202egnp\x9b/x", {"xx": 0.01, "yy": 0.01, "zz": 0.01}
    link = {"m": 1.0, "a": 0.3, "com": [0.1, 0, 0], "Ic": inertia}
    text = json.dumps({"name": name, "convention": "standard", "dh": [link]})
    (here / "arm.yaml").write_text(text, encoding="utf-8")
    ran = excitant("analyze arm.yaml")
    assert (ran.status, ran.err) == (0, "")
    [folder] = (here / "runs").iterdir()
    shown = [ran.out, *((folder / f).read_text("utf-8") for f in ("report.html", "summary.txt"))]
    assert not any(c in page for page in shown for c in "\u202e\x9b")
    assert "\\u202egnp" in shown[1]
    assert excitant("analyze arm.yaml --json").result["robot"] == name
