"""Print on a part's faces is followed to a part of a pixel, whatever the light; edges overrule it in the end."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.locate.evidence import PoseEvidence
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.track.frames import Frame, Frames
from cadcam.locate.track.log import TrackLog, head_of, track_part_to_log
from cadcam.locate.track.texture import Followed, Texture
from cadcam.locate.track.tracker import LoggedFrame, TrackedFrame, track_part
from cadcam.locate.uncertainty import weakest_direction

from ..cad.solids import prism
from .printed import CAMERA, FIRST, STEP, miss_mm, part, photo, truth

SURE = 1e-10 * np.eye(6)


def learned(rng: np.random.Generator, covariance: np.ndarray = SURE) -> Texture:
    """Return what one frame shows of the print, its pose known."""
    texture = Texture(part())
    texture.keep([photo(FIRST, rng)], PoseEstimate(FIRST, covariance), None)
    return texture


def followed(
    texture: Texture, pose: Rigid, rng: np.random.Generator, *, start: Rigid, light: tuple[float, float] = (1, 0)
) -> Followed:
    """Return where print leads in a photo at camera_from_part `pose`."""
    found = texture.follow([photo(pose, rng, light=light)], start, FREE)
    assert found is not None
    return found


def test_the_motion_between_two_frames_is_found_as_surely_as_told() -> None:
    """Twelve photos, six parameters each: the normalised square error is chi^2 of 72, within 0.6 to 1.7 of its mean.

    The covariance comes from some fifty patches each time, so it is itself good to a fifth.
    """
    rng = np.random.default_rng(1)
    squares = []
    for _ in range(12):
        texture = learned(rng)
        pose = FIRST @ Rigid.exp(rng.normal(size=6) * [2, 2, 2, 0.02, 0.02, 0.02])
        found = followed(texture, pose, rng, start=FIRST)
        xi = (found.evidence.world_from_part.inv @ pose).log()
        squares.append(xi @ np.linalg.solve(found.evidence.covariance, xi))
    assert 0.6 < np.mean(squares) / 6 < 1.7


def test_light_changes_nothing() -> None:
    """Half as bright and with a veil, noise with it: each patch has its own gain and offset."""
    texture, pose = learned(np.random.default_rng(2)), FIRST @ STEP
    plain, other = (
        followed(texture, pose, np.random.default_rng(3), start=FIRST, light=light).evidence.world_from_part
        for light in ((1.0, 0.0), (0.5, 0.2))
    )
    assert miss_mm(plain, other) < 1e-3  # what float32 and the last step leave; noise alone moves it by 0.07


@pytest.mark.parametrize("px", [4.0, 14.0])
def test_a_start_some_px_off_leads_to_the_same_place(px: float) -> None:
    rng = np.random.default_rng(4)
    texture, noise = learned(rng), np.random.default_rng(5)
    beside = Rigid(translation=[px * 370 / CAMERA.fx, 0, 0]) @ FIRST
    there = followed(texture, FIRST, noise, start=FIRST).evidence.world_from_part
    found = followed(texture, FIRST, np.random.default_rng(5), start=beside).evidence.world_from_part
    assert miss_mm(there, found) < 0.02  # rounds end when nothing moves by more than 0.02 px


def test_other_print_is_not_followed() -> None:
    rng = np.random.default_rng(6)
    assert learned(rng).follow([photo(FIRST, rng, slid=(300, 200, 100))], FIRST, FREE) is None


def test_only_free_motions_are_followed() -> None:
    rng = np.random.default_rng(7)
    freedom = Freedom.along([1, 0, 0], frame="part")
    pose = FIRST @ Rigid.exp([2.0, 0, 0, 0, 0, 0])
    found = learned(rng).follow([photo(pose, rng)], FIRST, freedom)
    assert found is not None
    xi = (FIRST.inv @ found.evidence.world_from_part).log()
    assert xi[0] == pytest.approx(2.0, abs=0.1)
    np.testing.assert_allclose(xi[1:], 0, atol=1e-12)
    np.testing.assert_allclose(found.alone[1:], 0, atol=1e-20)


def test_a_pose_counts_by_its_covariance_in_the_directions_it_is_free_in() -> None:
    """Rows are y = L (xi - x) with L^T L the inverse covariance; across what is not free there are none."""
    rng = np.random.default_rng(8)
    A = rng.normal(size=(6, 4)) * np.array([1, 1, 1, 0.02, 0.02, 0.02])[:, None]
    evidence = PoseEvidence(FIRST @ STEP, A @ A.T, 70.0)
    y, J = evidence.rows(photo(FIRST, rng), FIRST)
    assert J.shape == (4, 6)
    np.testing.assert_allclose(y, J @ STEP.log(), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(A.T @ J.T @ J @ A, np.eye(4), atol=1e-9)


def test_errors_that_all_frames_share_are_told_as_large_as_those_of_one() -> None:
    """A keyframe of three frames, an exact alignment: the fit believes itself twice as sure, told is one frame's."""
    A = np.random.default_rng(9).normal(size=(6, 6)) * np.array([1, 1, 1, 0.02, 0.02, 0.02])[:, None]
    R = A @ A.T
    seen = Followed(PoseEvidence(FIRST, R / 3, 70.0), 0, R, np.zeros((6, 6)), 50)
    np.testing.assert_allclose(seen.fused(R / 4), R, rtol=1e-6, atol=1e-6 * np.abs(R).max())


def test_a_keyframe_is_moved_to_where_edges_are_by_its_share() -> None:
    """Its pose is 1 mm off and told so; edges say the truth in four frames: what is left is 1/2, 1/3, 1/4 ... of it.

    n frames make a keyframe's variance 1/n of a frame's own: it moves by 1/(n + 1) of what is left where the pose is
    the mean of both.
    """
    rng, off = np.random.default_rng(10), Rigid.exp([1.0, 0, 0, 0, 0, 0])
    R, texture = np.diag([1.0, 1, 1, 1e-4, 1e-4, 1e-4]), Texture(part())
    texture.keep([photo(FIRST, rng)], PoseEstimate(FIRST @ off, R), None)
    left = []
    for n in (1, 2, 3):
        seen = followed(texture, FIRST, rng, start=FIRST @ off)
        error = (FIRST.inv @ seen.evidence.world_from_part).log()
        left.append(error[0])
        mean = FIRST @ Rigid.exp(error * n / (n + 1))
        texture.keep([photo(FIRST, rng)], PoseEstimate(mean, R), seen)
    np.testing.assert_allclose(left, [1, 1 / 2, 1 / 3], atol=0.1)


def film(n: int, *, slid: float = 0.0) -> list[Frame]:
    """Return a film of the box; slid (mm a frame): its print slides over it."""
    rng = np.random.default_rng(11)
    return [Frame.of(k, photo(pose, rng, slid=(k * slid, 0, 0))) for k, pose in enumerate(truth(n))]


def misses(tracked: list[TrackedFrame]) -> list[float]:
    """Return how far (mm) a corner is off at most in each frame of a film."""
    poses = truth(len(tracked))
    return [miss_mm(t.location.pose.world_from_part, poses[t.frame.index]) for t in tracked]


def test_a_printed_part_is_followed_and_a_bare_look_at_edges_can_be_had() -> None:
    """Edges alone miss by up to 0.5 mm here, a third of a pixel, and print does not make that worse."""
    with_print, edges = (
        list(track_part(part(), film(6), FIRST)),
        list(track_part(part(), film(6), FIRST, texture=False)),
    )
    assert [t.how for t in with_print[1:]] == ["followed"] * 5
    assert [t.how for t in edges[1:]] == ["predicted"] * 5
    assert max(misses(with_print)) < 0.5


@pytest.mark.parametrize(("slid", "frames"), [(2.0, 1), (0.5, 4)])
def test_print_that_slides_over_the_part_takes_it_along_for_some_frames_at_most(slid: float, frames: int) -> None:
    """2 mm a frame: edges fit far better elsewhere in the next. 0.5 mm: they pull to one side in every frame."""
    tracked = list(track_part(part(), film(8, slid=slid), FIRST))
    assert all(t.found for t in tracked)
    assert max(misses(tracked)) < frames * slid + 0.5  # and what edges err by
    assert "predicted" in {t.how for t in tracked}


def test_a_run_that_goes_on_follows_the_print_as_if_there_had_been_no_break() -> None:
    """Cut anywhere: the same ways and poses to the last bit."""
    frames = film(7)
    whole = list(track_part(part(), frames, FIRST))
    for cut in (1, 3, 5):
        history = [LoggedFrame(t.frame.index, t.location.pose, t.how, t.frame.photos) for t in whole[:cut]]
        rest = list(track_part(part(), frames[cut:], FIRST, history=history))
        assert [t.how for t in rest] == [t.how for t in whole[cut:]]
        for one, other in zip(rest, whole[cut:], strict=True):
            np.testing.assert_array_equal(
                one.location.pose.world_from_part.matrix, other.location.pose.world_from_part.matrix
            )
            np.testing.assert_array_equal(one.location.pose.covariance, other.location.pose.covariance)


def test_a_log_that_goes_on_is_that_of_a_run_without_a_break(tmp_path: Path) -> None:
    from itertools import islice

    for frame in film(6):
        write_picture(tmp_path / "in" / f"{frame.index}.png", frame.photos[0].gray)
    pictures = Frames([tmp_path / "in"], [replace(film(1)[0].photos[0].viewpoint, name="camera")])

    def run(log: str, n: int | None) -> None:
        head = head_of(part(), pictures.viewpoints, FIRST)
        with TrackLog.open(tmp_path / log, head) as open_log:
            list(islice(track_part_to_log(open_log, part(), pictures, FIRST), n))

    run("whole.jsonl", None)
    run("cut.jsonl", 4)
    run("cut.jsonl", None)
    assert (tmp_path / "cut.jsonl").read_bytes() == (tmp_path / "whole.jsonl").read_bytes()
    assert '"followed"' in (tmp_path / "whole.jsonl").read_text()


def test_a_round_part_is_followed_by_its_print(rng: np.random.Generator) -> None:
    """Of its six motions one cannot be seen: credited with more than the five others, a fit still has to meet one."""
    can = Part.of(prism(96, radius=60.0, height=60.0))
    frames = [Frame.of(i, photo(pose, rng, of=can)) for i, pose in enumerate(truth(3))]
    tracked = list(track_part(can, frames, FIRST))
    assert [one.how for one in tracked[1:]] == ["followed", "followed"]
    assert all(one.found for one in tracked)


def test_what_a_frame_says_of_its_pose_is_that_of_the_pose_it_tells() -> None:
    """Edges and print together; the reason told that of edges as if print were independent of them."""
    for tracked in list(track_part(part(), film(4), FIRST))[1:]:
        assert tracked.how == "followed"
        known = weakest_direction(tracked.location.pose, part().aspects.centre, tracked.frame.photos)
        assert tracked.location.reason.endswith(known)


def test_print_learned_by_cameras_that_disagree_is_no_evidence(rng: np.random.Generator) -> None:
    """One is moved by 5 mm after three frames: the pose was said to be known to 0.1 mm, by print, and 1 mm off."""
    there = Rigid.look_at([-200.0, -200.0, 190.0], [30.0, 20.0, 10.0]) @ FIRST.inv
    frames = []
    for k, pose in enumerate(truth(6)):
        told = there @ Rigid(translation=(5.0, 2.0, 0.0)) if k >= 3 else there
        seen = [Photo.of(photo(at, rng).gray, CAMERA, to) for at, to in ((pose, Rigid()), (there @ pose, told))]
        frames.append(Frame.of(k, *seen))
    for step, pose in zip(track_part(part(), frames, FIRST), truth(6), strict=True):
        xi = (pose.inv @ step.location.pose.world_from_part).log()
        assert xi @ np.linalg.solve(step.location.pose.covariance, xi) / 6 < 9
        assert step.how == "followed" or step.frame.index in (0, 3, 4, 5)
