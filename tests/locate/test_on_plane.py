"""A part on a known plane is found where it lies there, more surely than without it; one that does not is refused."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

from cadcam.cad.parts import machined_bracket
from cadcam.camera.camera import Camera
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.errors import BadValue
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.in_photos import locate_part
from cadcam.locate.instances import locate_instances
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.search.climb import Climb, row_of
from cadcam.locate.search.lying import Lying
from cadcam.locate.search.on_plane import _at_this_size, _centres, _half_tile, _reaches_this_size, lying_poses
from cadcam.locate.search.scales import Scales
from cadcam.locate.search.without_start import unmade
from cadcam.locate.track.frames import Frame
from cadcam.locate.track.log import head_of
from cadcam.locate.track.tracker import track_part
from cadcam.locate.views.resting import OnPlane
from cadcam.locate.views.view_range import ViewRange
from cadcam.render import open_renderer
from cadcam.render.view import Channel

from ..cad.solids import box, prism
from .photos import LOOK, error_px, noisy

BRACKET = Part.of(machined_bracket())
CAMERA = Camera.from_focal((800, 600), 1100.0)
EYE = Rigid.look_at(np.array([150.0, -450.0, 800.0]), np.zeros(3))
TABLE = Plane([0.0, 0.0, 1.0], 0.0)
VIEWS = ViewRange(on=OnPlane(TABLE))
RIGHT_PX = 2.0


def lying(x: float, y: float, turn_deg: float, *, up: float = 0.0, tilt_deg: float = 0.0) -> Rigid:
    """Return world_from_part of a bracket on its base on the table, raised, or tilted about its lower edge."""
    turn, tilt = exp(np.array([0, 0, np.radians(turn_deg)])), exp(np.array([0, -np.radians(tilt_deg), 0]))
    return Rigid(turn @ tilt, [x, y, up])


def taken(part: Part, *poses: Rigid, eye: Rigid = EYE, seed: int = 3) -> Photo:
    """Return a photo of instances on the table."""
    look = replace(LOOK, background=(0.2, 0.2, 0.2))
    shaded = open_renderer(part.scene.repeated(list(poses))).render(CAMERA, eye, look=look, channels=Channel.IMAGE)
    return Photo.of(noisy(np.asarray(shaded.gray), 0.01, np.random.default_rng(seed)), CAMERA, eye)


def on(part: Part, photo: Photo, views: ViewRange = VIEWS) -> Lying:
    """Return the part on the plane."""
    known = Lying.of(part, [photo], views)
    assert known is not None
    return known


@pytest.mark.parametrize("normal", [1.0, -1.0])
def test_a_part_on_the_plane_is_found_wherever_its_normal_points(normal: float) -> None:
    truth = lying(30, -20, 65)
    views = ViewRange(on=OnPlane(Plane([0.0, 0.0, normal], 0.0)))
    found = locate_part(BRACKET, [taken(BRACKET, truth)], views=views)
    assert found.found, found.reason
    xi = (found.pose.world_from_part.inv @ truth).log()
    assert xi @ np.linalg.solve(found.pose.covariance, xi) < 2 * chi2.ppf(0.999, 6)


def test_a_part_on_its_side_is_found_and_with_another_face_stated_is_not() -> None:
    side = Rigid(exp(np.array([np.pi / 2, 0, 0])), [0.0, 0.0, 0.0])  # its -y... points up: it lies on y = 0
    photo = taken(BRACKET, side)
    found = locate_part(BRACKET, [photo], views=VIEWS)
    assert found.found, found.reason
    assert error_px(BRACKET, CAMERA, EYE @ found.pose.world_from_part, EYE @ side) < RIGHT_PX
    upright = ViewRange(on=OnPlane(TABLE, down=np.array([0.0, 0.0, -1.0])))
    assert not locate_part(BRACKET, [photo], views=upright).found


@pytest.mark.parametrize(
    ("pose", "said"),
    [(lying(0, 0, 30, up=12.0), r"up to 1[0-3] mm above"), (lying(0, 0, 30, tilt_deg=4.0), r"tilted by [34]\.\d deg")],
)
def test_one_that_does_not_lie_there_has_its_true_pose_and_is_refused(pose: Rigid, said: str) -> None:
    found = locate_part(BRACKET, [taken(BRACKET, pose)], views=VIEWS)
    assert not found.found
    assert error_px(BRACKET, CAMERA, EYE @ found.pose.world_from_part, EYE @ pose) < RIGHT_PX
    assert re.search(f"it does not lie on the plane.*{said}", found.reason), found.reason


def test_a_plane_known_less_well_allows_as_much() -> None:
    photo = taken(BRACKET, lying(0, 0, 30, up=6.0))
    known = on(BRACKET, photo)
    pose = PoseEstimate(lying(0, 0, 30, up=6.0), np.diag([0.1] * 3 + [1e-3] * 3) ** 2)
    assert known.off(pose)
    assert not replace(known, within_mm=6.0).off(pose)
    unsure = PoseEstimate(lying(0, 0, 30, up=6.0), np.diag([2.0] * 3 + [1e-3] * 3) ** 2)
    assert not known.off(unsure)  # 6 mm are three standard deviations


def off_by(covariance: np.ndarray, rng: np.random.Generator) -> Rigid:
    """Return an error of a pose, drawn from its covariance."""
    return Rigid.exp(rng.multivariate_normal(np.zeros(6), covariance))


@pytest.mark.parametrize("shared", [False, True])
def test_a_plane_counts_in_a_pose_as_well_as_it_is_known(shared: bool) -> None:
    """Planes that are off by half of what is stated, on a camera's errors alone or on those of the part, too."""
    rng, truth, within = np.random.default_rng(5), lying(30, -20, 65), 0.2
    known = on(BRACKET, taken(BRACKET, truth), ViewRange(on=OnPlane(TABLE, within_mm=within)))
    R = np.linalg.qr(rng.normal(size=(6, 6)))[0]
    noise = R @ np.diag([3.0, 2, 1, 0.02, 0.01, 0.01]) ** 2 @ R.T * np.outer(*2 * [np.repeat([1.0, 0.01], 3)])
    noise = 0.2**2 * (noise + np.diag([0.0, 0, 4, 0, 0, 0]))  # mm^2; z is up
    of_camera = np.diag([0.04, 0.04, 0.1, 2e-4, 2e-4, 2e-4]) ** 2
    squares, before, after = [], [], []
    for _ in range(400):
        common = off_by(of_camera, rng)
        one = PoseEstimate(truth @ common @ off_by(noise, rng), noise, of_camera)
        up, x, y = within / 2 * rng.normal(size=3) / [1.0, 60.0, 40.0]
        middle = truth @ np.array([60.0, 40.0, 0.0]) + [0, 0, up]
        normal = truth.rotation @ [-x, -y, 1.0]
        table = Plane.through(middle, normal)
        if shared:  # seen by the camera that sees the part: off as the part is
            moved = truth @ common @ truth.inv
            table = Plane.through(moved @ middle, moved.rotation @ normal)
        better = replace(known, plane=table).on_it(one)
        assert (better.from_calibration == one.from_calibration).all()
        xi = (better.world_from_part.inv @ truth).log()
        squares.append(xi @ np.linalg.solve(better.covariance, xi))
        before.append(np.linalg.norm(one.world_from_part.translation - truth.translation))
        after.append(np.linalg.norm(better.world_from_part.translation - truth.translation))
    assert np.sqrt(np.mean(squares) / 6) < 1 + 3 / np.sqrt(12 * len(squares))  # true, or careful where it is not shared
    if shared:
        assert np.sqrt(np.mean(squares) / 6) > 1 - 3 / np.sqrt(12 * len(squares))
    assert np.median(after) < 0.8 * np.median(before)


def test_the_plane_counts_where_it_is_stated_how_well_it_is_known_and_the_answer_says_so() -> None:
    far = Rigid.look_at(np.array([150.0, -750.0, 1100.0]), np.zeros(3))
    truth = lying(30, -20, 65)
    photo = taken(BRACKET, truth, eye=far)
    told = ViewRange(on=OnPlane(TABLE, within_mm=0.5))
    alone, by_both = (locate_part(BRACKET, [photo], views=views) for views in (VIEWS, told))
    assert alone.found
    assert "by the plane" not in alone.reason
    assert "by the plane, known to 0.5 mm, as well: " in by_both.reason
    xi = (by_both.pose.world_from_part.inv @ truth).log()
    assert xi @ np.linalg.solve(by_both.pose.covariance, xi) < 2 * chi2.ppf(0.999, 6)
    assert by_both.pose.sigma_mm.max() < 0.5 * alone.pose.sigma_mm.max()
    (every,) = locate_instances(BRACKET, [photo], views=told)
    assert every.pose.sigma_mm.max() < 0.5 * alone.pose.sigma_mm.max()


def test_turns_that_no_photo_shows_remain_so_on_a_plane() -> None:
    part = Part.of(prism(96, radius=30.0, height=90.0))
    truth = Rigid(exp(np.array([0, np.pi / 2, 0])), [0.0, 0.0, 30.0])  # on its side
    told = ViewRange(on=OnPlane(TABLE, within_mm=0.2))
    found = locate_part(part, [taken(part, truth)], views=told)
    assert found.found, found.reason
    assert found.pose.undetermined.shape == (6, 1)
    middle = np.array([0.0, 0.0, 45.0])
    apart = (found.pose.world_from_part @ middle - truth @ middle)[2]
    known = found.pose.determined
    across = known.world_from_part.rotation @ known.point_covariance(middle[None])[0] @ known.world_from_part.rotation.T
    assert across[2, 2] < 0.2**2
    assert abs(apart) < 4 * np.sqrt(across[2, 2])


def test_small_ones_in_a_tray_are_found_with_the_plane() -> None:
    tray = [lying(x, y, 77 * k + 13) for k, (x, y) in enumerate([(-180, 150), (150, 160), (170, -120), (-160, -110)])]
    far = Rigid.look_at(np.array([150.0, -750.0, 1100.0]), np.zeros(3))
    photo = taken(BRACKET, *tray, eye=far)
    found = [one for one in locate_instances(BRACKET, [photo], views=VIEWS) if one.found]
    off = [[error_px(BRACKET, CAMERA, far @ one.pose.world_from_part, far @ pose) for pose in tray] for one in found]
    assert np.min(off, axis=1).max() < RIGHT_PX
    assert sorted(np.argmin(off, axis=1).tolist()) == [0, 1, 2, 3]


def test_a_symmetric_part_has_only_the_other_poses_in_which_it_lies_as_stated() -> None:
    brick = Part.of(box((0, 0, 0), (120, 70, 40)))
    truth = lying(-30, 10, 35)
    photo = taken(brick, truth)
    for down, count in ((None, 3), (np.array([0.0, 0.0, -1.0]), 1)):
        found = locate_part(brick, [photo], views=ViewRange(on=OnPlane(TABLE, down)))
        assert found.found, found.reason
        poses = [one.pose.world_from_part for one in (found, *found.alternatives)]
        assert len(poses) == 1 + count
        assert min(error_px(brick, CAMERA, EYE @ one, EYE @ truth) for one in poses) < RIGHT_PX
        lowest = [float((pose @ brick.scene.mesh.vertices)[:, 2].min()) for pose in poses]
        assert np.abs(lowest).max() < 1.0


def test_faces_on_which_a_part_looks_the_same_are_searched_once() -> None:
    for part, count in ((Part.of(box((0, 0, 0), (120, 70, 40))), 3), (Part.of(prism(32)), 2), (BRACKET, 4)):
        assert len(on(part, taken(BRACKET, lying(0, 0, 0))).searched) == count


def test_poses_are_laid_onto_the_plane_where_they_were_seen_and_climb_there() -> None:
    photo = taken(BRACKET, lying(0, 0, 30))
    known, rng = on(BRACKET, photo), np.random.default_rng(1)
    rough = [lying(20, -10, 40, up=15.0) @ Rigid.exp(rng.normal(0, [5, 5, 5, 0.1, 0.1, 0.1])) for _ in range(20)]
    laid = known.laid(np.array([row_of(pose) for pose in rough]), EYE.origin)
    middle = BRACKET.aspects.centre
    scales = Scales(BRACKET.aspects, [photo])
    climb = Climb(0, 64, (2.5, 1.5, 1.0, 1.0), 250)
    moved, _ = known.climbed(scales.stage(np.array([4.0])), laid, climb)
    assert np.abs(moved - laid).max() > 0.1
    for rows in (laid, moved):
        base = np.array([[0.0, 0, 0], [120, 0, 0], [0, 80, 0]])
        low = np.einsum("nij,kj->nki", rows[:, :9].reshape(-1, 3, 3), base)[..., 2] + rows[:, 11:]
        assert np.abs(low).max() < 1e-9 * 1000
    seen = [CAMERA.project(EYE @ pose @ middle) for pose in rough]
    there = [CAMERA.project(EYE @ (row[:9].reshape(3, 3) @ middle + row[9:])) for row in laid]
    assert np.abs(np.array(seen) - there).max() < 1e-9 * 1000


def test_views_and_distances_that_are_declared_restrict_a_search_on_a_plane_too() -> None:
    photo = taken(BRACKET, lying(0, 0, 30))
    scales = Scales(BRACKET.aspects, [photo])

    def swept(views: ViewRange) -> list[np.ndarray]:
        return [poses for _, poses, _, _ in lying_poses(scales, 0, on(BRACKET, photo, views), views, 2)]

    assert any((poses[:, 8] < -0.5).any() for poses in swept(VIEWS))
    assert not swept(replace(VIEWS, distance_mm=(100.0, 200.0)))
    near = replace(VIEWS, distance_mm=(880.0, 940.0))
    above = replace(VIEWS, half_angle_deg=60.0)
    for poses in swept(near):
        away = np.linalg.norm(scales.middles(poses) - EYE.origin, axis=1)
        assert ((away >= 880) & (away <= 940)).all()
    for poses in swept(above):
        assert (poses[:, 8] > -0.5).all()  # no bracket lies across its wall: it would be seen from below
    assert not unmade(BRACKET, [CAMERA], VIEWS)


def test_the_head_of_a_tracks_log_says_on_which_plane_it_was_searched() -> None:
    """By it a log is continued or refused; one of before there were planes says nothing of it."""
    photo = taken(BRACKET, lying(0, 0, 0))
    known = (OnPlane(TABLE), OnPlane(TABLE, within_mm=2.0), OnPlane(TABLE, np.array([0.0, 0, -1])))
    views = [ViewRange.above(), *(ViewRange(on=one) for one in known)]
    said = [head_of(BRACKET, [photo.viewpoint], views=one)["views"] for one in views]
    assert "on" not in said[0]
    assert said[1]["on"] == {"normal": [0.0, 0.0, 1.0], "offset_mm": 0.0, "down": None, "within_mm": None}
    assert said[1] != said[2] != said[3] != said[1]


def test_planes_that_no_photo_shows_are_refused() -> None:
    photo = taken(BRACKET, lying(0, 0, 0))
    for plane, said in (
        (Plane([0.0, 0.0, 1.0], 5000.0), "no photo shows"),
        (Plane.through(EYE.origin, [0.0, 0.0, 1.0]), "not below all cameras"),
    ):
        with pytest.raises(BadValue, match=said):
            locate_part(BRACKET, [photo], views=ViewRange(on=OnPlane(plane)))
    unlike = OnPlane(TABLE, np.array([1.0, 1.0, -1.0]))
    for wrong in (OnPlane(Plane([0.0, 0.0, 1.0], 5000.0)), unlike):  # not a part that is lost in every frame
        with pytest.raises(BadValue, match=r"no photo shows|no face within"):
            next(track_part(BRACKET, [Frame.of(0, photo)], views=ViewRange(on=wrong)))
    other = Photo.of(0.99 * photo.gray, CAMERA, Rigid.look_at(np.array([150.0, -450, -800]), np.zeros(3)))
    with pytest.raises(BadValue, match="not below all cameras"):
        locate_instances(BRACKET, [photo, other], views=VIEWS)


def test_every_place_on_the_plane_is_in_a_tile_that_is_searched() -> None:
    """Seen obliquely a part's size changes within a tile: its middle alone said over which field it is swept.

    Places in the tile of one field whose middle is of the next one's size, and in a tile of the next one's whose middle
    is of the first one's, were searched in neither.
    """
    eye = Rigid.look_at(np.array([-250.0, 90.0, 190.0]), np.array([55.0, 40.0, 0.0]))
    photo = taken(BRACKET, Rigid(), eye=eye)
    scales, known = Scales(BRACKET.aspects, [photo]), on(BRACKET, photo)
    asked, covered = 0, 0
    for reduction in scales.reductions(0):
        half = _half_tile(scales, 0, known, reduction)
        if half is None:
            continue
        field = scales.swept(0, reduction)
        x, y = (np.arange(0.0, side, 2.0) for side in field.camera.size)
        q = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
        q = q[_at_this_size(scales, 0, known, reduction, q)]
        centres = _centres(field, half)
        centres = centres[_reaches_this_size(scales, 0, known, reduction, centres, half)]
        asked += len(q)
        covered += int((np.abs(q[:, None] - centres).max(axis=2) <= half + 0.5).any(axis=1).sum())
    assert asked > 400
    assert covered == asked
