"""Figures: the same data give the same file, kinds are checked, nothing of matplotlib's global state is touched."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from cadcam.calibrate.variability.projection_map import ProjectionMap
from cadcam.errors import UnknownName
from cadcam.report.figures import figure, write_figure
from cadcam.report.variability_plots import _round_levels, _two_digits, write_map

pytest.importorskip("matplotlib")
GRID = np.linspace(-0.5, 99.5, 12)
MAP = ProjectionMap(
    GRID, GRID, np.hypot(GRID[:, None] - 40, GRID) / 50, "at 1000 mm", np.array([[20.0, 30.0], [70, 60]])
)


def test_the_same_map_gives_the_same_svg(tmp_path: Path) -> None:
    for name in ("one.svg", "two.svg"):
        write_map(tmp_path / name, MAP)
    assert (tmp_path / "one.svg").read_bytes() == (tmp_path / "two.svg").read_bytes()


def test_a_map_that_is_mostly_unseen_or_flat_is_drawn_all_the_same(tmp_path: Path) -> None:
    sigma = np.full((12, 12), np.nan)
    sigma[4:9, 4:9] = 0.5
    write_map(tmp_path / "map.png", ProjectionMap(GRID, GRID, sigma, "on a plane", MAP.q))
    assert (tmp_path / "map.png").stat().st_size > 5000


def test_an_unknown_kind_is_refused(tmp_path: Path) -> None:
    with figure(1, 1) as drawn, pytest.raises(UnknownName, match="png"):
        write_figure(tmp_path / "map.gif", drawn)
    assert not list(tmp_path.iterdir())


def test_the_look_does_not_outlive_the_figure_and_no_window_system_is_loaded() -> None:
    code = (
        "import sys, matplotlib\n"
        "looks = lambda: [matplotlib.rcParams[k] for k in ('font.size', 'axes.linewidth', 'legend.frameon')]\n"
        "before = looks()\n"
        "from cadcam.report.figures import figure\n"
        "with figure(1, 1) as drawn: drawn.subplots()\n"
        "assert looks() == before\n"
        "assert 'matplotlib.pyplot' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-W", "error", "-c", code], check=True)


@pytest.mark.parametrize(("low", "high"), [(0.16, 2.9), (0.0011, 0.0019), (3.0, 3.0), (12.0, 480.0)])
def test_contours_lie_at_round_numbers_within_the_range(low: float, high: float) -> None:
    levels = _round_levels(low, high)
    assert len(levels) <= 9
    assert np.all((levels >= low * (1 - 1e-12)) & (levels <= high * (1 + 1e-12)))
    assert low == high or len(levels) >= 3


def test_correlations_are_written_short() -> None:
    assert [_two_digits(v) for v in (1.0, -1.0, 0.993, -0.05, -0.001, 0.0)] == ["1", "-1", ".99", "-.05", ".00", ".00"]
