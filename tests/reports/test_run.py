"""A run is saved whole or not at all, and reads back as it was."""

import io
import itertools
import os
import pickle
import re
import shutil
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from unittest import mock
from urllib.parse import unquote

import numpy as np
import pytest
from marks import refused, slow
from records import full

from excitant import files
from excitant.cli import main
from excitant.exceptions import BadInput
from excitant.reports import html, load_run, page_of, save_run, summary
from excitant.reports.run import as_saved
from excitant.results import record_of

CHECK = full(verb="check")
IDENTIFY = full(verb="identify")
OUTSIDE_OR_OURS = ("../up.txt", "/abs.txt", "", ".", "a/../../b", "result.json")
OWN = ["report.html", "result.json", "series.npz", "summary.txt"]


def contents(folder):
    found = (path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def names(folder):
    return sorted(Path(path).name for path in contents(folder))


def test_saved_run_is_what_was_given_and_renders_to_the_same_page(run, tmp_path):
    given, arrays = run
    paths, page = save_run(tmp_path / "run", given, arrays)
    result, series = load_run(tmp_path / "run")
    assert sorted(path.name for path in paths) == OWN == names(tmp_path / "run")
    assert result == record_of(given)
    assert series.keys() == arrays.keys()
    for key, values in arrays.items():
        span = np.ptp(values[np.isfinite(values)])
        np.testing.assert_allclose(series[key], values, rtol=0, atol=1e-6 * span)
    # of the files that the result names, none is there
    assert sorted(["report.html", *page.files]) == OWN
    result.files = list(page.files)
    again = page_of(result, series)
    assert html(again) == html(page)
    passed_on = pickle.loads(pickle.dumps(page))  # as from the process that draws it
    assert (tmp_path / "run/report.html").read_text("utf-8") == html(passed_on)
    assert (tmp_path / "run/summary.txt").read_text("utf-8") == summary(page)


def test_values_become_plain_json_and_time_since_the_epoch_keeps_its_resolution(tmp_path):
    odd = {"b": np.float64("nan"), "a": np.inf, "n": np.int64(3), "yes": np.bool_(True)}
    odd |= {"list": np.array([1.0, np.nan]), "tuple": (1, Path("a/b"))}
    plain = {"b": None, "a": None, "n": 3, "yes": True, "list": [1.0, None], "tuple": [1, "a/b"]}
    assert as_saved(odd, {})[0] == plain
    t = 1.7e9 + np.arange(5000) * 1e-3
    save_run(tmp_path, IDENTIFY, {"t": t})
    np.testing.assert_array_equal(load_run(tmp_path)[1]["t"], t)


def test_links_lead_to_artefacts_beside_the_page_also_when_the_run_was_moved(tmp_path):
    files = {"model.yaml": "é: 1\n", "a b/link #1.stl": b"\x00\xff", "gone.csv": "x"}
    run, moved = tmp_path / "run", tmp_path / "moved"
    paths, _ = save_run(run, IDENTIFY | {"files": [str(run / name) for name in files]}, {}, files)
    assert names(run) == sorted([*OWN, "model.yaml", "link #1.stl", "gone.csv"])
    assert all(path.is_file() for path in paths)
    assert (run / "model.yaml").read_text("utf-8") == files["model.yaml"]
    assert (run / "a b/link #1.stl").read_bytes() == files["a b/link #1.stl"]
    (run / "gone.csv").unlink()
    os.rename(run, moved)
    save_run(moved, *load_run(moved))
    hrefs = re.findall('<a href="([^#"]+)"', (moved / "report.html").read_text("utf-8"))
    linked = {unquote(href) for href in hrefs}
    assert linked == {"model.yaml", "a b/link #1.stl", *OWN} - {"report.html"}
    assert all((moved / name).is_file() for name in linked)


def test_failed_rendering_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.delattr("excitant.reports.run.page_of")
    with pytest.raises(NameError):
        save_run(tmp_path / "new/run", CHECK, {})
    assert list(tmp_path.iterdir()) == []


FULL = OSError(28, "No space left on device")
STEPS = ["os.fsync", "os.mkdir", "os.rename", "shutil.copytree", "files._exchange"]


@pytest.fixture(params=STEPS)
def failing(request, monkeypatch):
    """``failing(k, error)``: the k-th step of this kind, from 1, fails."""
    module, name = request.param.split(".")
    owner = {"os": os, "shutil": shutil, "files": files}[module]
    real, steps = getattr(owner, name), itertools.count(1)

    def fail(count, error):
        def step(*given, **options):
            if next(steps) == count:
                raise error
            return real(*given, **options)

        monkeypatch.setattr(owner, name, step)

    return fail


@pytest.mark.parametrize("count", range(1, 7))
@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt(), slow(RuntimeError())])
@pytest.mark.parametrize("old", [True, False])
def test_a_step_that_fails_leaves_all_as_it_was(failing, count, error, old, tmp_path):
    target = tmp_path / "new" / "run"
    if old:
        save_run(target, IDENTIFY | {"files": ["new/run/a"]}, {}, {"a": "x"})
    before = contents(tmp_path)
    failing(count, error)
    raised = None
    try:
        save_run(target, CHECK, {"t": np.arange(5)}, {"b/c.txt": "y"})
    except (BadInput, KeyboardInterrupt, RuntimeError) as stopped:
        raised = stopped
    if raised is not None:
        assert isinstance(raised, BadInput if error is FULL else type(error))
        assert "\n" not in str(raised)
        assert contents(tmp_path) == before
    else:  # fewer steps of this kind are taken
        assert names(target) == sorted([*OWN, "c.txt"])
        assert list((tmp_path / "new").iterdir()) == [target]
    assert old or before or not list(tmp_path.rglob(".excitant*"))


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="limits the size of files")
def test_a_file_larger_than_the_system_allows_is_named_and_nothing_stays(tmp_path):
    import resource

    files.write_folder(tmp_path / "run", {"small": "old"})
    new = {"small": "x", "large": "x" * 2_000_000}
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        for folder in ("run", "new"):
            with pytest.raises(BadInput, match=rf"{folder}/large: cannot be written: File too la"):
                files.write_folder(tmp_path / folder, new)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert contents(tmp_path) == {"run/small": b"old"}


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", mock.Mock(side_effect=FULL))
    for write, *given in ((save_run, CHECK, {}), (files.write_file, "x")):
        with pytest.raises(BadInput, match=r"run.*cannot be written: No space left.*free some"):
            write(tmp_path / "run", *given)
    assert list(tmp_path.iterdir()) == []


def test_a_run_replaces_an_old_one_and_leaves_what_others_put_there(tmp_path):
    run = tmp_path / "run"
    save_run(run, IDENTIFY | {"files": ["run/a", "run/d/b"]}, {}, {"a": "1", "d/b": "2"})
    files.write_folder(run / "mine", {"notes.txt": "keep"})
    with pytest.raises(BadInput, match="mine: is a folder where a file"):
        files.write_folder(run, {"mine": "a file"})
    (run / "link").symlink_to("mine")
    save_run(run, CHECK | {"files": ["x/d/c"]}, {}, {"d/c": "3"})
    assert names(run) == sorted([*OWN, "c", "notes.txt"])
    assert (run / "link").is_symlink()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    again = contents(run).keys()
    save_run(run, *load_run(run))  # as `report` does, which has no artefacts at hand
    assert contents(run).keys() == again


def test_old_or_new_is_whole_at_every_instant(tmp_path):
    """Read all the while from another thread, which sees both."""
    run, seen, over = tmp_path / "run", set(), threading.Event()

    def look():
        while not over.is_set():
            with ExitStack() as stack:
                held = [os.open(run, os.O_RDONLY)]
                stack.callback(lambda held=held: [os.close(handle) for handle in held])
                # of the old folder, files may be missing while it is removed
                stack.enter_context(suppress(FileNotFoundError))
                held += [os.open(x, os.O_RDONLY, dir_fd=held[0]) for x in "ab"]
                seen.add(tuple(os.read(handle, 9) for handle in held[1:]))

    looking = threading.Thread(target=look)
    for k in range(60):
        files.write_folder(run, {"a": f"{k}", "b": f"{k}"})
        if k == 0:
            looking.start()
    over.set()
    looking.join()
    assert len(seen) > 1
    assert all(a == b for a, b in seen)


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path):
    script = (
        "import os, signal, sys; from excitant import files;"
        "files._write = lambda *_: os.kill(os.getpid(), signal.SIGKILL);"
        "files.write_folder(sys.argv[1], {'a': 'b'})"
    )
    assert subprocess.run([sys.executable, "-c", script, tmp_path / "run"]).returncode == -9
    [left] = tmp_path.iterdir()
    assert left.name.startswith(".excitant-")
    save_run(tmp_path / "other", CHECK, {})
    assert left.exists()  # that of another target may be at work
    save_run(tmp_path / "run", CHECK, {})
    assert sorted(path.name for path in tmp_path.iterdir()) == ["other", "run"]


def test_a_folder_deep_in_missing_ones_is_made(tmp_path):
    [path] = files.write_folder(tmp_path / ("a/" * 1500), {"x": "1"})
    path.unlink()
    os.removedirs(path.parent)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_waits_until_the_run_is_whole(number, tmp_path, monkeypatch):
    before, real = signal.signal(number, signal.default_int_handler), os.fsync
    monkeypatch.setattr(os, "fsync", lambda file: (signal.raise_signal(number), real(file)))
    try:
        refused("was written", save_run, tmp_path / "run", CHECK, {}, error=KeyboardInterrupt)
    finally:
        signal.signal(number, before)
    assert names(tmp_path) == OWN


@pytest.mark.parametrize("place", [".", "..", "file", "file/run", "shut/run", "x" * 256])
def test_a_folder_that_cannot_be_replaced_is_refused_before_the_work(place, tmp_path, monkeypatch):
    (tmp_path / "here" / "shut").mkdir(parents=True)
    (tmp_path / "here" / "file").write_text("x")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).endswith("shut"))
    with pytest.raises(BadInput, match=f"^{re.escape(str(Path(place)))}: .*choose another folder"):
        files.require_replaceable(place)
    assert main(["analyze", "planar_2r", "-o", place]) == 1


ODD = (b"NaN", b"-Infinity", b"1e400", b"9" * 5000, b"[" * 200 + b"]" * 200, b"[" * 99999)


def saved(save, **arrays):
    save(buffer := io.BytesIO(), **arrays)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("culprit", "content"),  # None: missing
    [
        *(("result.json", c) for c in (None, "cut", b"", b"\xff\xfe\x00", b"[1, 2]", b"{}")),
        *(("result.json", b'{"verb": "check", "x": %s}' % c) for c in ODD),
        *(("series.npz", c) for c in (None, "cut", b"", b"no archive")),
        ("series.npz", saved(np.savez, x=np.array([{}], dtype=object))),
        ("series.npz", saved(np.save, arr=np.zeros(3))),
        ("series.npz", "torn"),
    ],
)
def test_spoilt_run_is_refused_in_one_line(culprit, content, tmp_path):
    save_run(tmp_path, CHECK | {"robot": "arm" * 99}, {"t": np.arange(99.0)})
    file = tmp_path / culprit
    old = file.read_bytes()
    torn = bytes(b ^ 0xFF if 60 < k < 70 else b for k, b in enumerate(old))  # within packed data
    file.unlink()
    if content is not None:
        file.write_bytes({"cut": old[:200], "torn": torn}.get(content, content))
    refused(rf"^[^\n]*{culprit}[^\n]*\Z", load_run, tmp_path, error=BadInput)


@pytest.mark.parametrize(
    ("said", "given"),
    [
        (r"result\.joints\[1\]: a object", (CHECK | {"joints": ["a", object()]}, {})),
        ("series 'names'", (CHECK, {"names": np.array(["a"])})),
        ("Invalid value 'dance' - at `\\$.verb`", ({"verb": "dance"}, {})),
        *(("artefact", (CHECK, {}, {name: "x"})) for name in OUTSIDE_OR_OURS),
    ],
)
def test_what_cannot_be_saved_is_refused_by_its_name(said, given, tmp_path):
    refused(said, save_run, tmp_path / "r", *given, error=BadInput)
    assert list(tmp_path.iterdir()) == []
