"""Where and when a picture was taken: headers, sidecars and lists agree, or one clear error says which does not."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime

import numpy as np
import pytest

from cadcam.errors import BadValue, UnreadableFile
from cadcam.files.shot import (
    ShotPosition,
    header_shot,
    read_positions,
    read_shot,
    write_pgm,
    write_positions,
)
from cadcam.image.picture import read_picture, write_picture

NOON = datetime(2026, 3, 2, 12, 30, 5, tzinfo=UTC)
SHOT = ShotPosition(8175.4, 21616.93, "12", NOON)
SIDECAR = '{"camera": "12", "x_mm": 8175.4, "y_mm": 21616.93, "time": "2026-03-02T12:30:05+00:00"}'
GRAY = np.linspace(0, 1, 12, dtype=np.float32).reshape(3, 4)


def test_a_pgm_carries_its_shot_and_its_grey_values(tmp_path):
    write_pgm(tmp_path / "p.pgm", GRAY, SHOT)
    assert read_shot(tmp_path / "p.pgm") == SHOT
    assert read_picture(tmp_path / "p.pgm") == pytest.approx(GRAY, abs=0.5 / 255)
    write_pgm(tmp_path / "plain.pgm", GRAY)
    assert header_shot(tmp_path / "plain.pgm") is None


@pytest.mark.parametrize("camera", ["Süd", "Å 3", "南"])
def test_a_camera_is_named_in_any_script(tmp_path, camera):
    write_pgm(tmp_path / "p.pgm", GRAY, replace(SHOT, camera=camera))
    assert read_shot(tmp_path / "p.pgm").camera == camera


def test_headers_of_before_utf_8_are_read(tmp_path):
    (tmp_path / "p.pgm").write_bytes("P5\n#Camera pos: 1 2\n# camera: Süd\n1 1\n255\n\0".encode("latin-1"))
    assert read_shot(tmp_path / "p.pgm").camera == "Süd"


def test_positions_keep_every_digit(tmp_path):
    shot = ShotPosition(1 / 3, 2e5 / 7)
    write_pgm(tmp_path / "p.pgm", GRAY, shot)
    assert read_shot(tmp_path / "p.pgm") == shot


def test_positions_of_numpy_are_written_as_numbers(tmp_path):
    shots = {"a.png": ShotPosition(np.float64(8175.123456789), np.float32(0.5))}
    write_positions(tmp_path / "list.csv", shots)
    assert read_positions(tmp_path / "list.csv") == shots


def test_any_other_picture_has_a_sidecar_or_a_line_in_a_list(tmp_path):
    write_picture(tmp_path / "p.png", GRAY)
    with pytest.raises(UnreadableFile, match=r"has no camera position; write it into p\.png\.json"):
        read_shot(tmp_path / "p.png")
    write_positions(tmp_path / "positions.csv", {"p.png": SHOT})
    assert read_shot(tmp_path / "p.png", read_positions(tmp_path / "positions.csv")) == SHOT
    named = {"p.png": replace(SHOT, camera="left, 2"), "q.png": replace(SHOT, camera="#3")}
    write_positions(tmp_path / "named.csv", named)
    assert read_positions(tmp_path / "named.csv") == named
    (tmp_path / "p.png.json").write_text(SIDECAR)
    assert read_shot(tmp_path / "p.png") == SHOT


def test_sources_complete_each_other(tmp_path):
    write_pgm(tmp_path / "p.pgm", GRAY, ShotPosition(1.0, 2.0))
    assert read_shot(tmp_path / "p.pgm", {"p.pgm": ShotPosition(1.0, 2.0, "12", NOON)}) == ShotPosition(
        1.0, 2.0, "12", NOON
    )


@pytest.mark.parametrize(
    ("other", "says"),
    [
        (ShotPosition(8175.4, 21617.93, "12", NOON), r"the camera at \(8175.40, 21617.93\) mm, the header of"),
        (ShotPosition(8175.4, 21616.93, "6", NOON), "camera '6', the header of .* camera '12'"),
        (ShotPosition(8175.4, 21616.93, "12", NOON.replace(hour=13)), "the time 2026-03-02T13:30:05"),
    ],
)
def test_a_list_that_disagrees_with_the_header_is_refused(tmp_path, other, says):
    write_pgm(tmp_path / "p.pgm", GRAY, SHOT)
    with pytest.raises(UnreadableFile, match=f"positions.csv: has for p.pgm {says}"):
        read_shot(tmp_path / "p.pgm", {"p.pgm": other}, positions_from="positions.csv")


def test_times_come_as_iso_or_as_c_writes_them(tmp_path):
    head = b"P5\n#Camera pos: 1 2 # grab: %b\n1 1\n255\n\0"
    for text in (b"Mon Mar  2 12:30:05 2026", b"Mon. Mar 2 12:30:05 2026?", b"2026-03-02T12:30:05+00:00"):
        (tmp_path / "p.pgm").write_bytes(head.replace(b"%b", text))
        assert read_shot(tmp_path / "p.pgm").time == NOON
    (tmp_path / "p.pgm").write_bytes(head.replace(b"%b", b"yesterday"))
    with pytest.raises(UnreadableFile, match="says the time 'yesterday', which is none"):
        read_shot(tmp_path / "p.pgm")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("picture,x_mm\np,1\n", "has no column y_mm"),
        ("picture,x_mm,y_mm\np,1\n", "line 2 has 2 cells"),
        ("picture,x_mm,y_mm\np,1,2\np,1,2\n", "line 3 names 'p' a second time"),
        ("picture,x_mm,y_mm\np,1,two\n", "column y_mm is 'two'"),
    ],
)
def test_what_is_wrong_in_a_list_is_named(tmp_path, text, says):
    (tmp_path / "positions.csv").write_text(text)
    with pytest.raises(UnreadableFile, match=says):
        read_positions(tmp_path / "positions.csv")


@pytest.mark.parametrize("camera", ["a\n9 9", "#3"])
def test_a_camera_that_would_change_the_header_is_not_written(tmp_path, camera):
    with pytest.raises(BadValue, match="camera"):
        write_pgm(tmp_path / "p.pgm", GRAY, replace(SHOT, camera=camera))


def test_what_is_no_position_is_refused(tmp_path):
    with pytest.raises(BadValue, match="camera position x"):
        ShotPosition(float("nan"), 0.0)
    with pytest.raises(UnreadableFile, match="check the path"):
        header_shot(tmp_path / "none.pgm")
    (tmp_path / "p.pgm").write_bytes(b"P5\n#Camera pos: 1.2.3 4\n1 1\n255\n\0")
    with pytest.raises(UnreadableFile, match="no position"):
        header_shot(tmp_path / "p.pgm")
    (tmp_path / "p.pgm").write_bytes(b"P5\n#Camera pos: 1e999 4\n1 1\n255\n\0")
    with pytest.raises(UnreadableFile, match="finite number of mm"):
        header_shot(tmp_path / "p.pgm")
    (tmp_path / "p.png.json").write_text('{"x_mm": 1, "y_mm": 2, "z_mm": 3}')
    write_picture(tmp_path / "p.png", GRAY)
    with pytest.raises(UnreadableFile, match="unknown key 'z_mm'"):
        read_shot(tmp_path / "p.png")
