"""What every test may use: the shared data (skipping where it is absent) and a seeded generator."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

if "PYTEST_XDIST_WORKER" in os.environ:  # a worker a core: threads of BLAS, read when numpy loads, would fight for them
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pytest

SHARED = Path(__file__).resolve().parents[2] / "shared"


@pytest.fixture(scope="session")
def shared() -> Callable[[str], Path]:
    """Return a function giving the path of a file in ../shared, or skipping the test with the reason."""

    def find(relative: str) -> Path:
        path = SHARED / relative
        if not path.exists():
            pytest.skip(f"../shared/{relative} is not here")
        return path

    return find


@pytest.fixture(scope="session")
def golden(shared: Callable[[str], Path]) -> Callable[[str], dict[str, Any]]:
    """Return a function giving one of the dissertation's values by its id: value, tolerance, what was printed."""
    entries = {entry["id"]: entry for entry in json.loads(shared("thesis/golden.json").read_text())["results"]}
    return lambda name: entries[name]


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator with a fixed seed: a failing test fails again."""
    return np.random.default_rng(20261121)
