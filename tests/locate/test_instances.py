"""All instances of a part are found, each once, also one behind another; and none where there is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from scipy.stats import chi2

from cadcam.cad.edges import EdgeKind, feature_edges
from cadcam.cad.mesh import merge
from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.image.direction_field import direction_fields
from cadcam.locate.in_photos import locate_part
from cadcam.locate.instances import locate_instances
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.options import EDGES
from cadcam.locate.refine.refinement import Refinement, drawn
from cadcam.locate.views.view_range import ViewRange
from cadcam.render import open_renderer
from cadcam.render.view import Channel

from ..cad.solids import box
from .photos import LOOK, error_px, noisy

BRACKET = Part.of(machined_bracket())
MIDDLE = BRACKET.scene.mesh.bounds.mean(axis=0)
CAMERA = Camera.from_focal((1200, 900), 1700.0)
EYE = Rigid.look_at(np.array([150.0, -450.0, 800.0]), np.zeros(3))  # camera_from_world, of a table z = 0
VIEWS = ViewRange(half_angle_deg=50.0, distance_mm=(750.0, 1100.0))
RIGHT_PX = 2.0


def lying(x: float, y: float, turn_deg: float, *, height: float = 0.0) -> Rigid:
    """Return world_from_part of a bracket on the table, or above it."""
    R = exp(np.array([0.0, 0.0, np.radians(turn_deg)]))
    return Rigid(R, np.array([x, y, height]) - R @ np.array([*MIDDLE[:2], 0.0]))


TRAY = [lying(-140, 90, 20), lying(30, 130, -70), lying(150, -10, 130), lying(-60, -90, -160)]


def taken(part: Part, poses: list[Rigid], rng: np.random.Generator) -> Photo:
    """Return a photo of instances; its camera stands where it is in the world."""
    look = replace(LOOK, background=(0.2, 0.2, 0.2))
    shaded = open_renderer(part.scene.repeated(poses)).render(CAMERA, EYE, look=look, channels=Channel.IMAGE)
    return Photo.of(noisy(gaussian_filter(shaded.gray, 0.6), 0.01, rng), CAMERA, EYE)


def matched(found: list[Rigid], poses: list[Rigid], part: Part = BRACKET) -> list[int]:
    """Return the number of the instance that each pose found is of."""
    eyes = [EYE @ pose for pose in poses]
    off = [[error_px(part, CAMERA, EYE @ one, eye) for eye in eyes] for one in found]
    assert np.min(off, axis=1).max() < RIGHT_PX
    return [int(k) for k in np.argmin(off, axis=1)]


@pytest.mark.parametrize("count", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_every_instance_in_a_tray_is_found_once_as_surely_as_is_said(count: int, rng: np.random.Generator) -> None:
    photo, searches = taken(BRACKET, TRAY[:count], rng), []
    found = locate_instances(BRACKET, [photo], views=VIEWS, step=searches.append)
    assert all(one.found for one in found)
    numbers = matched([one.pose.world_from_part for one in found], TRAY)
    assert sorted(numbers) == list(range(count))
    assert searches[-1] == count
    assert [one.quality for one in found] == sorted((one.quality for one in found), reverse=True)
    # The sum over all poses; twice its size for the model of the noise, as elsewhere.
    xi = [(one.pose.world_from_part.inv @ TRAY[k]).log() for one, k in zip(found, numbers, strict=True)]
    total = sum(x @ np.linalg.solve(one.pose.covariance, x) for x, one in zip(xi, found, strict=True))
    assert total < 2 * chi2.ppf(0.999, 6 * count)
    assert not locate_part(BRACKET, [photo], views=VIEWS).found  # none of them stands out


def test_no_more_are_looked_for_than_asked(rng: np.random.Generator) -> None:
    found = locate_instances(BRACKET, [taken(BRACKET, TRAY[:3], rng)], views=VIEWS, most=2)
    assert len(set(matched([one.pose.world_from_part for one in found], TRAY))) == 2


def test_one_that_is_half_behind_another_is_found_and_believed_for_what_shows_of_it(rng: np.random.Generator) -> None:
    heap = [lying(0, 0, 25), lying(45, 55, 110, height=70.0)]
    photo = taken(BRACKET, heap, rng)
    found = locate_instances(BRACKET, [photo], views=VIEWS)
    poses = [one.pose.world_from_part for one in found]
    assert sorted(matched(poses, heap)) == [0, 1]
    above, below = heap[1], heap[0]
    alone, behind = (Refinement(BRACKET, [photo], others=others).around(below)[0] for others in ([], [above]))
    assert len(behind.matches) < 0.9 * len(alone.matches)
    assert behind.quality > alone.quality + 0.05


def test_where_there_is_none_the_best_pose_tried_is_not_found(rng: np.random.Generator) -> None:
    plates = Part.of(box((-90, -40, 0), (90, 40, 30)))
    photo = taken(plates, [Rigid(translation=[-120.0, 60, 0]), Rigid(translation=[130.0, -50, 0])], rng)
    (only,) = locate_instances(BRACKET, [photo], views=VIEWS)
    assert not only.found
    assert only.reason


def test_each_instance_of_a_symmetric_part_has_its_other_poses(rng: np.random.Generator) -> None:
    brick = Part.of(box((0, 0, 0), (120, 70, 40)))
    poses = [Rigid(exp(np.array([0, 0, a])), np.array([x, y, 0.0])) for a, x, y in ((0.5, -120, 0), (-0.8, 60, -20))]
    found = locate_instances(brick, [taken(brick, poses, rng)], views=replace(VIEWS, half_angle_deg=180.0))
    assert len(found) == 2
    alike = [one.pose.world_from_part for every in found for one in (every, *every.alternatives)]
    assert len(alike) == 2 * len(brick.symmetries)
    for pose in poses:
        assert min(error_px(brick, CAMERA, EYE @ one, EYE @ pose) for one in alike) < RIGHT_PX


def test_bad_arguments_are_named(rng: np.random.Generator) -> None:
    photo = taken(BRACKET, TRAY[:1], rng)
    with pytest.raises(BadValue, match="most"):
        locate_instances(BRACKET, [photo], most=0)
    with pytest.raises(BadValue, match="photos"):
        locate_instances(BRACKET, [])
    with pytest.raises(BadValue, match=r"Part\.of"):
        locate_instances(BRACKET.scene.mesh, [photo])  # type: ignore[arg-type]


def test_lines_behind_another_instance_are_left_out_and_no_others() -> None:
    """A plate stands between the camera and the right half of another: exactly what projects onto it is hidden."""
    plate = Part.of(box((0, 0, 0), (200, 120, 4)))
    eye = Rigid.look_at(np.array([100.0, 60, 1500]), np.array([100.0, 60, 0]), up=(0, 1, 0))
    gray = np.linspace(0, 1, 480 * 640, dtype=np.float32).reshape(480, 640)
    photo = Photo.of(gray, Camera.from_focal((640, 480), 900.0), eye)
    here, before = Rigid(), Rigid(translation=[110.0, -20.0, 100.0])
    (sight,) = drawn(plate, [photo], here, EDGES)
    kept = sight.unoccluded(plate, [before])
    q = photo.camera.project(eye @ sight.samples.p)
    corners = photo.camera.project(eye @ before @ plate.scene.mesh.vertices)
    low, high = corners.min(axis=0), corners.max(axis=0)  # the camera looks straight down: a rectangle
    inside = ((q > low) & (q < high)).all(axis=1)
    assert 20 < inside.sum() < len(q) - 20
    assert np.array_equal(kept.samples.p, sight.samples.p[~inside])
    assert len(sight.unoccluded(plate, [here]).samples) == len(sight.samples)  # itself hides nothing
    assert len(sight.unoccluded(plate, [Rigid(translation=[0.0, 0, -100.0])]).samples) == len(
        sight.samples
    )  # behind it


@pytest.mark.parametrize("lens", [None, BrownConrady(k1=-0.2)])
@pytest.mark.parametrize("reduction", [1, 2])
def test_searches_see_no_lines_in_what_is_explained(
    lens: BrownConrady | None, reduction: int, rng: np.random.Generator
) -> None:
    camera = Camera.from_focal((320, 240), 400.0) if lens is None else Camera.from_focal((320, 240), 400.0, lens=lens)
    gray = rng.uniform(0, 1, (240, 320)).astype(np.float32)
    known = np.zeros((240, 320), bool)
    known[60:180, 80:240] = True
    plain, masked = (
        direction_fields(gray, camera, reduction=reduction, levels=1, explained=m)[0] for m in (None, known)
    )
    height, width = masked.planes.values.shape[1:]
    y, x = np.mgrid[:height, :width].astype(float)
    ray = masked.camera.unproject(np.stack([x, y], axis=-1))
    at = np.rint(camera.project(ray))  # of the photo's pixels
    deep = ((at >= [83, 63]) & (at <= [236, 176])).all(axis=-1)
    away = ((at < [76, 56]) | (at > [243, 183])).any(axis=-1)
    assert deep.sum() > 1000 / reduction**2
    assert not masked.planes.values[:, deep].any()
    assert np.array_equal(masked.planes.values[:, away], plain.planes.values[:, away])
    photo = replace(Photo.of(gray, camera), explained=known)
    assert np.array_equal(photo.fields(reduction=reduction, levels=1)[0].planes.values, masked.planes.values)


def test_a_scene_repeated_is_the_scene_of_all_instances() -> None:
    """Edges of copies that do not touch are those found in the merged mesh; colours and paint follow the parts."""
    mesh = merge([box((0, 0, 0), (30, 20, 10), name="a"), box((0, 0, 10), (10, 10, 25), name="b")])
    scene = Part.of(mesh).scene
    poses = [Rigid(translation=[100.0 * k, 0, 0]) for k in range(3)]
    several = scene.repeated(poses)
    found = feature_edges(merge([mesh.transformed(pose) for pose in poses]))
    ends, expected = (np.sort(e.vertices, axis=1) for e in (several.edges, found))
    assert np.array_equal(ends[np.lexsort(ends.T)], expected[np.lexsort(expected.T)])
    assert (several.edges.kind == EdgeKind.CONTACT).sum() == 3 * (scene.edges.kind == EdgeKind.CONTACT).sum() > 0
    assert len(np.unique(several.edges.chain)) == 3 * len(np.unique(scene.edges.chain))
    assert np.array_equal(several.mesh.part[several.edges.faces[:, 0]], several.edges.part)
    assert np.array_equal(several.colors[several.paint].reshape(3, -1, 3)[2], scene.colors[scene.paint])
    assert several.mesh.part_names[:2] == ("a", "b")
    with pytest.raises(BadValue):
        scene.repeated([])
