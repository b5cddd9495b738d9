"""A photo in which nothing can be found says why: empty, burnt out, dark, blurred; a good one says nothing."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from cadcam.arrays import Picture
from cadcam.image.faults import blur_px, faults_of


def scene(blur: float, noise: float = 0.01) -> Picture:
    """Return a checkered picture (320 x 240) with slanted edges, blurred and noisy."""
    y, x = np.mgrid[0:240, 0:320].astype(float)
    checks = (np.floor((x + 0.2 * y) / 40) + np.floor((y - 0.2 * x) / 40)) % 2
    gray = ndimage.gaussian_filter(0.2 + 0.5 * checks, blur)
    return np.clip(gray + np.random.default_rng(1).normal(scale=noise, size=gray.shape), 0, 1).astype(np.float32)


@pytest.mark.parametrize("noise", [0.002, 0.03])
def test_a_sharp_picture_has_no_faults(noise: float) -> None:
    assert faults_of(scene(0.8, noise)) == []


@pytest.mark.parametrize("blur", [1.0, 2.0, 4.0, 6.0])
def test_the_blur_is_told_to_a_third(blur: float) -> None:
    """It is a quantile over places, and the 3 px mean before it adds its own 0.8 px: a judgement, not a measurement."""
    expected = np.hypot(blur, np.sqrt(8 / 12))
    assert blur_px(scene(blur, 0.005)) == pytest.approx(expected, rel=1 / 3)


@pytest.mark.parametrize(
    ("picture", "says"),
    [
        (np.full((240, 320), 0.4), "empty"),
        (np.where(np.arange(320) < 100, 1.0, scene(0.8)), ""),
        (np.minimum(scene(0.8) * 2 + 0.35, 1.0), "overexposed"),
        (np.maximum(scene(0.8) - 0.66, 0), "too dark"),
        (scene(8.0), "out of focus"),
        (scene(0.8)[:2], "no room for edges"),
    ],
    ids=["empty", "a third white", "white", "dark", "blurred", "two rows"],
)
def test_each_fault_is_named(picture: Picture, says: str) -> None:
    found = " ".join(faults_of(picture))
    assert says in found
    assert bool(found) == bool(says)
