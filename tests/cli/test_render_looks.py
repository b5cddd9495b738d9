"""`cadcam render`: looks, backgrounds, and channels as OpenEXR or numbered PNG."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from cadcam.cad.read import read_model
from cadcam.cli.looks import NAMES
from cadcam.image.picture import read_picture
from cadcam.render import open_renderer
from cadcam.render.looks import LOOKS
from cadcam.render.view import Channel, Look, Scene, View

from .job import CAMERA, POSE, SIZE, Ran

Cadcam = Callable[..., Ran]
HALF = 0.5 / 255 + 1e-6  # what rounding to 8 bits may change


def seen(job: Path, **look: object) -> View:
    scene = Scene.of(read_model(job / "block.obj"))
    fine = Look(supersampling=3, **look)
    return open_renderer(scene).render(CAMERA, POSE, channels=Channel.IMAGE | Channel.FACE, look=fine)


def shot(cadcam: Cadcam, job: Path, *options: str | Path, name: str = "a.png") -> np.ndarray:
    ran = cadcam("render", job / "block.obj", "--camera", job / "camera.json", *options, "-o", job / name)
    assert ran.code == 0, ran.err
    with Image.open(job / name) as picture:
        return np.asarray(picture).astype(float)


def test_the_background_is_the_colour_asked_for(cadcam: Cadcam, job: Path) -> None:
    picture = shot(cadcam, job, "--background", "#204060")
    view = seen(job, background=(32 / 255, 64 / 255, 96 / 255))
    assert np.abs(picture / 255 - view.image).max() < HALF
    assert picture[0, 0].tolist() == [32, 64, 96]


def test_a_photo_shows_around_the_model(cadcam: Cadcam, job: Path) -> None:
    picture = shot(cadcam, job, "--background", job / "photo.png") / 255
    beside = seen(job).coverage == 0
    photo = np.repeat(read_picture(job / "photo.png")[..., None], 3, axis=2)
    assert np.abs(picture - photo)[beside].max() < HALF


def test_a_transparent_picture_over_white_is_the_picture_on_white(cadcam: Cadcam, job: Path) -> None:
    """Colour and alpha are rounded to 8 bits each: one step of 1/255 together."""
    clear = shot(cadcam, job, "--transparent", "--edges")
    white = shot(cadcam, job, "--edges", name="b.png") / 255
    assert clear.shape == (SIZE[1], SIZE[0], 4)
    alpha = clear[..., 3:] / 255
    assert alpha.min() == 0
    assert alpha.max() == 1
    assert np.abs(clear[..., :3] / 255 * alpha + (1 - alpha) - white).max() < 1 / 255 + HALF


def test_edges_darken_the_picture_and_a_look_changes_the_light(cadcam: Cadcam, job: Path) -> None:
    plain, edged = shot(cadcam, job), shot(cadcam, job, "--edges", "--width", "2")
    assert np.mean(np.abs(plain - edged).max(axis=2) > 40) > 0.005
    even = shot(cadcam, job, "--look", "inspection")
    assert even[seen(job).face >= 0].std() < plain[seen(job).face >= 0].std()


def test_a_part_has_the_colour_asked_for(cadcam: Cadcam, job: Path) -> None:
    picture = shot(cadcam, job, "--look", "flat", "--part-color", "*=#ff8000")
    assert (picture[seen(job).coverage == 1] == [255, 128, 0]).all()


def test_every_look_can_be_asked_for() -> None:
    assert set(NAMES) == set(LOOKS)


def test_face_numbers_as_a_picture_are_one_more(cadcam: Cadcam, job: Path) -> None:
    stored = shot(cadcam, job, "--channel", "faces")
    assert np.array_equal(stored - 1, seen(job).face)


def test_depth_and_normals_as_openexr_are_the_renderers_own(cadcam: Cadcam, job: Path) -> None:
    reader = pytest.importorskip("OpenEXR", reason="OpenEXR's own reader is not installed")
    view = open_renderer(Scene.of(read_model(job / "block.obj"))).render(CAMERA, POSE)
    for channel, layers in (("depth", {"Z": view.depth}), ("normals", dict(zip("XYZ", view.normal.T, strict=True)))):
        out = job / f"{channel}.exr"
        ran = cadcam("render", job / "block.obj", "--camera", job / "camera.json", "--channel", channel, "-o", out)
        assert ran.code == 0, ran.err
        stored = reader.File(str(out)).channels()
        for name, layer in layers.items():
            assert np.array_equal(stored[name].pixels, layer if channel == "depth" else layer.T)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("-o", "a.jpg", "--transparent"), "no other format has alpha"),
        (("-o", "a.png", "--transparent", "--background", "white"), "given beside --transparent"),
        (("-o", "a.png", "--background", "whit"), "a colour such as '#20262e', or a photo"),
        (("-o", "a.png", "--background", "#12345"), "a colour such as '#20262e', or a photo"),
        (("-o", "a.png", "--background", "none.png"), "none.png: no such file"),
        (("-o", "a.png", "--background", "photo.png"), "1280 x 960"),
        (("-o", "a.npy", "--channel", "depth", "--look", "flat"), "--look is given with --channel depth"),
        (("-o", "a.npy", "--channel", "depth", "--edges"), "--edges is given with --channel depth"),
        (("-o", "a.npy", "--channel", "faces", "--part-color", "a=#000000"), "--channel shaded or parts"),
        (("-o", "a.png", "--part-color", "nut=#000000"), "unknown part 'nut'"),
        (("-o", "a.png", "--threads", "0"), "threads is 0"),
        (("-o", "a.png", "--width", "3"), "--width is given where no lines are drawn"),
        (("-o", "a.npy", "--channel", "depth", "--crease-angle", "20"), "--crease-angle is given where no lines"),
        (("-o", "a.png", "--hidden", "--light", "sun"), "--hidden is given where no lines are drawn"),
        (("-o", "a.png", "--seed", "0"), "--seed is given without --sensor"),
        (("-o", "a.png", "--mesh-tolerance", "0.1"), "tolerance for block.obj is 0.1 mm; expected none"),
        (("-o", "a.png", "--overwrite"), "--overwrite is given without --poses"),
    ],
)
def test_a_look_that_cannot_be_is_one_message_and_exit_2(
    cadcam: Cadcam, job: Path, options: tuple[str, ...], message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(job)
    before = sorted(job.rglob("*"))
    ran = cadcam("render", "block.obj", *options)
    assert (ran.code, ran.out) == (2, "")
    assert message in ran.err
    assert sorted(job.rglob("*")) == before


@pytest.mark.parametrize("value", ["nut", "nut=red", "=#000000", "nut=#12345g"])
def test_a_part_colour_that_is_none_is_explained(
    value: str, cadcam: Cadcam, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as stopped:
        cadcam("render", "block.obj", "-o", "a.png", "--part-color", value)
    assert stopped.value.code == 2
    assert "#rrggbb" in capsys.readouterr().err
