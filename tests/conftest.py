"""What every test may use: the shared data (skipping where it is absent) and a seeded generator."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

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


@pytest.fixture
def rng() -> np.random.Generator:
    """Return a generator with a fixed seed: a failing test fails again."""
    return np.random.default_rng(20261121)
