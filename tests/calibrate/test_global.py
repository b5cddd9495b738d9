"""The study of benchmarks/pose_global.py in small: on random scenes, no random start ends lower.

Of each fourth kind, among them flat, deep, wide and distorted ones; the slow tests take every kind.
"""

from __future__ import annotations

import importlib.util
import sys
from itertools import islice
from pathlib import Path

import pytest

PATH = Path(__file__).resolve().parents[2] / "benchmarks" / "pose_global.py"
EACH = [4, pytest.param(1, marks=pytest.mark.slow)]  # kinds of scenes


@pytest.fixture(scope="module")
def study():
    spec = importlib.util.spec_from_file_location("pose_global", PATH)
    module = importlib.util.module_from_spec(spec)
    sys.modules["pose_global"] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("each", EACH)
def test_no_random_start_finds_a_better_pose(study, each):
    for seed, kind in islice(enumerate(study.kinds()), 0, None, each):
        row = study.study(kind, 1, 40, study.solve_pose, study.random_pose_search, 100 + seed)
        assert row.lost == 0, row
        assert not row.refused, row


@pytest.mark.parametrize("each", EACH)
def test_no_random_start_finds_a_better_calibration(study, each):
    for seed, kind in islice(enumerate(study.calibration_kinds()), 0, None, each):
        if kind.noise_px > 1:
            continue  # where noise hides the perspective there may be no optimum at all: the study counts those
        row = study.study(kind, 1, 40, study.solve_calibration, study.random_calibration_search, 200 + seed)
        assert row.lost == 0, row


def test_a_search_with_one_start_would_be_caught(study, monkeypatch):
    """Negative control: with one evenly spread rotation and no three-point pose the same comparison finds losses."""
    import cadcam.calibrate.points.camera as points
    from cadcam.fit.global_search import Effort, minima

    poor = Effort(triples=0, keep=0, spread=1)
    monkeypatch.setattr(points, "minima", lambda model, internals, **_: minima(model, internals, effort=poor))
    lost = 0
    for seed, kind in enumerate(study.kinds()):
        if "flat" in kind.name:
            row = study.study(kind, 1, 40, study.solve_pose, study.random_pose_search, 100 + seed)
            lost += row.lost + row.refused.total()
    assert lost > 0
