"""The .npz files of data sets are those that numpy writes, to whoever reads them."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
import pytest

from cadcam.dataset.npz import arrays_file

ARRAYS: dict[str, np.ndarray[Any, Any]] = {
    "q": np.arange(14, dtype=np.float32).reshape(7, 2),
    "start": np.array([0, 3, 7], np.int32),
    "edge": np.zeros(0, np.int32),
    "p": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
    "long_name_of_an_array_with_many_axes": np.zeros((1, 2, 1, 3, 1, 1, 2), np.uint8),
}


def read(data: bytes) -> dict[str, np.ndarray[Any, Any]]:
    with np.load(io.BytesIO(data)) as file:
        return dict(file)


def test_numpy_reads_the_arrays_that_were_written() -> None:
    there = read(arrays_file(**ARRAYS))
    assert list(there) == list(ARRAYS)
    for name, array in ARRAYS.items():
        assert there[name].dtype == array.dtype
        np.testing.assert_array_equal(there[name], array)


def test_the_archive_is_whole_to_readers_of_archives() -> None:
    """They compare every sum, and what the index says with what stands before each member."""
    with zipfile.ZipFile(io.BytesIO(arrays_file(**ARRAYS))) as archive:
        assert archive.testzip() is None
        assert archive.namelist() == [f"{name}.npy" for name in ARRAYS]


def test_the_numbers_begin_where_they_can_be_mapped() -> None:
    """NEP 1: at a multiple of 64 bytes from the beginning of each member."""
    with zipfile.ZipFile(io.BytesIO(arrays_file(**ARRAYS))) as archive:
        for name, array in ARRAYS.items():
            assert (len(archive.read(f"{name}.npy")) - array.nbytes) % 64 == 0


@pytest.mark.parametrize("lost", [1, 30, 200])
def test_a_file_that_is_cut_off_is_refused(lost: int) -> None:
    with pytest.raises(zipfile.BadZipFile):
        read(arrays_file(**ARRAYS)[:-lost])
