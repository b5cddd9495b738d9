"""Values of the dissertation that must come out again, each within its own tolerance (shared/thesis/golden.json)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def assert_golden(entry: dict[str, Any], value: npt.ArrayLike) -> None:
    """Fail unless a value is an entry's, within the entry's tolerance."""
    expected, tolerance = np.array(entry["value"], float), np.array(entry["tol"], float)
    assert np.all(np.abs(np.asarray(value) - expected) <= tolerance), f"{entry['id']}: {value}, golden {expected}"
