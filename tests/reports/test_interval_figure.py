"""The band around a prediction, its table and the line on essential parameters."""

from __future__ import annotations

import numpy as np

from excitant.reports.drawing import axes
from excitant.reports.interval_figure import (
    MEANING,
    draw_band,
    essential_line,
    half_width,
    interval_table,
)
from excitant.reports.torque_figures import Curves, torque_figure

N = 400
CURVES = Curves("given", "model as given", "identified", "identified", "caption", band="half_width")


def series() -> dict[str, np.ndarray]:
    t = np.concatenate([np.linspace(0, 5, N // 2), np.linspace(0, 5, N // 2)])
    wave = np.sin(t)[:, None] * [1.0, 2.0]
    return {
        "t": t, "measured": wave, "given": 1.1 * wave, "identified": wave,
        "half_width": np.full((N, 2), 0.3),
    }  # fmt: skip


def test_the_band_holds_every_edge() -> None:
    (ax,) = axes(2.0)
    t = np.arange(1000) / 100
    centre, half = np.sin(7 * t), 0.1 + 0.05 * np.cos(3 * t)
    half[333] = 2.0
    draw_band(ax, t, [400], centre, half)
    corners = np.vstack([path.vertices for c in ax.collections for path in c.get_paths()])
    assert corners[:, 1].max() == (centre + half).max()
    assert corners[:, 1].min() == (centre - half).min()
    assert len(ax.collections) == 2  # broken where recordings were joined


def test_the_torque_figure_explains_its_band() -> None:
    figure = torque_figure(["a", "b"], series(), "N·m", CURVES)
    assert figure is not None
    assert MEANING in [key.label for key in figure.legend]
    assert MEANING in figure.panels[0].label
    old = {k: v for k, v in series().items() if k != "half_width"}
    plain = torque_figure(["a", "b"], old, "N·m", CURVES)
    assert plain is not None
    assert len(plain.legend) == len(figure.legend) - 1
    assert "#c3dcec" in figure.panels[0].svg
    assert "#c3dcec" not in plain.panels[0].svg


def test_a_half_width_of_other_rows_is_left_out() -> None:
    assert half_width(series(), "half_width", 0, N - 1) is None
    assert half_width(series(), "half_width", 2, N) is None
    assert half_width({}, "half_width", 0, N) is None


def test_table_and_line_need_their_figures() -> None:
    interval = {"half_width": 0.3, "half_width_parameters": 0.1, "coverage": 0.712}
    result = {
        "joints": [{"name": "a", "validate": {"interval95": interval}}],
        "essential": {"kept": ["m1"], "dropped": ["m2", "m3"], "nrmse_all": 0.05,
                      "nrmse_essential": 0.049},
    }  # fmt: skip
    table = interval_table(result, "N·m")
    assert table is not None
    assert [cell.text for cell in table.rows[0]] == ["a", "0.300", "0.100", "71\u00a0%"]
    line = essential_line(result)
    assert line is not None
    assert "1 of 3 base parameters" in line.sentences[0]
    assert interval_table({"joints": [{"name": "a", "validate": None}]}, "N·m") is None
    assert essential_line({}) is None
