"""Masks as files of labels hold them, against the same said in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import MissingCore
from cadcam.native import core
from cadcam.native.layers import mask_changes, mask_region

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIZES = [(1, 1), (1, 9), (9, 1), (23, 37), (64, 64)]


@pytest.mark.parametrize("size", SIZES, ids=str)
@pytest.mark.parametrize("share", [0, 0.02, 0.5, 1])
def test_masks_are_measured_as_numpy_measures_them(
    rng: np.random.Generator, size: tuple[int, int], share: float
) -> None:
    mask = rng.uniform(size=size) < share
    y, x = np.nonzero(mask)
    box = (x.min(), y.min(), x.max(), y.max()) if len(x) else (-1, -1, -1, -1)
    assert mask_region(mask) == (len(x), box)
    columns = mask.ravel(order="F").astype(int)
    assert mask_changes(mask).tolist() == np.flatnonzero(np.diff(columns, prepend=0)).tolist()
