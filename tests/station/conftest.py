"""The dissertation's numbers on stations, and a small hall that is calibrated once for all tests."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.station.hall import make_hall
from cadcam.station.simulate import calibrate_robot


@pytest.fixture(scope="session")
def table(shared: Callable[[str], Path]) -> Callable[[str], list[dict[str, str]]]:
    """Return a function giving the rows of one of the dissertation's tables."""

    def rows(name: str) -> list[dict[str, str]]:
        text = shared(f"thesis/tables/{name}.csv").read_text().splitlines()
        return list(csv.DictReader(line for line in text if not line.startswith("#")))

    return rows


@pytest.fixture(scope="session")
def table_6_11(table):
    """Return the 15 positions (n, 2) m of Table 6.11, and the deviation d[i, j] (n, n, 2) mm between each two."""
    rows = table("table_6_11")
    places = sorted({(float(r["xi"]), float(r["yi"])) for r in rows})
    d = np.zeros((len(places), len(places), 2))
    for r in rows:
        i, j = places.index((float(r["xi"]), float(r["yi"]))), places.index((float(r["xj"]), float(r["yj"])))
        d[i, j] = float(r["dx"]), float(r["dy"])
    return np.array(places), d


@pytest.fixture(scope="session")
def hall():
    """Return a hall with two robots."""
    return make_hall(np.random.default_rng(4), robots=("6", "12"))


@pytest.fixture(scope="session")
def calibrated(hall):
    """Return both robots' calibrations beside their truth."""
    rng = np.random.default_rng(5)
    return {name: calibrate_robot(hall, name, rng) for name in hall.gantries}


@pytest.fixture(scope="session")
def stations(calibrated):
    """Return both calibrations by camera."""
    return {name: one.station for name, one in calibrated.items()}
