"""Which parameters a calibration estimates: all but those that are held at given values."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from cadcam.camera.lens import Lens
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect_number


def estimated_names(
    fixed: Mapping[str, float], lens: Lens, free_lens: Sequence[str], *, of: Sequence[str], what: str
) -> tuple[str, ...]:
    """Return the names of the pinhole's parameters `of` that are not fixed, and of the free coefficients of the lens.

    what: what errors call the pinhole's parameters. Raises `UnknownName`, and `BadValue` for impossible values.
    """
    for name, value in fixed.items():
        if name not in of:
            raise UnknownName(f"{what} to fix", name, of)
        expect_number(value, f"fixed {name}")
        if not np.isfinite(value):
            raise BadValue(f"fixed {name}", value, "a finite number")
        if name in ("focal", "aspect") and value <= 0:
            raise BadValue(f"fixed {name}", value, "a positive number")
        if name in ("b", "skew") and abs(value) >= np.pi / 2:
            raise BadValue(f"fixed {name}", f"{np.degrees(value):g} deg", "an angle between -90 and 90 deg")
    for name in free_lens:
        if name not in lens.parameters:
            raise UnknownName(f"coefficient of the {lens.name} lens", name, lens.parameters)
    return (*(n for n in of if n not in fixed), *(n for n in lens.parameters if n in free_lens))
