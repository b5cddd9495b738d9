"""`cadcam lens` gives the lens for a view, and refuses what no lens can do."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from .job import Ran

Cadcam = Callable[..., Ran]


def test_which_lens_for_two_metres_at_six_on_half_an_inch(cadcam: Cadcam) -> None:
    ran = cadcam("lens", "--sensor-size", "1/2", "--field-width", 2000, "--focus", 6000)
    assert ran.code == 0
    assert "19.14 mm lens" in ran.out
    assert "16 mm lens at 6000 mm" in ran.out
    assert "25 mm lens at 6000 mm" in ran.out


def test_an_f_number_without_pixels_says_what_is_missing(cadcam: Cadcam) -> None:
    words = ("lens", "--sensor-size", "1/2", "--field-width", 2000, "--focus", 6000, "--f-number", 8)
    assert "not known without the sensor's pixels" in cadcam(*words).out
    said = cadcam(*words, "--json").json
    assert (said["f_number"], "sharp_mm" in said) == (8, False)


def test_nine_tenths_of_a_chip_need_their_pixels(cadcam: Cadcam) -> None:
    """All its pixels on nine tenths of its width would be smaller than they are."""
    words = ("lens", "--sensor-size", "IMX264", "--effective", "--focal", 16, "--focus", 1500)
    ran = cadcam(*words)
    assert ran.code == 2
    assert "--effective is given with IMX264" in ran.err
    assert cadcam(*words, "--size", "2203x1843", "--json").json["mm_per_pixel"][0] == pytest.approx(
        3.45e-3 * (1500 / 16 - 1), rel=3e-4
    )


def test_json_has_the_same_numbers(cadcam: Cadcam) -> None:
    words = (
        "lens",
        "--sensor-size",
        "IMX264",
        "--focal",
        16,
        "--focus",
        1500,
        "--f-number",
        8,
        "--speed",
        100,
        "--json",
    )
    document = json.loads(cadcam(*words).out)
    assert document["field_mm"][0] == pytest.approx(8.4456 * (1500 / 16 - 1))
    assert document["longest_exposure_s"] == pytest.approx(0.5 * document["mm_per_pixel"][0] / 100)
    assert document["standard_lenses"] == []
    near, far = document["sharp_mm"]
    assert near < 1500 < far


def test_a_pixel_on_the_object_stands_for_the_width(cadcam: Cadcam) -> None:
    words = ("lens", "--sensor-size", "1/2", "--size", "768x576", "--focus", 6000, "--json")
    by_pixel = json.loads(cadcam(*words, "--mm-per-pixel", 3).out)
    assert by_pixel == json.loads(cadcam(*words, "--field-width", 3 * 768).out)


def test_the_list_of_sensors_is_json_where_that_is_asked_for(cadcam: Cadcam) -> None:
    known = {sensor["name"]: sensor for sensor in cadcam("lens", "--list", "--json").json["sensors"]}
    assert known["IMX264"]["pixels"] == [2448, 2048]
    assert known["1/2"]["pixels"] is None
    assert len(known) == len(cadcam("lens", "--list").out.strip().splitlines()) - 3  # title, heads and rule


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_diagram_is_drawn(cadcam: Cadcam, tmp_path: Path, suffix: str) -> None:
    pytest.importorskip("matplotlib")
    out = tmp_path / f"lens.{suffix}"
    ran = cadcam("lens", "--sensor-size", "5.94x3.96", "--focal", 16, "--focus", 6000, "--diagram", out)
    assert ran.code == 0, ran.err
    assert out.stat().st_size > 10_000


def test_the_list_names_formats_and_chips(cadcam: Cadcam) -> None:
    out = cadcam("lens", "--list").out
    assert "6.40 x 4.80" in out
    assert "5.76 x 4.32" in out
    assert "IMX264" in out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--focal", "16", "--focus", "10", "--sensor-size", "1/2"), "more than the focal length"),
        (("--focal", "16", "--sensor-size", "1/2"), "is --focal; expected two of --focal, --focus and --field-width"),
        (("--focal", "16", "--focus", "600", "--sensor-size", "1/2", "--f-number", "0"), "f-number is 0"),
        (("--focal", "16", "--focus", "600", "--sensor-size", "2/3", "--image-circle", "8"), "diagonal of the sensor"),
        (("--focal", "16", "--sensor-size", "1/2"), "two of"),
        (("--focal", "16", "--focus", "600"), "--sensor-size is not given"),
        (("--focal", "16", "--focus", "600", "--sensor-size", "IMX26"), "did you mean"),
        (("--focal", "16", "--sensor-size", "1/2", "--mm-per-pixel", "1"), "pixels of sensor"),
    ],
)
def test_impossible_questions_are_answered_in_one_sentence(
    cadcam: Cadcam, words: tuple[str, ...], message: str
) -> None:
    ran = cadcam("lens", *words)
    assert ran.code == 2
    assert message in ran.err
    assert "Traceback" not in ran.err
