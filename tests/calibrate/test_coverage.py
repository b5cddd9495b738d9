"""The 95 % intervals hold the truth as often as they say: benchmarks/coverage.py in small, and once in full.

Counts are binomial. The quantities of one calibration go together, so their mean share has about the error of a single
one: 4.5 standard errors for it, and for each quantity by itself.
"""

from __future__ import annotations

import sys
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import pytest

PATH = Path(__file__).resolve().parents[2] / "benchmarks" / "coverage.py"


def load():
    spec = spec_from_file_location("coverage_benchmark", PATH)
    module = module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


study = load()
SCENES = list(study.scenes())


def shares(scene, calibrations, seed):
    result = study.coverage(study.scenes()[scene], calibrations, np.random.default_rng(seed))
    counts = np.array([[c.stated, c.residuals] for c in result.counts.values()]) / calibrations
    return list(result.counts), counts


@pytest.mark.parametrize(
    ("scene", "calibrations"), [pytest.param(SCENES[0], 10, marks=pytest.mark.slow), (SCENES[3], 30)]
)
def test_the_intervals_of_a_few_calibrations_hold_the_truth(scene, calibrations):
    names, counts = shares(scene, calibrations, 31)
    error = np.sqrt(0.95 * 0.05 / calibrations)
    assert len(names) >= 6 + 10
    assert np.all(np.abs(counts.mean(axis=0) - 0.95) < 4.5 * error)


def test_intervals_half_as_wide_are_found_out(monkeypatch):
    """The negative control: 67 % would be held."""
    monkeypatch.setattr(study, "LEVEL", 0.67)
    _, counts = shares(SCENES[3], 30, 31)
    assert np.all(counts.mean(axis=0) < 0.95 - 4.5 * np.sqrt(0.95 * 0.05 / 30))


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_the_intervals_of_500_calibrations_hold_the_truth(scene):
    """Of each quantity within 4 standard errors, of all on average between 93 and 97 %."""
    names, counts = shares(scene, 500, 32)
    error = np.sqrt(0.95 * 0.05 / 500)
    worst = names[int(np.argmax(np.abs(counts - 0.95).max(axis=1)))]
    assert np.abs(counts - 0.95).max() < 4 * error, worst
    assert np.all(np.abs(counts.mean(axis=0) - 0.95) < 0.02)
