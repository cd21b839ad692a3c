"""Work in a child process: its result, its refusals, and what it may not do."""

import importlib
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import pytest
from marks import refused

from excitant.files import read_bytes
from excitant.limited import Exceeded, in_child

WORK = """
def answers(a, b): return f"{a} {b}".encode()
def refuses(): raise KeyError("no\\nsuch thing")
def loops():
    while True: pass
def grows(): return bytes(1 << 31)
def writes(file): open(file, "w").write("x" * 9999)
def reads(file): return open(file, "rb").read()
def crashes():
    yield b"first part"
    __import__("os").abort()
"""


@pytest.fixture
def work(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., str]:
    """``work(name, ...)``: what a function comes to with a second and half a GB."""
    (tmp_path / "strange_work.py").write_text(WORK)
    monkeypatch.syspath_prepend(tmp_path)
    module = importlib.import_module("strange_work")
    limits = {"seconds": 1, "memory": 1 << 29}
    call = partial(in_child, **limits)
    return lambda name, *given, **more: call(getattr(module, name), *given, **more).decode()


def test_a_child_answers_or_says_why_not_and_leaves_what_it_had_finished(work: Callable[..., str]):
    assert work("answers", 1, "b") == "1 b"
    with pytest.raises(ValueError, match=r"no.*such thing") as refused:
        work("refuses")
    assert not isinstance(refused.value, Exceeded)
    with pytest.raises(Exceeded, match="crash") as ended:
        work("crashes")
    assert ended.value.output == b"first part"


@pytest.mark.parametrize("name", ["loops", "grows"])
def test_a_child_ends_at_its_limits(work: Callable[..., str], name: str) -> None:
    start = sum(os.times()[:4])
    refused("too much time or memory", work, name, error=Exceeded)
    assert sum(os.times()[:4]) - start < 5


def test_a_child_writes_no_files_and_opens_as_many_as_it_may(work, tmp_path):
    refused(r"File too large|too much", work, "writes", str(tmp_path / "file"), error=ValueError)
    assert not (tmp_path / "file").exists() or not (tmp_path / "file").stat().st_size
    (file := tmp_path / "file").write_text("x")
    assert work("reads", str(file), files=1) == work("reads", str(file)) == "x"
    refused("Too many open files", work, "reads", str(file), files=0, error=ValueError)


def test_a_pipe_is_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    refused("pipe", read_bytes, tmp_path / "pipe", error=OSError)
