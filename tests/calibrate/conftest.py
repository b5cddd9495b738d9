"""The thesis' tables and the values to reproduce, as fixtures; both skip where ../shared is absent."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera.extended_pinhole import ExtendedPinhole
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


@pytest.fixture(scope="session")
def table_2_24() -> list[ExtendedPinhole]:
    """Return Table 2.24's cameras as printed: one camera's internals, at both positions."""
    internals = [1.007, 805.3, np.radians(-0.15), 318.7, 328.4]
    externals = [[7.79, 416.39, -211.67, -10.895, -9.293, -2.681], [4.99, 205.20, -204.96, 8.08, -9.585, 0.495]]
    return [ExtendedPinhole.from_vector([*e[:3], *np.radians(e[3:]), *internals]) for e in externals]
