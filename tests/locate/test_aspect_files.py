"""What a part shows is kept between runs, never half, and never taken for another part's."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from cadcam.locate.part import Part
from cadcam.locate.search import aspect_files
from cadcam.locate.search.aspect_files import file_of, read_aspects, write_aspects

from ..cad.solids import box


def part(size: float = 84.0) -> Part:
    return Part.of(box([0, 0, 0], [size, 84, 84]))


def test_what_was_kept_is_what_was_made(tmp_path: Path) -> None:
    one, other = part(), part()
    made = {key: one.aspects.aspect(*key) for key in ((3, 1), (40, 2), (399, 0))}
    write_aspects(one, tmp_path)
    assert read_aspects(other, tmp_path) == 3
    for key, aspect in made.items():
        again = other.aspects.made[key]
        assert np.array_equal(again.places, aspect.places)
        assert np.array_equal(again.telling, aspect.telling)
        assert np.array_equal(again.line, aspect.line)
        assert np.array_equal(again.direction, aspect.direction)
        assert (again.distance, again.length) == (aspect.distance, aspect.length)


def test_a_changed_model_has_another_file(tmp_path: Path) -> None:
    assert file_of(part(), tmp_path) == file_of(part(), tmp_path)
    assert file_of(part(), tmp_path) != file_of(part(84.001), tmp_path)


def test_a_damaged_file_counts_as_none(tmp_path: Path) -> None:
    one = part()
    one.aspects.aspect(3, 1)
    write_aspects(one, tmp_path)
    file = file_of(one, tmp_path)
    whole, other = file.read_bytes(), part()
    for damaged in (b"", whole[: len(whole) // 2], b"PK" + whole[2:200], whole.replace(b"distance", b"distancf")):
        file.write_bytes(damaged)
        assert read_aspects(other, tmp_path) == 0
    for k in (*range(128), *range(len(whole) - 700, len(whole))):  # a header, and the archive's directory
        file.write_bytes(whole[:k] + bytes([whole[k] ^ 16]) + whole[k + 1 :])
        assert read_aspects(other, tmp_path) == 0, k
    file.write_bytes(whole)
    assert read_aspects(other, tmp_path) == 1
    file.unlink()
    assert read_aspects(part(), tmp_path) == 0


def test_a_folder_that_cannot_be_written_to_keeps_nothing_and_harms_nothing(tmp_path: Path) -> None:
    one = part()
    one.aspects.aspect(3, 1)
    (tmp_path / "file").write_text("kept")
    write_aspects(one, tmp_path / "file")
    assert read_aspects(part(), tmp_path / "file") == 0
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("file", "kept")]


def test_the_oldest_files_go_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for k in range(4):
        one = part(80.0 + k)
        one.aspects.aspect(3, 1)
        write_aspects(one, tmp_path)
        os.utime(file_of(one, tmp_path), (k + 1, k + 1))
    size = file_of(part(80.0), tmp_path).stat().st_size
    monkeypatch.setattr(aspect_files, "_MOST_BYTES", int(2.5 * size))
    aspect_files._forget(tmp_path)
    assert [file_of(part(80.0 + k), tmp_path).exists() for k in range(4)] == [False, False, True, True]
