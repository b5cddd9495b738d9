"""Layers as files of labels hold them, against the same said in NumPy."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import MissingCore
from cadcam.native import core
from cadcam.native.layers import depth_steps, mask_changes, mask_region, normal_bytes

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIZES = [(1, 1), (1, 9), (9, 1), (23, 37), (64, 64)]


@pytest.mark.parametrize("size", SIZES, ids=str)
def test_depth_is_rounded_to_steps_and_normals_to_bytes_where_there_is_something(
    rng: np.random.Generator, size: tuple[int, int]
) -> None:
    """A step and a half of a byte: each is what it stands for to within half a step."""
    depth = np.where(rng.uniform(size=size) < 0.5, np.inf, rng.uniform(1, 900, size)).astype(np.float32)
    normal = rng.standard_normal((*size, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    there = np.isfinite(depth)
    steps, coded = depth_steps(depth, 0.05).astype(float), normal_bytes(depth, normal).astype(float)
    assert np.abs(steps[there] * 0.05 - depth[there]).max(initial=0) <= 0.025 * (1 + 1e-3)
    assert np.abs(coded[there] / 255 * 2 - 1 - normal[there]).max(initial=0) <= 1 / 255 + 1e-6
    assert not steps[~there].any()
    assert not coded[~there].any()


def test_depth_beyond_what_16_bits_hold_is_the_most_they_hold() -> None:
    depth = np.array([[65535.4, 65536, 1e30, 0.4, 0.6]], np.float32)
    assert depth_steps(depth, 1.0).tolist() == [[65535, 65535, 65535, 0, 1]]


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
