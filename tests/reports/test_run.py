"""A run is saved whole or not at all, and reads back as it was."""

import io
import itertools
import os
from pathlib import Path

import numpy as np
import pytest

from excitant.exceptions import BadInput
from excitant.reports import html, load_run, page_of, save_run, summary

OWN = ["report.html", "result.json", "series.npz", "summary.txt"]


def names(folder):
    return sorted(path.name for path in folder.rglob("*") if path.is_file())


def test_saved_run_is_what_was_given_and_renders_to_the_same_page(run, tmp_path, undrawn):
    given, arrays = run
    paths, _ = save_run(tmp_path / "run", given, arrays)
    result, series = load_run(tmp_path / "run")
    assert sorted(path.name for path in paths) == OWN == names(tmp_path / "run")
    assert list(result) == list(given)
    assert result == given
    assert series.keys() == arrays.keys()
    for key, values in arrays.items():
        span = np.ptp(values[np.isfinite(values)])
        np.testing.assert_allclose(series[key], values, rtol=0, atol=1e-6 * span)
    page = page_of(result, series)
    assert (tmp_path / "run/report.html").read_text("utf-8") == html(page)
    assert (tmp_path / "run/summary.txt").read_text("utf-8") == summary(page)


def test_values_become_plain_json(tmp_path):
    odd = {"verb": "design", "b": np.float64("nan"), "a": np.inf, "n": np.int64(3)}
    odd |= {"yes": np.bool_(True), "list": np.array([1.0, np.nan]), "tuple": (1, Path("a/b"))}
    save_run(tmp_path, odd, {})
    text = (tmp_path / "result.json").read_text("utf-8")
    assert " ".join(text.split()) == (
        '{ "verb": "design", "b": null, "a": null, "n": 3, "yes": true, '
        '"list": [ 1.0, null ], "tuple": [ 1, "a/b" ] }'
    )


def test_time_since_the_epoch_keeps_its_resolution(tmp_path):
    t = 1.7e9 + np.arange(5000) * 1e-3
    save_run(tmp_path, {"verb": "identify"}, {"t": t})
    np.testing.assert_array_equal(load_run(tmp_path)[1]["t"], t)


def test_artefacts_stand_beside_the_report(tmp_path):
    files = {"model.yaml": "é: 1\n", "meshes/link.stl": b"\x00\xff"}
    paths, _ = save_run(tmp_path / "run", {"verb": "identify"}, {}, files)
    assert names(tmp_path / "run") == sorted([*OWN, "model.yaml", "link.stl"])
    assert all(path.is_file() for path in paths)
    assert (tmp_path / "run/model.yaml").read_text("utf-8") == files["model.yaml"]
    assert (tmp_path / "run/meshes/link.stl").read_bytes() == files["meshes/link.stl"]


@pytest.mark.parametrize("name", ["../up.txt", "/abs.txt", "", ".", "a/../../b", "result.json"])
def test_artefacts_stay_inside_and_overwrite_nothing_of_ours(name, tmp_path):
    with pytest.raises(BadInput, match="artefact"):
        save_run(tmp_path / "run", {"verb": "check"}, {}, {name: "x"})
    assert list(tmp_path.iterdir()) == []


def test_failed_rendering_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.delattr("excitant.reports.run.page_of")
    with pytest.raises(NameError):
        save_run(tmp_path / "new/run", {"verb": "check"}, {})
    assert list(tmp_path.iterdir()) == []


def fail_at(monkeypatch, count, error):
    real, moves = os.replace, itertools.count(1)

    def replace(*names):
        if next(moves) == count:
            raise error
        real(*names)

    monkeypatch.setattr(os, "replace", replace)


FULL = OSError(28, "No space left on device")


@pytest.mark.parametrize("failing", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("error", [FULL, KeyboardInterrupt()])
def test_failed_move_leaves_no_new_folder(failing, error, tmp_path, monkeypatch):
    fail_at(monkeypatch, failing, error)
    with pytest.raises(BadInput if error is FULL else KeyboardInterrupt) as caught:
        save_run(tmp_path / "new/run", {"verb": "check"}, {}, {"a/b.txt": "x"})
    assert list(tmp_path.iterdir()) == []
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("failing", [1, 2, 3, 4])
def test_failed_move_leaves_only_whole_files_of_an_old_run(failing, tmp_path, monkeypatch):
    def contents(folder):
        return {path.name: path.read_bytes() for path in folder.iterdir()}

    for folder, verb in (("run", "identify"), ("other", "check")):
        save_run(tmp_path / folder, {"verb": verb}, {"t": np.arange(len(verb))})
    old, new = contents(tmp_path / "run"), contents(tmp_path / "other")
    fail_at(monkeypatch, failing, FULL)
    with pytest.raises(BadInput, match="No space left"):
        save_run(tmp_path / "run", {"verb": "check"}, {"t": np.arange(5)})
    found = contents(tmp_path / "run")
    assert sorted(found) == OWN
    assert all(found[name] in (old[name], new[name]) for name in OWN)
    assert found["result.json"] == old["result.json"]


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
def test_spoilt_run_is_refused_in_one_line(culprit, content, tmp_path):
    save_run(tmp_path, {"verb": "check", "robot": "arm" * 99}, {"t": np.arange(99.0)})
    old = (tmp_path / culprit).read_bytes()
    (tmp_path / culprit).write_bytes(old[:200] if content == "cut" else content or b"")
    if content is None:
        (tmp_path / culprit).unlink()
    with pytest.raises(BadInput) as caught:
        load_run(tmp_path)
    assert culprit in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("result", "series", "said"),
    [
        ({"verb": "check", "joints": ["a", object()]}, {}, r"result\.joints\[1\]: a object"),
        ({"verb": "check"}, {"names": np.array(["a"])}, "series 'names'"),
        ({"verb": "dance"}, {}, "verb 'dance' has no report"),
    ],
)
def test_what_cannot_be_saved_is_refused_by_its_name(result, series, said, tmp_path):
    with pytest.raises(BadInput, match=said):
        save_run(tmp_path / "r", result, series)
    assert list(tmp_path.iterdir()) == []
