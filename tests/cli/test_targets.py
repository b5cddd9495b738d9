"""`cadcam targets`: prints marks and plans, finds marks in pictures, and says what is wrong in one message."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture
from cadcam.target.marks.ideal import board_picture
from cadcam.target.marks.mark import MarkSheet, dot_and_ring

from .job import Ran

TEXT = "dot-ring:8mm:16mm:24mm"


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    plate = MarkSheet.grid((dot_and_ring(8.0, 16.0, 24.0),), 3, 1, 60.0)
    pose = Rigid(np.eye(3), [-60.0, 0.0, 400.0])
    write_picture(tmp_path / "photo.png", board_picture(plate, Camera.from_focal((240, 120), 400.0), pose, blur_px=0.8))
    return tmp_path / "photo.png"


def test_marks_are_printed_with_their_plan(cadcam: Callable[..., Ran], tmp_path: Path) -> None:
    plan = tmp_path / "plan.csv"
    ran = cadcam(
        "targets", "print", "coded:5:20mm:30mm:40mm", "-o", tmp_path / "codes.pdf", "--page", "a4",
        "--grid", "2x2:55mm", "--numbers", "4", "--csv", plan,
    )  # fmt: skip
    assert ran.code == 0
    assert "95.00 x 95.00 mm" in ran.out
    assert plan.read_text().splitlines()[:3] == ["id,x_mm,y_mm,z_mm", "5,0,0,0", "7,55,0,0"]
    assert (tmp_path / "codes.pdf").read_bytes().startswith(b"%PDF")


def test_marks_are_found_written_and_drawn(cadcam: Callable[..., Ran], photo: Path) -> None:
    table, drawn = photo.with_name("marks.csv"), photo.with_name("found.png")
    photo = photo.rename(photo.with_name('left, "first".png'))
    ran = cadcam("targets", "find", photo, "--mark", TEXT, "--json", "--csv", table, "-o", drawn)
    assert ran.code == 0
    (seen,) = ran.json["pictures"]
    x = sorted(one["q"][0] for one in seen["marks"])
    assert x == pytest.approx([119.5 - 60, 119.5, 119.5 + 60], abs=0.02)
    with table.open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["picture"], row["id"]) for row in rows] == [(str(photo), i) for i in "123"]
    numbers = [column for column in rows[0] if column not in ("picture", "id", "number", "flags", "method")]
    assert [c for c in numbers if not c.endswith(("_px", "_px2", "_deg"))] == ["score", "contrast"]  # without a unit
    assert float(rows[0]["sigma_x_px"]) ** 2 == pytest.approx(seen["marks"][0]["covariance"][0][0], rel=1e-4)
    assert read_picture(drawn).shape == (120, 240, 3)
    assert "radius px" in cadcam("targets", "find", photo, "--mark", TEXT, "--radius", "12").out


def test_too_few_marks_are_exit_3_and_a_wrong_wish_is_exit_2(cadcam: Callable[..., Ran], photo: Path) -> None:
    few = cadcam("targets", "find", photo, "--mark", TEXT, "--count", "5")
    assert few.code == 3
    assert "only 3 were found of 5" in few.err
    for words, said in (
        ((photo, "--mark", "star:3mm"), "kind of mark"),
        ((photo, "--mark", "dot:3"), "unit"),
        ((photo, "--mark", TEXT, "--radius", "1,2,3"), "least,greatest"),
        ((photo, "--mark", TEXT, "--radius", "9,5"), "--radius is '9,5'; expected one radius in px, or least,greatest"),
        ((photo.with_name("none.png"), "--mark", TEXT), "no such file"),
    ):
        ran = cadcam("targets", "find", *words)
        assert ran.code == 2
        assert said in ran.err
