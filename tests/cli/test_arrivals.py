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
    assert list(arrivals.incomplete()) == ["8"]


def test_two_pictures_of_one_serial_are_not_guessed_between(tmp_path: Path) -> None:
    put(tmp_path, "7.png", "7.jpg", "8.png")
    arrivals = Arrivals([Source.of(str(tmp_path))])
    assert [a.serial for a in arrivals.there()] == ["8"]
    assert list(arrivals.incomplete()) == ["7"]


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


def test_what_a_part_has_long_waited_for_is_told_once(tmp_path: Path) -> None:
    put(tmp_path, "1_L.png", "2_L.png", "2_R.png", "3_R.png")
    (tmp_path / "4_L.png").touch()
    put(tmp_path, "4_R.png")
    arrivals = Arrivals([Source.of(f"{tmp_path}/*_{end}.png") for end in "LR"])

    def told(now_s: float) -> dict[str, str]:
        arrivals.new()
        return {serial: why.replace(f"{tmp_path}/", "") for serial, why in arrivals.overdue(now_s, 10).items()}

    assert told(0) == told(9) == {}
    put(tmp_path, "3_L.png")
    assert told(10) == {"1": "waits for 1_R.png", "4": "waits for a photo that is empty as yet"}
    assert told(30) == {}
    put(tmp_path, "1_R.png")
    assert told(31) == {}
    (tmp_path / "1_L.png").unlink()
    assert told(32) == told(41) == {}
    assert told(42) == {"1": "waits for 1_L.png"}


def test_several_photos_of_one_serial_are_named(tmp_path: Path) -> None:
    put(tmp_path, "7.png", "7.jpg", "8.png")
    arrivals = Arrivals([Source.of(str(tmp_path))])
    arrivals.new()
    assert arrivals.overdue(0, 0) == {"7": f"has several photos of a camera: {tmp_path}/7.jpg, {tmp_path}/7.png"}


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
