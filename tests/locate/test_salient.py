"""Salient windows sit on corners, not on bare edges, and what looks the same nearby is left out."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, MissingCore
from cadcam.geometry.rigid import Rigid
from cadcam.locate.match import salient
from cadcam.locate.match.appearance import APPEARANCES, Appearance, counted, of_model, of_photo
from cadcam.locate.match.salient import SalientOptions, Windows, corner_strength, salient_windows
from cadcam.native import core
from cadcam.render import open_renderer
from cadcam.render.view import Channel, View

from .scene import CAMERA, block, pose_of

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)


def flat_view(size: tuple[int, int], depth: float = 1000.0) -> View:
    """Return the view of a wall that fills the picture."""
    layers = {"depth": np.full(size[::-1], depth, np.float32)}
    return View(Camera.from_focal(size, 800.0), Rigid(), layers)


def l_shapes(at: list[tuple[int, int]], size: tuple[int, int] = (240, 200)) -> Picture:
    picture = np.zeros(size[::-1], np.float32)
    for x, y in at:
        picture[y - 1 : y + 2, x : x + 20] = 1
        picture[y : y + 20, x - 1 : x + 2] = 1
    return picture


def test_corners_are_strong_and_straight_edges_are_not() -> None:
    picture = np.zeros((200, 240), np.float32)
    picture[:, 60:63] = 1
    picture[80:, 160:163] = 1
    picture[80:83, 160:] = 1
    strength = corner_strength(picture, 49)
    assert strength[85, 165] > 100 * strength[100, 61]


def test_a_window_is_where_the_corner_is_and_knows_its_point() -> None:
    picture = l_shapes([(120, 100)])
    view = flat_view((240, 200))
    windows = salient_windows(picture, np.ones(picture.shape, bool), view, Rigid())
    assert len(windows) == 1
    assert np.abs(windows.q[0] - [120, 100]).max() < 14  # the windows' inner half holds both arms
    assert np.allclose(view.camera.project(windows.p_part), windows.q)
    assert np.allclose(view.camera.project(windows.right) - windows.q, [1, 0])
    assert windows.gap[0] >= 0.3


def test_what_looks_the_same_nearby_is_left_out_unless_nobody_asks() -> None:
    picture = l_shapes([(80, 100), (110, 100), (140, 100)])
    view, all_of_it = flat_view((240, 200)), np.ones(picture.shape, bool)
    narrow = SalientOptions(side=25, reach=40, least_gap=0.3)
    asked = salient_windows(picture, all_of_it, view, Rigid(), options=narrow)
    unasked = salient_windows(picture, all_of_it, view, Rigid(), options=SalientOptions(side=25, reach=0))
    assert len(unasked) > len(asked)


@pytest.mark.parametrize("kind", APPEARANCES)
def test_windows_of_a_part_lie_on_it(kind: Appearance, rng: np.random.Generator) -> None:
    pose = pose_of(rng)
    view = open_renderer(block().scene, threads=1).render(CAMERA, pose, channels=Channel.IMAGE | Channel.DEPTH)
    drawing = of_model(view, block().lines.draw(CAMERA, pose), kind)
    counts = counted(view, drawing, kind)
    windows = salient_windows(drawing, counts, view, pose, options=SalientOptions(count=10))
    assert len(windows) >= 5
    assert (np.diff(windows.strength) <= 0).all()
    assert np.allclose(CAMERA.project(pose @ windows.p_part), windows.q, atol=1e-3)
    low, high = block().scene.mesh.bounds
    assert (windows.p_part > low - 1).all()  # of depth in single precision
    assert (windows.p_part < high + 1).all()
    assert not counts[view.coverage == 0].all()


@pytest.mark.parametrize("kind", APPEARANCES)
def test_a_large_picture_is_searched_about_the_part_alone(
    kind: Appearance, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside the part there is nothing: the windows are those of the whole picture, to the last bit."""
    camera, pose = CAMERA.crop(-300, -200, (1400, 1000)), pose_of(rng)
    view = open_renderer(block().scene, threads=1).render(camera, pose, channels=Channel.IMAGE | Channel.DEPTH)
    drawing = of_model(view, block().lines.draw(camera, pose), kind)
    counts, searched = counted(view, drawing, kind), []

    def windows() -> Windows:
        return salient_windows(drawing, counts, view, pose, options=SalientOptions(count=10))

    def asked(appearance: Picture, side: int) -> Picture:
        searched.append(appearance.shape)
        return corner_strength(appearance, side)

    monkeypatch.setattr(salient, "corner_strength", asked)
    about = windows()
    monkeypatch.setattr(salient, "_surroundings", lambda depth, options: (slice(0, 1000), slice(0, 1400)))
    whole = windows()
    assert searched[0][0] * searched[0][1] < 0.5 * 1400 * 1000
    assert searched[1] == (1000, 1400)
    assert len(about) >= 5
    for name in ("q", "p_part", "right", "strength", "gap"):
        assert np.array_equal(getattr(about, name), getattr(whole, name)), name


def test_without_a_part_there_are_no_windows() -> None:
    nothing = View(CAMERA, Rigid(), {"depth": np.full((480, 640), np.inf, np.float32)})
    assert len(salient_windows(l_shapes([(80, 100)], (640, 480)), np.ones((480, 640), bool), nothing, Rigid())) == 0


def test_a_photo_and_a_drawing_look_alike_whatever_the_light() -> None:
    gray = np.full((60, 60), 0.2, np.float32)
    gray[:, 30:] = 0.5
    dark = 0.9 - gray
    assert np.allclose(of_photo(gray, "lines"), of_photo(dark, "lines"), atol=1e-6)
    assert of_photo(gray, "lines").max() > 0.8
    assert not np.allclose(of_photo(gray, "gray"), of_photo(dark, "gray"))


@pytest.mark.parametrize(
    "wrong",
    [{"side": 3}, {"count": 0}, {"spacing": np.inf}, {"reach": np.inf}, {"reach": -1}]
    + [{"least_gap": gap} for gap in (np.nan, np.inf, -0.1, 1.5)],
    ids=str,
)
def test_wrong_options_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(BadValue, match=f"^{next(iter(wrong))} is "):
        SalientOptions(**wrong)  # type: ignore[arg-type]  # the mistake that is tested
