"""Finding a part without a start, saying what it could also be, and saying when it is not there."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.cad.parts import machined_bracket
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import FOUND
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search import without_start
from cadcam.locate.search.climb import row_of
from cadcam.locate.search.scales import Scales
from cadcam.locate.search.without_start import _FINELY, _judged, search
from cadcam.locate.views.view_range import ViewRange

from ..cad.solids import box
from . import scene
from .photos import CAMERA, error_px, noisy, photo, shot, view

BRACKET = Part.of(machined_bracket())
FROM_ABOVE = ViewRange(axis=np.array([0.6, 0.5, 1.0]), half_angle_deg=35.0, distance_mm=(350.0, 700.0))
RIGHT_PX = 4.0


@pytest.mark.parametrize("direction", [(0.5, 0.7, 1.0), (0.9, 0.2, 1.0)])
def test_a_part_is_found_from_nothing_in_any_turn(
    direction: tuple[float, float, float], rng: np.random.Generator
) -> None:
    turned = Rigid(so3.exp([0, 0, rng.uniform(-np.pi, np.pi)]), np.zeros(3)) @ view(BRACKET, direction)
    found = search(BRACKET, [photo(BRACKET, turned, rng)], FROM_ABOVE)
    assert error_px(BRACKET, CAMERA, found[0].world_from_part, turned) < RIGHT_PX
    assert found[0].score > 1.2 * found[1].score


def test_a_camera_that_looks_away_from_near_by_does_no_harm(rng: np.random.Generator) -> None:
    pose = view(BRACKET, (0.5, 0.7, 1.0))
    middle = pose @ BRACKET.aspects.centre
    aside = Rigid.look_at(middle + np.array([0.0, 200.0, -100.0]), middle + np.array([0.0, 900.0, -100.0]))
    away = Photo.of(noisy(gaussian_filter(rng.uniform(0, 1, (480, 640)), 3.0), 0.01, rng), CAMERA, aside)
    assert (aside @ middle)[2] < 0
    found = search(BRACKET, [photo(BRACKET, pose, rng), away], FROM_ABOVE)
    assert min(error_px(BRACKET, CAMERA, h.world_from_part, pose) for h in found[:3]) < RIGHT_PX


def test_a_long_lens_does_not_blind_the_other_camera(rng: np.random.Generator) -> None:
    """Each photo is judged as coarsely as the part is large in it: as a detail needs it, the whole has no lines."""
    pose, tele = view(BRACKET, (0.5, 0.7, 1.0)), Camera.from_focal((1200, 900), 9000.0)
    other = view(BRACKET, (0.9, 0.2, 1.0), aim=0.3)
    whole = photo(BRACKET, pose, rng)
    detail = Photo.of(noisy(shot(BRACKET, other, tele), 0.01, rng), tele, other @ pose.inv)
    here = np.array([row_of(pose)])
    alone, both = (_judged(Scales(BRACKET.aspects, photos), here, *_FINELY) for photos in ([whole], [whole, detail]))
    assert both > alone > 0


def test_a_part_beside_hatched_ground_is_found(rng: np.random.Generator) -> None:
    """Hatched ground has lines of two directions near any line: much of the part fits there wherever it is put."""
    pose = view(BRACKET, (0.5, 0.7, 1.0), away=7.0, aim=0.8)
    clean = shot(BRACKET, pose)
    y, x = np.mgrid[: clean.shape[0], : clean.shape[1]]
    hatched = 0.5 + 0.2 * np.sign(np.sin(x / 2.5)) * np.sign(np.sin(y / 2.5))
    q = CAMERA.project(pose @ BRACKET.scene.mesh.vertices)
    ground = x > q[:, 0].max() + 12 if q[:, 0].mean() < clean.shape[1] / 2 else x < q[:, 0].min() - 12
    taken = Photo.of(noisy(np.where(ground, gaussian_filter(hatched, 0.6), clean), 0.01, rng), CAMERA)
    found = search(BRACKET, [taken], ViewRange(axis=FROM_ABOVE.axis, half_angle_deg=35.0, distance_mm=(400.0, 800.0)))
    assert error_px(BRACKET, CAMERA, found[0].world_from_part, pose) < RIGHT_PX


def test_a_dozen_poses_that_climb_hold_the_right_one_on_hatched_ground(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Judged by their own lines alone, poses on the hatching are ahead of the right one by the hundred."""
    monkeypatch.setattr(without_start, "_CLIMBS", tuple(c._replace(kept=12) for c in without_start._CLIMBS))
    pose = view(BRACKET, (0.5, 0.7, 1.0), away=7.0, aim=0.8)
    x, y = np.meshgrid(*(np.arange(n) for n in CAMERA.size))
    hatched = 0.5 + 0.2 * np.sign(np.sin(x / 2.5)) * np.sign(np.sin(y / 2.5))
    q = CAMERA.project(pose @ BRACKET.scene.mesh.vertices)
    low, high = q.min(axis=0) - 12, q.max(axis=0) + 12
    ground = (x < low[0]) | (x > high[0]) | (y < low[1]) | (y > high[1])
    faint = 0.5 + 0.4 * (shot(BRACKET, pose) - 0.5)
    taken = Photo.of(noisy(np.where(ground, gaussian_filter(hatched, 0.6), faint), 0.01, rng), CAMERA)
    found = search(BRACKET, [taken], ViewRange(distance_mm=(300.0, 900.0)))
    assert error_px(BRACKET, CAMERA, found[0].world_from_part, pose) < RIGHT_PX


@pytest.mark.parametrize("size", [pytest.param((640, 240), marks=pytest.mark.slow), (320, 480)])
def test_a_part_is_found_from_nothing_through_pixels_twice_as_long_as_wide(
    size: tuple[int, int], rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    camera = scene.CAMERA.resize(size)
    monkeypatch.setattr(scene, "CAMERA", camera)
    pose = scene.pose_of(rng)
    views = ViewRange(axis=np.array([0.2, -0.7, 0.7]), half_angle_deg=30)
    found = locate_part(scene.block(), [scene.photo_of(pose, rng)], views=views)
    assert found.found
    assert error_px(scene.block(), camera, found.pose.world_from_part, pose) < 0.5


def test_a_symmetric_part_comes_back_in_every_pose_in_which_it_looks_the_same(rng: np.random.Generator) -> None:
    part = Part.of(box([0, 0, 0], [60, 60, 25]))
    pose = view(part, (0.5, 0.8, 0.7), away=6.0)
    best = search(part, [photo(part, pose, rng)], ViewRange(distance_mm=(200.0, 350.0)))[0].world_from_part
    found = [best @ part_from_part for part_from_part in part.symmetries]
    assert len(found) == 8
    v = part.scene.mesh.vertices
    for world_from_part in found:
        apart = np.linalg.norm(CAMERA.project(world_from_part @ v)[:, None] - CAMERA.project(pose @ v)[None], axis=2)
        assert apart.min(axis=1).max() < RIGHT_PX
    rotations = np.array([T.rotation for T in found])
    assert all(np.abs(rotations[k] - rotations[:k]).max(axis=(1, 2)).min() > 0.5 for k in range(1, 8))
    located = locate_part(part, [photo(part, pose, rng)], views=ViewRange(distance_mm=(200.0, 350.0)))
    assert located.found
    assert len(located.alternatives) >= 7


def test_locate_refines_what_it_finds_and_says_why(rng: np.random.Generator) -> None:
    pose = view(BRACKET, (0.5, 0.7, 1.0))
    found = locate_part(BRACKET, [photo(BRACKET, pose, rng)], views=FROM_ABOVE)
    assert found.found
    assert found.reason
    assert error_px(BRACKET, CAMERA, found.pose.world_from_part, pose) < 0.5
    assert np.isfinite(found.pose.covariance).all()


def clutter(rng: np.random.Generator) -> np.ndarray:
    """Return a picture (480, 640) of smooth patches with random bright and dark boxes: lines, but no part."""
    picture = gaussian_filter(rng.random((480, 640)), 25)
    picture = 0.3 + 0.4 * (picture - picture.min()) / np.ptp(picture)
    for _ in range(12):
        x, y, w, h = rng.integers([0, 0, 10, 10], [600, 440, 150, 150])
        picture[y : y + h, x : x + w] = rng.random()
    return gaussian_filter(picture, 0.7)


def test_what_is_not_in_the_photo_is_not_found(rng: np.random.Generator) -> None:
    photo_without = Photo.of(noisy(clutter(rng), 0.01, rng), CAMERA)
    for start in (None, view(BRACKET, (0.5, 0.7, 1.0))):
        found = locate_part(BRACKET, [photo_without], start, views=FROM_ABOVE)
        assert found.quality < FOUND
        assert found.reason.startswith("not ")


def test_another_part_is_not_taken_for_this_one(rng: np.random.Generator) -> None:
    other = Part.of(box([0, 0, 0], [90, 50, 20]))
    shown = Photo.of(noisy(shot(other, view(other, (0.4, 0.9, 0.8), away=6.0)), 0.01, rng), CAMERA)
    assert not locate_part(BRACKET, [shown], views=FROM_ABOVE).found


@pytest.mark.parametrize(("picture", "words"), [(np.full((480, 640), 0.4), "empty"), (np.ones((480, 640)), "empty")])
def test_a_photo_without_contrast_is_refused(picture: np.ndarray, words: str) -> None:
    with pytest.raises(BadValue, match=f"photo 'photo'.*{words}"):
        locate_part(BRACKET, [Photo.of(picture, CAMERA)])


def test_a_photo_of_nothing_but_black_and_white_is_refused(rng: np.random.Generator) -> None:
    with pytest.raises(BadValue, match="black or white"):
        locate_part(BRACKET, [Photo.of((rng.random((480, 640)) > 0.5).astype(np.float32), CAMERA)])


def test_no_photo_is_refused() -> None:
    with pytest.raises(BadValue, match="at least one photo"):
        locate_part(BRACKET, [])


@pytest.mark.parametrize(
    "wrong", [{"half_angle_deg": 200.0}, {"distance_mm": (5.0, 1.0)}, {"axis": np.zeros(3)}, {"roll_deg": -1.0}]
)
def test_a_range_of_views_that_is_none_is_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(BadValue, match=next(iter(wrong))):
        ViewRange(**wrong)  # type: ignore[arg-type]  # the mistake that is tested


def test_a_range_allows_what_lies_within_its_cone() -> None:
    views = ViewRange.above(within_deg=60.0)
    angles = np.radians([0, 59, 61, 180])
    directions = np.column_stack([np.sin(angles), np.zeros(4), np.cos(angles)])
    assert views.allows(directions).tolist() == [True, True, False, False]


@pytest.mark.slow
def test_a_real_cube_is_found_from_nothing(shared: Callable[[str], Path]) -> None:
    folder = shared("data/visp_mbt_cube")
    camera = Camera.from_focal((640, 480), 547.7367575, fy=542.0744058, cx=338.7036994, cy=234.5083345)
    part = Part.of(read_model(folder / "cube.obj", unit="m"))
    reference = np.loadtxt(folder / "poses_refined.csv", delimiter=",", skiprows=1)
    v = part.scene.mesh.vertices
    for frame in (0, 72, 144, 210):
        M = reference[frame, 1:13].reshape(3, 4)
        true = camera.project(v @ so3.nearest(M[:, :3]).T + 1000 * M[:, 3])
        shown = Photo.of(read_picture(folder / "cube" / f"image{frame:04d}.png"), camera)
        found = search(part, [shown])
        alike = [h.world_from_part @ S for h in found[:10] for S in part.symmetries]  # of each 24, one is returned
        assert min(np.linalg.norm(camera.project(T @ v) - true, axis=1).max() for T in alike) < 5.0
