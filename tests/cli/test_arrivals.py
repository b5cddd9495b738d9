"""Photos of parts as they arrive: which belong together, when they are complete, what is told of a wrong folder."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from cadcam.cli.arrivals import Arrivals, Source
from cadcam.errors import BadValue, UnreadableFile


def put(folder: Path, *names: str) -> None:
    folder.mkdir(exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"some")


def test_a_folder_gives_a_part_for_each_picture_in_the_order_of_numbers(tmp_path: Path) -> None:
    put(tmp_path, "S10.png", "S9.png", "S1.tif", "notes.txt", ".S2.png")
    assert [a.serial for a in Arrivals([Source.of(str(tmp_path))]).there()] == ["S1", "S9", "S10"]


def test_a_pattern_takes_the_serial_from_between_and_pairs_what_belongs_together(tmp_path: Path) -> None:
    put(tmp_path, "7_L.png", "7_R.png", "8_L.png", "9_R.png", "9_L.png", "x.png")
    sources = [Source.of(f"{name}={tmp_path}/*_{end}.png") for name, end in (("left", "L"), ("right", "R"))]
    arrivals = Arrivals(sources)
    assert [(a.serial, [Path(f).name for f in a.files]) for a in arrivals.there()] == [
        ("7", ["7_L.png", "7_R.png"]),
        ("9", ["9_L.png", "9_R.png"]),
    ]
    assert arrivals.incomplete() == ["8"]


def test_two_pictures_of_one_serial_are_not_guessed_between(tmp_path: Path) -> None:
    put(tmp_path, "7.png", "7.jpg", "8.png")
    arrivals = Arrivals([Source.of(str(tmp_path))])
    assert [a.serial for a in arrivals.there()] == ["8"]
    assert arrivals.incomplete() == ["7"]


def test_a_photo_that_is_being_written_has_not_arrived_and_one_written_anew_arrives_again(tmp_path: Path) -> None:
    put(tmp_path, "1.png")
    (tmp_path / "2.png").touch()
    arrivals = Arrivals([Source.of(str(tmp_path))])
    assert arrivals.new() == []  # seen once: it may be growing
    assert [a.serial for a in arrivals.new()] == ["1"]
    (tmp_path / "2.png").write_bytes(b"half")
    assert arrivals.new() == []
    (tmp_path / "2.png").write_bytes(b"half, and the rest")
    assert arrivals.new() == []
    assert [a.serial for a in arrivals.new()] == ["2"]
    assert arrivals.new() == []
    os.utime(tmp_path / "1.png", (1, 1))
    assert arrivals.new() == []
    assert [a.serial for a in arrivals.new()] == ["1"]


@pytest.mark.parametrize(
    ("text", "error", "says"),
    [
        ("nowhere", UnreadableFile, "no such folder"),
        ("nowhere/*.png", UnreadableFile, "no such folder"),
        ("in/*_*.png", BadValue, "one \\* in the name of the file"),
        ("*/a.png", BadValue, "one \\* in the name of the file"),
        ("in/?_*.png", BadValue, "one \\* in the name of the file"),
        ("in/1.png", BadValue, "cadcam verify"),
    ],
)
def test_what_is_no_source_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, error: type[Exception], says: str
) -> None:
    monkeypatch.chdir(tmp_path)
    put(tmp_path / "in", "1.png")
    with pytest.raises(error, match=says):
        Source.of(text)
