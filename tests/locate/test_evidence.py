"""Points, lines and poses known beside the part's edges: what cameras do to them, in which photo, and what is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.locate.evidence import Evidence, LineEvidence, PointEvidence, PoseEvidence
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.track.frames import Frame
from cadcam.locate.track.tracker import track_part
from cadcam.locate.uncertainty import with_known_poses

from . import printed
from .photos import CAMERA, noisy, shot, view
from .scene import block, off, photo_of, pose_of
from .test_retaken import enlarged

SURE = np.diag([0.01] * 3 + [1e-4] * 3) ** 2
BY_FOCAL = np.zeros((11, 1))
BY_FOCAL[7, 0] = 1.0  # local coordinates: X Y Z rx ry rz aspect focal ...


@pytest.fixture(scope="module")
def clean(part: Part, pose: Rigid) -> Picture:
    return shot(part, pose)


def unsure(camera: Camera, sd: float, owner: object) -> Viewpoint:
    """Return a camera at the world's origin whose focal length is known to sd, in px."""
    source = ErrorSource("calibration", np.array([[sd**2]]), owner=owner)
    return replace(Viewpoint.exact("camera", camera, Rigid(), sigma_px=0.1), errors=((source, BY_FOCAL),))


def one_sd(covariance: Array) -> Array:
    """Return the twist (6,) of one standard deviation of a covariance of rank 1, either sign."""
    values, axes = np.linalg.eigh(covariance)
    return np.asarray(axes[:, -1] * np.sqrt(values[-1]))


def error_of(predicted: Array, moved: Array, radius: float) -> float:
    """Return by what share of it a twist differs from a predicted one of either sign, turns times a radius (mm)."""
    scale = np.repeat([1.0, radius], 3)
    return float(min(np.linalg.norm(scale * (moved + s * predicted)) for s in (1, -1)) / np.linalg.norm(scale * moved))


def marks(part: Part, pose: Rigid) -> tuple[Array, Array]:
    """Return four of the part's vertices and the pixels that show them."""
    p = part.scene.mesh.vertices[[0, 20, 60, 90]]
    return p, CAMERA.project(pose @ p)


@pytest.mark.parametrize("kind", ["points", "lines"])
@pytest.mark.parametrize("sigma_px", [0.002, 0.05])
def test_errors_of_the_calibration_reach_the_pose_through_evidence_too(
    part: Part, pose: Rigid, clean: Picture, rng: np.random.Generator, kind: str, sigma_px: float
) -> None:
    """A focal length 0.2 percent long moves the answer by what its covariance says, whatever was measured."""
    gray, sd = noisy(clean, 0.01, rng), 0.002 * CAMERA.fx
    p, q = marks(part, pose)
    told: list[Evidence] = [PointEvidence(p, q, sigma_px)]
    if kind == "lines":
        told = [LineEvidence(p[[i, j]], q[[i, j]], sigma_px) for i in range(4) for j in range(i)]
    found = refine_pose(part, [Photo(gray, unsure(CAMERA, sd, object()))], pose, evidence=told)
    longer = refine_pose(part, [Photo.of(gray, Camera.from_focal((640, 480), CAMERA.fx + sd))], pose, evidence=told)
    moved = (found.pose.world_from_part.inv @ longer.pose.world_from_part).log()
    assert error_of(one_sd(found.pose.from_calibration), moved, part.aspects.radius) < 0.1


def test_a_film_s_pose_by_print_is_as_unsure_of_its_camera_as_by_edges() -> None:
    """What a calibration does is the same in each frame: print learned under it repeats it, and is no other witness."""
    rng, sd = np.random.default_rng(3), 0.01 * printed.CAMERA.fx
    pictures = [printed.photo(pose, rng).gray for pose in printed.truth(7)]
    longer = Camera.from_focal(printed.CAMERA.size, printed.CAMERA.fx + sd)
    told, moved = (
        list(track_part(printed.part(), [Frame.of(k, Photo(g, by)) for k, g in enumerate(pictures)], printed.FIRST))
        for by in (
            unsure(printed.CAMERA, sd, object()),
            Viewpoint.exact("camera", longer, Rigid(), sigma_px=0.1),
        )
    )
    assert [t.how for t in told[1:]] == ["followed"] * 6
    for one, other in zip(told, moved, strict=True):
        away = (one.location.pose.world_from_part.inv @ other.location.pose.world_from_part).log()
        assert error_of(one_sd(one.location.pose.from_calibration), away, printed.part().aspects.radius) < 0.2


def test_poses_known_by_the_same_camera_share_its_error_and_no_more() -> None:
    """Half by each: of one and the same error the whole is left, if that of the known pose is none, a half of it."""
    rng = np.random.default_rng(4)
    A = rng.normal(size=(6, 6)) * np.repeat([1.0, 0.02], 3)[:, None]
    S, half = A @ A.T, 0.5 * np.eye(6)
    np.testing.assert_allclose(with_known_poses(S / 4, [(S, half)], 50.0), S, rtol=1e-9, atol=1e-12 * np.abs(S).max())
    np.testing.assert_array_equal(with_known_poses(S, [], 50.0), S)
    np.testing.assert_allclose(with_known_poses(0 * S, [(S, half)], 50.0), S / 4, rtol=1e-9, atol=1e-12)


def test_a_pose_s_own_calibration_error_counts_by_its_share(
    part: Part, pose: Rigid, clean: Picture, rng: np.random.Generator
) -> None:
    """A pose known far better than edges show it keeps its error; through exact cameras edges add none."""
    shots, S = [Photo.of(noisy(clean, 0.01, rng), CAMERA)], np.diag([0.3] * 3 + [2e-3] * 3) ** 2
    found = refine_pose(part, shots, pose, evidence=[PoseEvidence(pose, 1e-6 * SURE, 70.0, from_calibration=S)])
    sd = np.sqrt(np.diag(S))
    np.testing.assert_allclose(found.pose.from_calibration / np.outer(sd, sd), np.eye(6), atol=1e-3)


@pytest.mark.parametrize("of", [pytest.param(0, marks=pytest.mark.slow), 2])
def test_evidence_of_any_photo_is_used_where_another_photo_disagrees(
    part: Part, pose: Rigid, clean: Picture, rng: np.random.Generator, of: int
) -> None:
    """Whether the others agree is not asked without one of the photos, whose numbers would then be others."""
    poses = [pose, view(part, (-0.9, -0.6, 0.9)), view(part, (0.2, -1.0, 0.5))]
    pictures = [clean, *(shot(part, one) for one in poses[1:])]
    wrong = Rigid(translation=[2.0, 0, 0]) @ poses[1]
    places = [poses[0], wrong, poses[2]]
    shots = [Photo.of(noisy(g, 0.01, rng), CAMERA, at) for g, at in zip(pictures, places, strict=True)]
    p = part.scene.mesh.vertices[[0, 20, 60, 90]]
    found = refine_pose(part, shots, Rigid(), evidence=[PointEvidence(p, CAMERA.project(poses[of] @ p), 0.05, of)])
    assert 1 in {one.photo for one in found.disagreements}
    assert not found.left_out


def test_evidence_is_where_it_was_in_a_photo_that_is_reduced(rng: np.random.Generator) -> None:
    """Nothing is found in an enlarged photo but in a smaller one of it; a corner's pixel there is another one."""
    pose = pose_of(rng)
    photo = enlarged(photo_of(pose, rng), rng)
    p = block().scene.mesh.vertices[::9]
    corners = PointEvidence(p, photo.camera.project(pose @ p), 0.5)
    start = off(pose, rng, degrees=0.3, px=1)
    found = refine_pose(block(), [photo], start, evidence=[corners])
    assert found.found, found.reason
    assert "in photos reduced" in found.reason
    less, small = corners.reduced(3), photo.reduced(3)
    np.testing.assert_allclose(less.rows(small, pose)[0], 0, atol=1e-9)
    assert less.sigma_px == pytest.approx(0.5 / 3)


def test_evidence_alone_in_a_blank_photo_places_the_part_but_does_not_find_it(
    part: Part, pose: Rigid, rng: np.random.Generator
) -> None:
    blank = Photo.of(noisy(np.full((480, 640), 0.5, np.float32), 0.01, rng), CAMERA)
    p, q = marks(part, pose)
    for told in (PoseEvidence(pose, SURE, 70.0), PointEvidence(p, q, 0.05)):
        found = refine_pose(part, [blank], pose @ Rigid.exp([1.0, -0.5, 0.5, 0.01, 0, 0.01]), evidence=[told])
        assert not found.found
        np.testing.assert_allclose(found.pose.world_from_part.matrix, pose.matrix, atol=1e-6)


def test_evidence_that_makes_no_sense_is_refused_where_it_is_made(part: Part, pose: Rigid) -> None:
    p, q = marks(part, pose)
    with pytest.raises(BadValue, match="two points of a straight edge"):
        LineEvidence(p[[0, 0]], q, 0.1)
    for photo in (-1, 0.5, "left"):
        with pytest.raises(BadValue, match=r"photo of the evidence.*the number of a photo"):
            PointEvidence(p, q, 0.1, photo)  # type: ignore[arg-type]
    for radius in (0.0, -70.0, np.nan, "70"):
        with pytest.raises(BadValue, match=r"radius of the part.*a positive number of mm"):
            PoseEvidence(pose, SURE, radius)  # type: ignore[arg-type]
    with pytest.raises(BadValue, match="covariance of the pose is zero"):
        PoseEvidence(pose, 0 * SURE, 70.0)
    for wrong in (-SURE, SURE + 1e-4 * np.eye(6, k=1)):
        with pytest.raises(BadValue, match=r"covariance of the pose.*symmetric"):
            PoseEvidence(pose, wrong, 70.0)
    with pytest.raises(BadValue, match=r"from_calibration of the pose.*symmetric"):
        PoseEvidence(pose, SURE, 70.0, from_calibration=-SURE)
    with pytest.raises(BadValue, match="expected a Rigid"):
        PoseEvidence(pose.matrix, SURE, 70.0)  # type: ignore[arg-type]
    PoseEvidence(pose, SURE * np.diag([1.0, 1, 0, 0, 0, 1]), 70.0)  # not free along three of six


@pytest.mark.parametrize("chosen", [np.nan, 0.5, "two"])
def test_a_number_of_constraints_is_a_whole_one(part: Part, pose: Rigid, clean: Picture, chosen: object) -> None:
    with pytest.raises(BadValue, match="chosen"):
        refine_pose(part, [Photo.of(clean, CAMERA)], pose, chosen=chosen)  # type: ignore[arg-type]


def test_a_history_is_one_of_frames(part: Part, pose: Rigid) -> None:
    with pytest.raises(BadValue, match=r"frame of the history is 1; expected a LoggedFrame"):
        list(track_part(part, [], pose, history=[1]))  # type: ignore[list-item]


def test_what_is_known_very_well_counts_beside_what_is_not_known_at_all() -> None:
    """Of a round part 0.8 m large, turned anyhow about its axis, the place is known to 0.01 mm: it was not counted."""
    known, radius = np.array([0.01] * 3 + [0.01 / 400.0] * 2), 400.0
    told = PoseEvidence(Rigid(), np.diag([*known**2, np.pi**2 / 3]), radius)
    photo = Photo.of(np.zeros(CAMERA.size[::-1], np.float32), CAMERA)
    offset, rows = told.rows(photo, Rigid.exp(np.r_[-0.01, np.zeros(5)]))
    assert len(rows) == 6
    assert float(offset @ offset) == pytest.approx(1.0)
    flat = PoseEvidence(Rigid(), told.covariance * np.diag([1.0, 1, 0, 0, 0, 1]), radius)
    assert len(flat.rows(photo, Rigid())[1]) == 3
