"""PNG files written quickly are read by others as what went in."""

from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from cadcam.errors import BadValue
from cadcam.image.png import packed


@pytest.mark.parametrize(("shape", "dtype"), [((7, 5), "u1"), ((7, 5, 3), "u1"), ((7, 5), "u2"), ((1, 1), "u2")])
def test_pillow_reads_the_same_samples(rng: np.random.Generator, shape: tuple[int, ...], dtype: str) -> None:
    samples = rng.integers(0, np.iinfo(dtype).max, shape, endpoint=True).astype(dtype)
    for given in (samples, np.zeros_like(samples), samples[:, ::-1]):
        with Image.open(io.BytesIO(packed(given))) as image:
            image.load()
            assert image.size == (shape[1], shape[0])
            np.testing.assert_array_equal(np.asarray(image), given)


@pytest.mark.parametrize(
    "samples", [np.zeros((2, 2)), np.zeros((2, 2, 4), "u1"), np.zeros((0, 2), "u1"), np.zeros(3, "u1")]
)
def test_what_is_no_picture_is_refused(samples: np.ndarray) -> None:
    with pytest.raises(BadValue, match="samples"):
        packed(samples)
