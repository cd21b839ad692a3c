"""A run is saved whole or not at all, and reads back as it was."""

import importlib
import io
import itertools
import os
import pickle
import re
import signal
import subprocess
import sys
import threading
from contextlib import ExitStack, suppress
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from records import full

from excitant import files
from excitant.cli import main
from excitant.exceptions import BadInput
from excitant.reports import html, load_run, page_of, save_run, summary
from excitant.reports.run import as_saved
from excitant.results import record_of

CHECK = full(verb="check")
IDENTIFY = full(verb="identify")
OWN = ["report.html", "result.json", "series.npz", "summary.txt"]


def names(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


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
    assert (
        sorted(["report.html", *page.files]) == OWN
    )  # of those that the result names, none is there
    result.files = list(page.files)
    again = page_of(result, series)
    assert html(again) == html(page)
    passed_on = pickle.loads(pickle.dumps(page))  # as from the process that draws it
    assert (tmp_path / "run/report.html").read_text("utf-8") == html(passed_on)
    assert (tmp_path / "run/summary.txt").read_text("utf-8") == summary(page)


def test_values_become_plain_json():
    odd = {"b": np.float64("nan"), "a": np.inf, "n": np.int64(3), "yes": np.bool_(True)}
    odd |= {"list": np.array([1.0, np.nan]), "tuple": (1, Path("a/b"))}
    plain = {"b": None, "a": None, "n": 3, "yes": True, "list": [1.0, None], "tuple": [1, "a/b"]}
    assert as_saved(odd, {})[0] == plain


def test_time_since_the_epoch_keeps_its_resolution(tmp_path):
    t = 1.7e9 + np.arange(5000) * 1e-3
    save_run(tmp_path, IDENTIFY, {"t": t})
    np.testing.assert_array_equal(load_run(tmp_path)[1]["t"], t)


def test_artefacts_stand_beside_the_report(tmp_path):
    files = {"model.yaml": "é: 1\n", "meshes/link.stl": b"\x00\xff"}
    paths, _ = save_run(tmp_path / "run", IDENTIFY, {}, files)
    assert names(tmp_path / "run") == sorted([*OWN, "model.yaml", "link.stl"])
    assert all(path.is_file() for path in paths)
    assert (tmp_path / "run/model.yaml").read_text("utf-8") == files["model.yaml"]
    assert (tmp_path / "run/meshes/link.stl").read_bytes() == files["meshes/link.stl"]


def test_links_lead_to_the_files_beside_the_page_also_when_the_run_was_moved(tmp_path):
    files = {"model.yaml": "é: 1\n", "a b/link #1.stl": b"\x00\xff", "gone.csv": "x"}
    paths = [str(tmp_path / "run" / name) for name in files]
    save_run(tmp_path / "run", IDENTIFY | {"files": paths}, {}, files)
    (tmp_path / "run" / "gone.csv").unlink()
    moved = tmp_path / "moved"
    os.rename(tmp_path / "run", moved)
    save_run(moved, *load_run(moved))
    hrefs = re.findall('<a href="([^#"]+)"', (moved / "report.html").read_text("utf-8"))
    linked = {unquote(href) for href in hrefs}
    assert linked == {"model.yaml", "a b/link #1.stl", *OWN} - {"report.html"}
    assert all((moved / name).is_file() for name in linked)


@pytest.mark.parametrize("name", ["../up.txt", "/abs.txt", "", ".", "a/../../b", "result.json"])
def test_artefacts_stay_inside_and_overwrite_nothing_of_ours(name, tmp_path):
    with pytest.raises(BadInput, match="artefact"):
        save_run(tmp_path / "run", CHECK, {}, {name: "x"})
    assert list(tmp_path.iterdir()) == []


def test_failed_rendering_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.delattr("excitant.reports.run.page_of")
    with pytest.raises(NameError):
        save_run(tmp_path / "new/run", CHECK, {})
    assert list(tmp_path.iterdir()) == []


def contents(folder):
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


FULL = OSError(28, "No space left on device")
STEPS = ["os.fsync", "os.mkdir", "os.rename", "shutil.copytree", "files._exchange"]


@pytest.fixture(params=STEPS)
def failing(request, monkeypatch):
    """``failing(k, error)``: the k-th step of this kind, from 1, fails."""
    name = request.param.removeprefix("files.")
    owner = files if "files" in request.param else importlib.import_module(name.partition(".")[0])
    name = name.rpartition(".")[2]
    real, steps = getattr(owner, name), itertools.count(1)

    def fail(count, error):
        def step(*given, **options):
            if next(steps) == count:
                raise error
            return real(*given, **options)

        monkeypatch.setattr(owner, name, step)

    return fail


@pytest.mark.parametrize("count", range(1, 7))
@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt(), RuntimeError()])
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

    contents, before = {"small": "x", "large": "x" * 2_000_000}, {"small": "old"}
    files.write_folder(tmp_path / "run", before)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_000_000, hard))
    try:
        for folder in ("run", "new"):
            with pytest.raises(BadInput, match=rf"{folder}/large: cannot be written: File too la"):
                files.write_folder(tmp_path / folder, contents)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    assert {path.name: path.read_text() for path in (tmp_path / "run").iterdir()} == before


def test_a_full_disk_names_the_file(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "fsync", lambda handle: (_ for _ in ()).throw(FULL))
    for write in (
        lambda path: save_run(path, CHECK, {}),
        lambda path: files.write_file(path, "x"),
    ):
        with pytest.raises(BadInput, match=r"run.*cannot be written: No space left.*free some"):
            write(tmp_path / "run")
    assert list(tmp_path.iterdir()) == []


def test_a_run_replaces_an_old_one_and_leaves_what_others_put_there(tmp_path):
    run = tmp_path / "run"
    save_run(run, IDENTIFY | {"files": ["run/a", "run/d/b"]}, {}, {"a": "1", "d/b": "2"})
    (run / "mine").mkdir()
    (run / "mine" / "notes.txt").write_text("keep")
    (run / "link").symlink_to("mine")
    save_run(run, CHECK | {"files": ["x/d/c"]}, {}, {"d/c": "3"})
    assert names(run) == sorted([*OWN, "c", "notes.txt"])
    assert (run / "link").is_symlink()
    assert [path.name for path in tmp_path.iterdir()] == ["run"]
    again = contents(run)
    save_run(run, *load_run(run))  # as `report` does, which has no artefacts at hand
    assert contents(run).keys() == again.keys()


def test_old_or_new_is_whole_at_every_instant(tmp_path):
    """Read all the while from another thread, which sees both."""
    run, seen, wrong, over = tmp_path / "run", set(), [], threading.Event()

    def write(k):
        files.write_folder(run, {"a": f"{k}", "b": f"{k}"})

    def look():
        while not over.is_set():
            with ExitStack() as stack:
                held = [os.open(run, os.O_RDONLY)]
                stack.callback(lambda held=held: [os.close(handle) for handle in held])
                # of the old folder, files may be missing while it is removed
                stack.enter_context(suppress(FileNotFoundError))
                held += [os.open(x, os.O_RDONLY, dir_fd=held[0]) for x in "ab"]
                found = [os.read(handle, 9) for handle in held[1:]]
                seen.add(found[0])
                wrong.extend([found] * (found[0] != found[1]))

    write(0)
    looking = threading.Thread(target=look)
    looking.start()
    for k in range(1, 60):
        write(k)
    over.set()
    looking.join()
    assert len(seen) > 1
    assert not wrong


def test_what_a_killed_run_left_is_removed_by_the_next(tmp_path):
    script = (
        "import os, signal, sys; from pathlib import Path; from excitant import files;"
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_waits_until_the_run_is_whole(number, tmp_path, monkeypatch):
    before, real = signal.signal(number, signal.default_int_handler), os.fsync

    def fsync(handle):
        signal.raise_signal(number)
        real(handle)

    monkeypatch.setattr(os, "fsync", fsync)
    try:
        with pytest.raises(KeyboardInterrupt, match="was written"):
            save_run(tmp_path / "run", CHECK, {})
    finally:
        signal.signal(number, before)
    assert names(tmp_path) == OWN


@pytest.mark.parametrize("place", [".", "..", "file", "file/run", "shut/run"])
def test_a_folder_that_cannot_be_replaced_is_refused_before_the_work(place, tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    Path("file").write_text("x")
    Path("shut").mkdir()
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).endswith("shut"))
    with pytest.raises(BadInput, match="choose another folder") as caught:
        files.require_replaceable(place)
    assert str(caught.value).startswith(f"{Path(place)}: ")
    assert main(["analyze", "planar_2r", "-o", place]) == 1


ODD = (b"NaN", b"-Infinity", b"1e400", b"9" * 5000, b"[" * 200 + b"]" * 200, b"[" * 99999)


def saved(save, *args, **kwargs):
    buffer = io.BytesIO()
    save(buffer, *args, **kwargs)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("culprit", "content"),  # None: missing
    [
        *(("result.json", c) for c in (None, "cut", b"", b"\xff\xfe\x00", b"[1, 2]", b"{}")),
        *(("result.json", b'{"verb": "check", "x": %s}' % c) for c in ODD),
        *(("series.npz", c) for c in (None, "cut", b"", b"no archive")),
        ("series.npz", saved(np.savez, x=np.array([{}], dtype=object))),
        ("series.npz", saved(np.save, np.zeros(3))),
        ("series.npz", "torn"),
    ],
)
def test_spoilt_run_is_refused_in_one_line(culprit, content, tmp_path):
    save_run(tmp_path, CHECK | {"robot": "arm" * 99}, {"t": np.arange(99.0)})
    old = (tmp_path / culprit).read_bytes()
    torn = bytes(b ^ 0xFF if 60 < k < 70 else b for k, b in enumerate(old))  # within packed data
    spoilt = {"cut": old[:200], "torn": torn}.get(content, content or b"")
    (tmp_path / culprit).write_bytes(spoilt)
    if content is None:
        (tmp_path / culprit).unlink()
    with pytest.raises(BadInput) as caught:
        load_run(tmp_path)
    assert culprit in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("result", "series", "said"),
    [
        (CHECK | {"joints": ["a", object()]}, {}, r"result\.joints\[1\]: a object"),
        (CHECK, {"names": np.array(["a"])}, "series 'names'"),
        ({"verb": "dance"}, {}, "Invalid value 'dance' - at `\\$.verb`"),
    ],
)
def test_what_cannot_be_saved_is_refused_by_its_name(result, series, said, tmp_path):
    with pytest.raises(BadInput, match=said):
        save_run(tmp_path / "r", result, series)
    assert list(tmp_path.iterdir()) == []
