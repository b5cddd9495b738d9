"""What a camera is said to see is what the renderer draws, in every pose, behind obstacles too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cadcam
from cadcam.cad.mesh import merge
from cadcam.cad.parts.shape import box
from cadcam.camera.optics import Optics
from cadcam.plan.layout import survey
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.plan.scene.layout_scene import CameraType, LayoutScene, Mount, Seeing
from cadcam.plan.sight.candidate import Candidate, candidates
from cadcam.plan.sight.places import Places
from cadcam.plan.sight.surroundings import Surroundings
from cadcam.plan.sight.visibility import Visibility, Why, seen_from

from .scenes import COLOR, MIDDLE, features, part, position, ring, scene

ALL_ROUND = Seeing(incidence=np.radians(89.0), blur_px=1e9, border_px=0.0, least_px=0.0)


def looked(made: LayoutScene, candidate: Candidate, seeing: Seeing) -> Visibility:
    around = Surroundings(made.part, made.obstacles)
    places, poses = Places.of(made.features), tuple(made.poses.values())
    return seen_from(candidate.viewpoint, candidate.optics, places, poses, around, finder=made.finder, seeing=seeing)


@pytest.mark.parametrize("obstacle", [False, True], ids=["part alone", "behind a screen"])
def test_visible_is_what_the_renderer_draws(obstacle: bool, rng: np.random.Generator) -> None:
    mesh, n = part(), 400
    face = rng.choice(mesh.n_faces, n, p=mesh.face_areas / mesh.face_areas.sum())
    p = np.einsum("nk,nkj->nj", rng.dirichlet([1, 1, 1], n), mesh.vertices[mesh.faces[face]])
    normal = mesh.face_normals[face]
    points = tuple(LayoutFeature(f"p{i}", Kind.POINT, p[i], position(1.0), normal=normal[i]) for i in range(n))
    screen = box((-100, -250, 0), (350, -240, 420), name="screen", color=COLOR) if obstacle else None
    turned = cadcam.Rigid.exp([80.0, -60.0, 20.0, 0.05, 0.1, 0.7])
    made = scene(5, features=points, obstacles=screen, poses={"here": cadcam.Rigid(), "turned": turned})
    judged = behind = 0
    for candidate in candidates(made):
        seen = looked(made, candidate, ALL_ROUND).seen
        for i, pose in enumerate(made.poses.values()):
            world = mesh.transformed(pose) if screen is None else merge([mesh.transformed(pose), screen])
            renderer = cadcam.open_renderer(cadcam.Scene.of(world))
            camera, camera_from_world = candidate.camera, candidate.viewpoint.camera_from_world
            drawn = renderer.render(camera, camera_from_world, channels=cadcam.Channel.FACE).face
            q = camera.project(camera_from_world @ (pose @ p))
            at = np.rint(q).astype(int)
            inside = (at >= 3).all(axis=1) & (at < np.array(camera.size) - 3).all(axis=1)
            around = np.array([drawn[y - 2 : y + 3, x - 2 : x + 3].ravel() for x, y in at[inside]])
            own = around == face[inside][:, None]
            surely, never = own.all(axis=1), ~own.any(axis=1)
            assert seen[i, inside][surely].all()
            assert not seen[i, inside][never].any()
            judged += int(surely.sum() + never.sum())
            behind += int((drawn >= mesh.n_faces).sum())
    assert judged > 0.7 * 5 * 2 * n
    assert (behind > 0) == obstacle


def one(eye: tuple[float, float, float], feature: LayoutFeature, seeing: Seeing, **lens: float) -> Visibility:
    kind = replace(scene().cameras["cam"], **lens)
    mount = Mount("one", np.array([eye]), MIDDLE[None], ("cam",))
    made = scene(features=(feature,), mounts=(mount,), cameras={"cam": kind}, poses={"here": cadcam.Rigid()})
    return looked(made, candidates(made)[0], seeing)


def test_the_reason_for_not_seeing_is_named() -> None:
    up = np.array([0.0, 0, 1])
    mark = LayoutFeature("m", Kind.CIRCLE, np.array([60.0, 80, 10]), position(1.0), normal=up, diameter_mm=12.0)
    eye = (200.0, -700.0, 800.0)
    assert one(eye, mark, Seeing()).why.tolist() == [[Why.SEEN]]
    assert one(eye, replace(mark, normal=-up), Seeing()).why.tolist() == [[Why.OBLIQUE]]
    assert one(eye, mark, Seeing(least_px=200.0)).why.tolist() == [[Why.SMALL]]
    assert one(eye, mark, Seeing(blur_px=4.0), focus_mm=300.0).why.tolist() == [[Why.BLURRED]]
    assert one(eye, replace(mark, p=[2000.0, 80, 10]), Seeing()).why.tolist() == [[Why.OUTSIDE]]
    behind_wall = replace(mark, p=[120.0, 200, 10])
    assert one((900.0, 150.0, 300.0), behind_wall, Seeing(incidence=np.radians(85))).why.tolist() == [[Why.HIDDEN]]


@pytest.mark.parametrize("slant", [0.0, 0.9])
def test_a_mark_is_too_small_by_the_width_of_its_picture(slant: float) -> None:
    """Its picture's least width: the diameter where it faces the camera, else that times the cosine of the slant."""
    up, eye = np.array([0.0, 0, 1]), MIDDLE + 1000 * np.array([0.0, -np.sin(slant), np.cos(slant)])
    mark = LayoutFeature("m", Kind.CIRCLE, MIDDLE, position(1.0), normal=up, diameter_mm=10.0)
    seen = one(tuple(eye), mark, Seeing(blur_px=1e9))
    width = 10.0 * np.cos(slant) / seen.mm_per_px[0, 0]
    assert one(tuple(eye), mark, Seeing(blur_px=1e9, least_px=0.99 * width)).why.tolist() == [[Why.SEEN]]
    assert one(tuple(eye), mark, Seeing(blur_px=1e9, least_px=1.01 * width)).why.tolist() == [[Why.SMALL]]


def test_scale_slant_and_blur_are_those_of_geometry() -> None:
    up = np.array([0.0, 0, 1])
    feature = LayoutFeature("m", Kind.POINT, MIDDLE, position(1.0), normal=up)
    eye = MIDDLE + 1000 * np.array([0.0, -np.sin(0.5), np.cos(0.5)])
    seen = one(tuple(eye), feature, Seeing(), focus_mm=900.0)
    optics = scene().cameras["cam"].sensor
    assert optics is not None
    lens = Optics(optics, 16.0, 900.0, 8.0)
    assert seen.incidence[0, 0] == pytest.approx(0.5)
    assert seen.distance[0, 0] == pytest.approx(1000.0)
    assert seen.mm_per_px[0, 0] == pytest.approx(1000 / lens.camera().fx, rel=1e-6)
    assert seen.blur_px[0, 0] == pytest.approx(lens.defocus_px(1000.0))


def test_a_camera_that_sees_half_an_edge_knows_it_less_well() -> None:
    mount = Mount("front", np.array([[200.0, -700, 500]]), MIDDLE[None], ("cam",))
    made = scene(features=features()[4:], mounts=(mount,))
    camera = candidates(made)[0]
    whole = looked(made, camera, Seeing())
    made = replace(made, obstacles=box((200, -60, 0), (420, -20, 400), name="screen", color=COLOR))
    half = looked(made, camera, Seeing(share=0.2))
    assert half.seen.all()
    # the place is stated for what is seen; the direction comes from the length
    assert np.trace(half.turns.W[0, 0]) < 0.5 * np.trace(whole.turns.W[0, 0])


def test_places_inside_of_something_are_told(rng: np.random.Generator) -> None:
    around = Surroundings(part(), box((600, 0, 0), (700, 100, 100), name="post", color=COLOR))
    poses = dict(scene().poses)
    assert around.holds(np.array([185.0, 100, 60]), poses) == "the part in pose 'here'"
    assert around.holds(np.array([650.0, 50, 50]), poses) == "an obstacle"
    assert around.holds(np.array([100.0, 150, 60]), poses) == ""
    assert around.holds(np.array([2000.0, 0, 0]), poses) == ""


def test_places_of_a_zone_inside_of_something_are_left_out_and_said() -> None:
    zone = replace(ring(8), eyes=np.concatenate([ring(7).eyes, [[185.0, 100, 60]]]), spread=True)
    seen = survey(scene(mounts=(zone,)))
    assert len(seen.candidates) == 7
    assert seen.left_out == (("ring 8", "the part in pose 'here'"),)


def test_a_camera_type_needs_a_lens_or_a_calibration() -> None:
    with pytest.raises(cadcam.CadcamError, match="sensor or focal_mm"):
        CameraType("x")


def test_a_part_of_a_lens_beside_a_calibration_is_refused() -> None:
    """Its blur would silently be taken as none."""
    own = cadcam.Camera.from_focal((2448, 2048), 4600.0)
    with pytest.raises(cadcam.CadcamError, match="given in part"):
        CameraType("x", focal_mm=16.0, f_number=8.0, own=own)
    assert CameraType("x", own=own).optics(1000.0) is None
    assert CameraType("x", scene().cameras["cam"].sensor, 16.0, 8.0, own=own).optics(1000.0) is not None


@pytest.mark.parametrize(
    "changed",
    [{"share": 0.0}, {"share": 1.2}, {"blur_px": -1.0}, {"border_px": -1.0}, {"least_px": np.nan}, {"incidence": 1.6}],
    ids=str,
)
def test_what_cannot_decide_whether_a_feature_is_seen_is_refused(changed: dict[str, float]) -> None:
    """A share of 0 counted hidden features as seen."""
    with pytest.raises(cadcam.CadcamError, match=f"{next(iter(changed))} of what is seen"):
        Seeing(**changed)


def test_mounts_that_hold_no_camera_are_refused() -> None:
    """They used to be left out without a word."""
    place = np.array([[0.0, -700, 500]])
    with pytest.raises(cadcam.CadcamError, match="positions of mount 'm' is none"):
        Mount("m", np.zeros((0, 3)), np.zeros((0, 3)), ("cam",))
    for cameras in ((), ("cam", "cam")):
        with pytest.raises(cadcam.CadcamError, match="at least one, each once"):
            Mount("m", place, MIDDLE[None], cameras)
    with pytest.raises(cadcam.CadcamError, match="up of mount 'm'"):
        Mount("m", place, MIDDLE[None], ("cam",), up=(0.0, 0.0, 0.0))
    with pytest.raises(cadcam.CadcamError, match="camera of mount 'm' 'cem'; did you mean 'cam'"):
        scene(mounts=(Mount("m", place, MIDDLE[None], ("cem",)),))


def test_candidates_have_different_names() -> None:
    """By these they are kept: the second place of `ring` and a mount `ring 2` would both be."""
    other = Mount("ring 2", np.array([[0.0, -700, 500]]), MIDDLE[None], ("cam",))
    with pytest.raises(cadcam.CadcamError, match="'ring 2', 2 times"):
        candidates(scene(mounts=(ring(3), other)))
