"""A run is saved whole or not at all, and reads back as it was."""

import io
import json
import os
from pathlib import Path

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.reports import html, load_run, page_of, save_run, summary
from excitant.reports.page import Page

OWN = ["report.html", "result.json", "series.npz", "summary.txt"]


def names(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


@pytest.mark.slow
def test_saved_run_renders_again_to_the_same_page(run, tmp_path):
    paths, _ = save_run(tmp_path / "run", *run)
    result, series = load_run(tmp_path / "run")
    assert sorted(path.name for path in paths) == OWN == names(tmp_path / "run")
    assert (tmp_path / "run/report.html").read_text("utf-8") == html(page_of(result, series))
    assert (tmp_path / "run/summary.txt").read_text("utf-8") == summary(page_of(result, series))


def test_saved_run_is_what_was_given(run, tmp_path, monkeypatch):
    monkeypatch.setattr("excitant.reports.run.page_of", lambda *_: Page("", "", (), ()))
    given, arrays = run
    save_run(tmp_path, given, arrays)
    result, series = load_run(tmp_path)
    assert list(result) == list(given)
    assert result == json.loads(json.dumps(given, default=list))
    assert series.keys() == arrays.keys()
    for key, values in arrays.items():
        span = np.ptp(values[np.isfinite(values)])
        np.testing.assert_allclose(series[key], values, rtol=0, atol=1e-6 * span)


def test_values_become_plain_json(tmp_path):
    odd = {
        "verb": "design",
        "b": np.float64("nan"),
        "a": float("inf"),
        "n": np.int64(3),
        "yes": np.bool_(True),
        "list": np.array([1.0, np.nan]),
        "tuple": (1, None),
        "path": Path("a/b"),
    }
    save_run(tmp_path, odd, {})
    text = (tmp_path / "result.json").read_text("utf-8")
    expected = {"b": None, "a": None, "n": 3, "yes": True, "list": [1.0, None], "tuple": [1, None]}
    assert json.loads(text) == {"verb": "design", **expected, "path": "a/b"}
    assert list(json.loads(text)) == list(odd)
    assert text.startswith('{\n "verb": "design",\n')


def test_time_since_the_epoch_keeps_its_resolution(tmp_path):
    t = 1.7e9 + np.arange(5000) * 1e-3
    save_run(tmp_path, {"verb": "identify"}, {"t": t})
    np.testing.assert_array_equal(load_run(tmp_path)[1]["t"], t)


def test_artefacts_stand_beside_the_report(make, tmp_path):
    files = {"model.yaml": "é: 1\n", "meshes/link.stl": b"\x00\xff"}
    paths, _ = save_run(tmp_path / "run", *make["identify"](), files)
    assert names(tmp_path / "run") == sorted([*OWN, "model.yaml", "link.stl"])
    assert all(path.is_file() for path in paths)
    assert (tmp_path / "run/model.yaml").read_bytes() == "é: 1\n".encode()
    assert (tmp_path / "run/meshes/link.stl").read_bytes() == b"\x00\xff"


@pytest.mark.parametrize("name", ["../up.txt", "/abs.txt", "", ".", "a/../../b", "result.json"])
def test_artefacts_stay_inside_and_overwrite_nothing_of_ours(name, tmp_path):
    with pytest.raises(BadInput, match="artefact"):
        save_run(tmp_path / "run", {"verb": "check"}, {}, {name: "x"})
    assert list(tmp_path.iterdir()) == []


def fail(*_args, **_kwargs):
    raise RuntimeError("rendering failed")


def test_failed_rendering_writes_nothing(make, tmp_path, monkeypatch):
    monkeypatch.setattr("excitant.reports.run.page_of", fail)
    with pytest.raises(RuntimeError, match="rendering failed"):
        save_run(tmp_path / "new/run", make["check"]()[0], {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("failing", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_failed_move_leaves_no_new_folder(failing, error, make, tmp_path, monkeypatch):
    _fail_at(monkeypatch, failing, error)
    expected = BadInput if isinstance(error, OSError) else KeyboardInterrupt
    with pytest.raises(expected) as caught:
        save_run(tmp_path / "new/run", make["check"]()[0], {}, {"a/b.txt": "x"})
    assert list(tmp_path.iterdir()) == []
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("failing", [1, 2, 3, 4])
def test_failed_move_leaves_only_whole_files_of_an_old_run(failing, make, tmp_path, monkeypatch):
    save_run(tmp_path, *make["analyze"]())
    old = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    save_run(tmp_path / "other", make["check"]()[0], {})
    new = {path.name: path.read_bytes() for path in (tmp_path / "other").iterdir()}
    _fail_at(monkeypatch, failing, OSError(28, "No space left on device"))
    with pytest.raises(BadInput, match="No space left"):
        save_run(tmp_path, make["check"]()[0], {})
    found = {path.name: path.read_bytes() for path in tmp_path.iterdir() if path.is_file()}
    assert sorted(found) == OWN
    assert all(found[name] in (old[name], new[name]) for name in OWN)
    assert found["result.json"] == old["result.json"]


def _fail_at(monkeypatch, count, error):
    calls = []
    real = os.replace

    def replace(*args):
        calls.append(args)
        if len(calls) == count:
            raise error
        real(*args)

    monkeypatch.setattr(os, "replace", replace)


def saved(save, *args, **kwargs):
    buffer = io.BytesIO()
    save(buffer, *args, **kwargs)
    return buffer.getvalue()


@pytest.mark.parametrize(
    ("culprit", "content"),  # None: missing, "cut": its first bytes
    [
        *(("result.json", c) for c in (None, "cut", b"", b"\xff\xfe\x00", b"[1, 2]", b"{}")),
        *(("series.npz", c) for c in (None, "cut", b"", b"no archive")),
        ("series.npz", saved(np.savez, x=np.array([{}], dtype=object))),
        ("series.npz", saved(np.save, np.zeros(3))),
    ],
)
def test_spoilt_run_is_refused_in_one_line(culprit, content, make, tmp_path):
    save_run(tmp_path, *make["analyze"]())
    if content is None:
        (tmp_path / culprit).unlink()
    else:
        old = (tmp_path / culprit).read_bytes()
        (tmp_path / culprit).write_bytes(old[:200] if content == "cut" else content)
    with pytest.raises(BadInput) as caught:
        load_run(tmp_path)
    assert culprit in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_folder_is_refused(tmp_path):
    with pytest.raises(BadInput, match="no such folder"):
        load_run(tmp_path / "absent")


def test_what_cannot_be_saved_is_refused_by_its_name(tmp_path):
    with pytest.raises(BadInput, match=r"result\.joints\[1\]: a object"):
        save_run(tmp_path / "r", {"verb": "check", "joints": ["a", object()]}, {})
    with pytest.raises(BadInput, match="series 'names'"):
        save_run(tmp_path / "r", {"verb": "check"}, {"names": np.array(["a"])})
    with pytest.raises(BadInput, match="verb 'dance' has no report"):
        save_run(tmp_path / "r", {"verb": "dance"}, {})
    assert list(tmp_path.iterdir()) == []
