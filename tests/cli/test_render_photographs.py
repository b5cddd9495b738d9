"""`cadcam render --light --focal --f-number --focus --sensor`: photographs, and what cannot be photographed."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.cad.read import read_model
from cadcam.camera.aperture import Aperture
from cadcam.cli.photograph_options import LIGHTS as NAMES
from cadcam.cli.sensors import generator
from cadcam.image.picture import read_picture
from cadcam.image.sensor.presets import preset
from cadcam.render.light import LIGHTS, named_light
from cadcam.render.photograph import Photographer
from cadcam.render.view import Scene

from .job import CAMERA, POSE, Ran

Cadcam = Callable[..., Ran]
HALF = 0.5 / 255 + 1e-6  # what rounding to 8 bits may change


def shot(cadcam: Cadcam, job: Path, *options: str | Path, name: str = "a.png") -> Ran:
    few = () if "--renderings" in options else ("--renderings", "2")
    return cadcam("render", job / "block.obj", "--camera", job / "camera.json", *options, *few, "-o", job / name)


def test_the_lights_offered_are_those_there_are() -> None:
    assert tuple(LIGHTS) == NAMES


def test_a_photograph_is_what_the_library_takes(cadcam: Cadcam, job: Path) -> None:
    options = ("--light", "sun", "--focal", "16", "--f-number", "2", "--focus", "700", "--sensor", "global-shutter")
    ran = shot(cadcam, job, *options, "--seed", "3", "--background", "#000000", "--json")
    assert ran.code == 0, ran.err
    said = json.loads(ran.out)
    assert (said["aperture_mm"], said["focus_mm"]) == (8.0, 700.0)
    taken = Photographer(Scene.of(read_model(job / "block.obj"))).photograph(
        CAMERA,
        POSE,
        light=named_light("sun"),
        aperture=Aperture(8.0, 700.0),
        sensor=preset("global-shutter"),
        rng=generator(3, "a.png"),
        samples=2,
    )
    assert np.abs(read_picture(job / "a.png") - taken).max() < HALF


def test_focus_is_the_middle_of_the_model_unless_it_is_said(cadcam: Cadcam, job: Path) -> None:
    ran = shot(cadcam, job, "--focal", "25", "--f-number", "2.5")
    assert ran.code == 0, ran.err
    low, high = read_model(job / "block.obj").bounds
    depth = (POSE @ ((low + high) / 2))[2]
    assert f"opening 10 mm, focused at {depth:.6g} mm" in ran.out


def test_transparent_photographs_have_no_wall_behind_them(cadcam: Cadcam, job: Path) -> None:
    for options, corner in (((), 128 / 255), (("--transparent",), 1.0)):  # read_picture lays alpha on white
        ran = shot(cadcam, job, "--light", "even", *options)
        assert ran.code == 0, ran.err
        assert read_picture(job / "a.png")[0, 0] == pytest.approx(corner, abs=HALF)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--f-number", "2"), "--f-number is given without --focal"),
        (("--focal", "16"), "given without --f-number"),
        (("--focus", "500", "--light", "sun"), "given without --f-number"),
        (("--renderings", "4"), "given without --light or --f-number"),
        (("--light", "sun", "--look", "flat"), "--look is given beside --light"),
        (("--light", "sun", "--edges"), "--edges is given beside --light"),
        (("--light", "sun", "--channel", "depth"), "--light is given with --channel depth"),
        (("--focal", "16", "--f-number", "0"), "--f-number is 0"),
        (("--focal", "-16", "--f-number", "2"), "--focal is -16"),
        (("--focal", "16", "--f-number", "2", "--focus", "10"), "nothing nearer has a real picture"),
        (("--light", "sun", "--renderings", "0"), "a whole number from 1 to 4096"),
    ],
)
def test_what_would_be_ignored_or_cannot_be_is_refused(
    cadcam: Cadcam, job: Path, options: tuple[str, ...], message: str
) -> None:
    ran = cadcam("render", job / "block.obj", "--camera", job / "camera.json", *options, "-o", job / "a.png")
    assert ran.code == 2
    assert message in ran.err
    assert not (job / "a.png").exists()
