"""The thesis' tables and the values to reproduce, as fixtures; both skip where ../shared is absent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera.observations import Observations

SIZE = (768, 576)


@pytest.fixture(scope="session")
def size() -> tuple[int, int]:
    """Return the picture size of chapters 2 and 3."""
    return SIZE


@pytest.fixture(scope="session")
def table(shared: Callable[[str], Path]) -> Callable[[str], Array]:
    """Return a function giving the numeric rows of a table, by its file's name without table_ and .csv."""

    def rows(name: str) -> Array:
        lines = shared(f"thesis/tables/table_{name}.csv").read_text().splitlines()
        return np.array(
            [[float(x) for x in line.split(",")] for line in lines if line[:1].isdigit() or line[:1] == "-"]
        )

    return rows


@pytest.fixture(scope="session")
def points(table: Callable[[str], Array]) -> Callable[..., Observations]:
    """Return a function giving a table's points as observations; `camera` counts the (U, V) pairs from 1."""

    def observations(name: str, camera: int = 1) -> Observations:
        rows = table(name)
        column = 3 + 2 * (camera - 1)
        return Observations.from_uv(rows[:, :3], rows[:, column : column + 2], source=f"Table {name.replace('_', '.')}")

    return observations
