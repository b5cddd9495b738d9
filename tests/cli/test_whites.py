"""Photos of 12 bits in 16 give every verb what files that say their white give; the verb says how it read them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from cadcam.image.picture import read_picture, write_picture

from .job import Ran
from .locating import MODELS, make_photo_job, photo

Cadcam = Callable[..., Ran]
PART = (str(MODELS / "bracket.stl"), "--camera", "camera.json", "--start", "start.txt")
SAID = "read as 12 bits in 16: no value exceeds"


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with a photo of 12 bits: in 16 without a word (raw.tif), and in a file that says it (said.pgm)."""
    monkeypatch.chdir(tmp_path)
    make_photo_job(tmp_path)
    raw = np.round(np.clip(photo(), 0, 1) * 4095)
    tifffile.imwrite("raw.tif", raw.astype(np.uint16))
    Path("said.pgm").write_bytes(b"P5 480 360 4095\n" + raw.astype(">u2").tobytes())
    return tmp_path


def test_locate_finds_the_same_as_in_a_file_that_says_its_white(cadcam: Cadcam, here: Path) -> None:
    raw = cadcam("locate", "raw.tif", *PART, "--json", "-o", "raw.png")
    said = cadcam("locate", "said.pgm", *PART, "--json", "-o", "said.png")
    assert f"raw.tif: {SAID}" in raw.err
    assert "bits in 16" not in said.err
    for key in ("quality", "pose"):
        assert raw.json[key] == said.json[key]
    np.testing.assert_array_equal(read_picture("raw.png"), read_picture("said.png"))


@pytest.mark.parametrize("verb", ["locate", "match"])
def test_of_several_pages_the_first_is_read_and_that_is_said(cadcam: Cadcam, here: Path, verb: str) -> None:
    """Not of a picture with a thumbnail, as cameras write it."""
    raw, half = tifffile.imread("raw.tif"), tifffile.imread("raw.tif")[::2, ::2]
    for name, second in (("pages.tif", {}), ("thumb.tif", {"subfiletype": 1})):
        with tifffile.TiffWriter(name) as file:
            file.write(raw)
            file.write(half, **second)
    words = PART if verb == "locate" else ("raw.tif", "--angles", "0,0")
    for more in ((), ("--full-scale", "4095")):
        ran = cadcam(verb, "pages.tif", *words, *more)
        assert (ran.code, ran.err.count("pages.tif (2): of several pages only the first is read")) == (0, 1), ran.err
    assert "pages" not in cadcam(verb, "thumb.tif", *words).err
    if verb == "match":
        assert "pages.tif (2)" in cadcam("match", "raw.tif", "pages.tif", "--angles", "0,0").err


def test_a_photo_that_its_exif_orientation_turns_is_said_to_be_turned(cadcam: Cadcam, here: Path) -> None:
    """By 180 degrees its size is the camera's, and a pose by a principal point that is not in the middle is wrong."""
    upright = Image.fromarray(np.uint8(255 * np.clip(photo(), 0, 1)))
    exif = Image.Exif()
    exif[0x0112] = 3
    upright.transpose(Image.Transpose.ROTATE_180).save("held.png", exif=exif)
    upright.save("upright.png")
    ran, plain = (cadcam("locate", name, *PART, "--json") for name in ("held.png", "upright.png"))
    assert "held.png (turned by 180 degrees): by its EXIF orientation; the camera file has to be of" in ran.err
    assert (ran.json["photos"][0]["orientation"], plain.json["photos"][0]["orientation"]) == (3, 1)
    assert ran.json["pose"] == plain.json["pose"]
    assert "EXIF" not in plain.err


def test_full_scale_says_otherwise(cadcam: Cadcam, here: Path) -> None:
    dark = cadcam("locate", "raw.tif", *PART, "--json", "--full-scale", "65535", "-o", "dark.png")
    assert "bits in 16" not in dark.err
    assert read_picture("dark.png").min(axis=2).max() < 0.1  # lines apart, it is the picture as dark as was said
    wrong = cadcam("locate", "raw.tif", *PART, "--full-scale", "1023")
    assert wrong.code == 2
    assert "outside 0 to 1023" in wrong.err
    assert cadcam("locate", "raw.tif", *PART, "--full-scale", "-1").code == 2


def test_each_result_says_with_which_white_its_photos_were_read(cadcam: Cadcam, here: Path) -> None:
    """What was measured in raw.tif can be measured again though the same file may be read otherwise."""
    digest = hashlib.sha256(Path("raw.tif").read_bytes()).hexdigest()
    twelve = {"path": "raw.tif", "sha256": digest, "orientation": 1, "white": 4095.0, "bits": 12}
    pose = ("--pose", "start.txt", "--camera", "camera.json")
    for line in (
        ("locate", "raw.tif", *PART),
        ("verify", "raw.tif", *PART),
        ("match", "raw.tif", PART[0], *pose),
        ("match", "raw.tif", "raw.tif", "--angles", "0"),
    ):
        ran = cadcam(*line, "--json")
        assert ran.json["photos"] == [twelve], line
    odd = cadcam("locate", "raw.tif", *PART, "--json", "--full-scale", "5000").json["photos"]
    assert odd == [twelve | {"white": 5000.0, "bits": None}]
    write_picture("bytes.png", photo())
    (eight,) = cadcam("locate", "bytes.png", *PART, "--json").json["photos"]
    assert (eight["white"], eight["bits"]) == (255.0, 8)


def test_a_track_goes_on_with_the_white_that_it_was_begun_with_or_not_at_all(cadcam: Cadcam, here: Path) -> None:
    """Another white makes other pictures of the same files: a brighter frame that is added would do it unseen."""
    film, raw = here / "film", np.round(np.clip(photo(), 0, 1) * 4095)
    film.mkdir()
    tifffile.imwrite(film / "0.tif", np.round(raw * 0.24).astype(np.uint16))
    assert cadcam("track", "film", *PART, "-o", "log.jsonl").code == 0
    assert json.loads(Path("log.jsonl").read_text().splitlines()[1])["white"] == [1023.0]
    tifffile.imwrite(film / "1.tif", raw.astype(np.uint16))
    ran = cadcam("track", "film", *PART, "-o", "log.jsonl")
    assert ran.code == 2
    for words in ("log.jsonl", "frame 0 was read with 1023, now with 4095", "start a new log"):
        assert words in ran.err
    assert "--full-scale 1023" not in ran.err  # the added frame exceeds it
    older = [json.loads(line) for line in Path("log.jsonl").read_text().splitlines()]
    del older[1]["white"]
    Path("log.jsonl").write_text("".join(json.dumps(line) + "\n" for line in older))
    assert cadcam("track", "film", *PART, "-o", "log.jsonl").code == 0


def test_the_white_that_a_track_was_begun_with_lets_it_go_on(cadcam: Cadcam, here: Path) -> None:
    (here / "film").mkdir()
    tifffile.imwrite(here / "film/0.tif", np.round(np.clip(photo(), 0, 1) * 1000).astype(np.uint16))
    line = ("track", "film", *PART, "-o", "log.jsonl")
    assert cadcam(*line, "--full-scale", "2000").code == 0
    ran = cadcam(*line)
    assert ran.code == 2
    assert "read with 2000, now with 1023; --full-scale 2000, or start a new log" in " ".join(ran.err.split())
    assert cadcam(*line, "--full-scale", "2000").code == 0


def test_overlay_shows_twelve_bits_as_bright_as_they_are(cadcam: Cadcam, here: Path) -> None:
    for name in ("raw.tif", "said.pgm"):
        ran = cadcam("overlay", name, *PART[:3], "--pose", "start.txt", "-o", f"{name[:-4]}.png")
        assert ran.code == 0, ran.err
        assert (SAID in ran.err) == (name == "raw.tif")
    np.testing.assert_array_equal(read_picture("raw.png"), read_picture("said.png"))


def test_a_film_has_one_white_whatever_each_frame_s_brightest_is(cadcam: Cadcam, here: Path) -> None:
    film = here / "film"
    film.mkdir()
    raw = np.round(np.clip(photo(), 0, 1) * 4095)
    for n, share in enumerate((0.24, 1.0, 0.24)):  # the first and last by themselves would be of 10 bits
        tifffile.imwrite(film / f"{n}.tif", np.round(raw * share).astype(np.uint16))
    assert (raw * 0.24).max() < 1023
    ran = cadcam("track", "film", *PART, "-o", "log.jsonl", "--overlays", "seen")
    assert ran.code == 0, ran.err
    assert f"film: {SAID}" in ran.err
    means = [float(read_picture(here / "seen" / f"0000{n}.jpg").mean()) for n in range(3)]
    assert means[0] == pytest.approx(means[2], abs=0.01)
    assert means[0] < 0.5 * means[1]
    assert len(Path("log.jsonl").read_text().splitlines()) == 4
    again = cadcam("track", "film", *PART, "-o", "log.jsonl", "--full-scale", "65535", "--overwrite")
    assert "bits in 16" not in again.err


def test_marks_are_found_alike(cadcam: Cadcam, here: Path) -> None:
    marks = np.full((240, 320), 0.8)
    y, x = np.mgrid[:240, :320]
    for cx, cy in ((90.3, 80.6), (220.1, 150.2)):
        marks[np.hypot(x - cx, y - cy) < 24] = 0.1
    raw = np.round(marks * 4095)
    tifffile.imwrite("marks.tif", raw.astype(np.uint16))
    write_picture("marks.png", raw / 4095, bits=16)
    found = {}
    for name in ("marks.tif", "marks.png"):
        ran = cadcam("targets", "find", name, "--mark", "dot:30mm", "--json")
        assert (SAID in ran.err) == (name == "marks.tif")
        found[name] = [mark["q"] for mark in ran.json["pictures"][0]["marks"]]
    np.testing.assert_allclose(found["marks.tif"], found["marks.png"], atol=1e-3)
