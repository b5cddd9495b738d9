"""Arrays as pictures: bytes, numbers of 10 to 16 bits, shares of white, and what is none of these."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from cadcam.errors import BadValue
from cadcam.image.picture import checked, encoded


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_whole_numbers_as_cameras_give_them_count_by_their_largest(kind):
    stored = np.array([[0, 51], [204, np.iinfo(kind).max]], kind)
    assert checked(stored) == pytest.approx(stored / np.iinfo(kind).max, abs=1e-7)
    with pytest.raises(BadValue, match=r"as bright as \d+; expected values in \[0, 1\]: divide by 255"):
        checked(stored.astype(np.float32))
    assert checked(np.full((2, 2), 30.0)).max() == 30.0  # a lamp in view


@pytest.mark.parametrize(("brightest", "white"), [(900, 1023), (3891, 4095), (16383, 16383)])
def test_sixteen_bit_numbers_whose_white_nobody_knows_are_refused_with_the_remedy(brightest, white):
    """Divided by 65535 a camera's 12 bits are nearly black, and lines drown in them without a word."""
    stored = np.array([[0, 7], [30, brightest]], np.uint16)
    with pytest.raises(BadValue, match=rf"none exceeds {brightest}; expected it divided by .*picture / {white} if"):
        checked(stored)
    assert checked(stored / white).max() == pytest.approx(brightest / white)
    assert checked(stored / 65535).max() == pytest.approx(brightest / 65535)


@pytest.mark.parametrize("stored", [[0, 16384], [0, 16, 160], [0, 257, 514], [0, 0]])
def test_sixteen_bit_numbers_that_say_their_white_are_read(stored):
    """More than 14 bits; bits filled from the top; bytes written twice; black, whatever white is."""
    assert checked(np.array([stored], np.uint16)) == pytest.approx(np.array([stored]) / 65535)


@pytest.mark.parametrize("stored", [np.full((2, 2), 90), np.full((2, 2), 90, np.int32), np.zeros((2, 2), complex)])
def test_numbers_that_are_neither_bytes_nor_shares_of_white_are_refused(stored):
    with pytest.raises(BadValue, match=r"divide by 255, or give uint8|an array of shape"):
        checked(stored)
    assert checked(np.eye(2, dtype=int)).max() == 1
    assert checked(np.eye(2, dtype=bool)).max() == 1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_hole_in_a_picture_is_refused_at_its_pixel(bad):
    picture = np.zeros((3, 4), np.float32)
    picture[1, 2] = bad
    with pytest.raises(BadValue, match=r"not finite at pixel \(x, y\) = \(2, 1\)"):
        checked(picture)


def test_to_be_written_a_large_picture_is_not_held_once_more_as_numbers(rng: np.random.Generator) -> None:
    """Bytes, Pillow's copy of them and the file: each at most a quarter of the picture."""
    picture = rng.random((1500, 1000), np.float32)
    encoded(picture[:1], "PNG")  # imports
    tracemalloc.start()
    try:
        encoded(picture, "PNG")
        assert tracemalloc.get_traced_memory()[1] < 0.8 * picture.nbytes
    finally:
        tracemalloc.stop()
