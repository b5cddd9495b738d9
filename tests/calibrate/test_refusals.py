"""What cannot be calibrated is refused with its reason and numbers; beside each refusal stands what just passes."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.calibrate.joint.adjustment import calibrate_jointly
from cadcam.calibrate.points.camera import METHODS, calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.lens import BrownConrady, Fisheye, OddRadial
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, CadcamError, DegenerateGeometry, MirroredPoints, TooFewPoints, UnknownName
from cadcam.geometry.rigid import Rigid

SIZE = (768, 576)
CAMERA = Camera.from_focal(SIZE, 800.0, fy=790.0, cx=380.0, cy=290.0)
POSE = Rigid.look_at([100.0, 700.0, -300.0], [150.0, 220.0, -1200.0], up=(0.0, 0.0, 1.0))


@pytest.fixture
def cloud(rng):
    return rng.uniform(-1, 1, (12, 3)) * [150, 150, 150] + [150, 220, -1200]


def seen(p, *, camera=CAMERA, noise=0.0, rng=None, **options):
    q = camera.project(POSE @ p)
    return Observations(p, q if rng is None else q + noise * rng.normal(size=q.shape), **options)


def flat(p, thickness=0.0):
    """The cloud pressed onto the plane z = -1200."""
    return np.column_stack([p[:, :2], -1200 + thickness * (p[:, 2] + 1200)])


def test_the_cloud_itself_calibrates(cloud):
    estimate = calibrate_camera(seen(cloud), SIZE)
    assert pytest.approx(CAMERA.K, abs=1e-6) == estimate.camera.K
    assert estimate.thesis_residual < 1e-9


@pytest.mark.parametrize("method", METHODS)
def test_five_points_are_too_few_and_six_enough(cloud, method):
    with pytest.raises(TooFewPoints, match="needs at least 6 points; 5 given"):
        calibrate_camera(seen(cloud[:5]), SIZE, method=method)
    assert calibrate_camera(seen(cloud[:6]), SIZE, method=method).dof == 1


def test_a_pose_needs_four_points(cloud):
    with pytest.raises(TooFewPoints, match="needs at least 4 points; 3 given"):
        locate_camera(seen(cloud[:3]), CAMERA)
    assert locate_camera(seen(cloud[:4]), CAMERA).dof == 2


def test_the_same_point_twice_counts_once(cloud):
    with pytest.raises(TooFewPoints, match="12 points, 5 of them different"):
        calibrate_camera(seen(cloud[[0, 1, 2, 3, 4, 4, 4, 4, 3, 2, 1, 0]]), SIZE)
    assert calibrate_camera(seen(cloud[[0, 1, 2, 3, 4, 5, 5, 4, 3, 2, 1, 0]]), SIZE).dof == 13


def test_lens_terms_ask_for_more_points(cloud):
    with pytest.raises(TooFewPoints, match="13 parameters"):
        calibrate_camera(seen(cloud[:6]), SIZE, lens=BrownConrady(), free_lens=("k1", "k2"))
    assert calibrate_camera(seen(cloud), SIZE, lens=BrownConrady(), free_lens=("k1", "k2")).dof == 11


@pytest.mark.parametrize("method", METHODS)
def test_coplanar_points_give_no_full_calibration(cloud, method):
    with pytest.raises(DegenerateGeometry, match=r"on a plane .*thickness by length .*at most 8 of the 11"):
        calibrate_camera(seen(flat(cloud)), SIZE, method=method)


def test_coplanar_points_give_eight_parameters(cloud):
    K = CAMERA.K
    fixed = {"skew": 0.0, "aspect": K[0, 0] / K[1, 1], "U0": K[1, 2]}
    estimate = calibrate_camera(seen(flat(cloud)), SIZE, fixed=fixed)
    assert len(estimate.free) == 8
    assert estimate.value("focal") == pytest.approx(790.0, rel=1e-6)


def test_points_as_good_as_coplanar_are_refused_by_what_they_leave_open(cloud, rng):
    """A plate uneven by 0.3 % of its length, half a pixel of noise: no draw slips through with a wild focal length."""
    reasons = []
    for _ in range(8):
        with pytest.raises(DegenerateGeometry, match=r"as good as coplanar|no camera fits best") as refusal:
            calibrate_camera(seen(flat(cloud, 3e-3), noise=0.5, rng=rng), SIZE)
        reasons.append(str(refusal.value))
    assert any("thickness by length 0.00" in reason for reason in reasons)
    assert calibrate_camera(seen(flat(cloud, 0.3), noise=0.5, rng=rng), SIZE).sigma("focal") < 400


@pytest.mark.parametrize("solve", [lambda o: calibrate_camera(o, SIZE), lambda o: locate_camera(o, CAMERA)])
def test_collinear_points_are_refused(solve):
    line = np.outer(np.arange(8.0), [10, 20, -30]) + np.array([100, 150, -1150])
    with pytest.raises(DegenerateGeometry, match=r"on a line \(rms extents"):
        solve(seen(line))


def test_a_plane_and_a_line_through_the_camera_hide_a_combination(cloud):
    """Hartley and Zisserman, section 22: the camera can then move along the line while the plane's homography holds."""
    ray = np.array([150.0, 220.0, -1200.0]) - POSE.origin
    p = np.vstack([flat(cloud)[:8], POSE.origin + np.outer([0.8, 1.2], ray)])
    with pytest.raises(DegenerateGeometry, match="do not determine the combination"):
        calibrate_camera(seen(p), SIZE)
    aside = p + np.where(np.arange(10)[:, None] == 9, [30.0, 0, 0], 0)
    assert calibrate_camera(seen(aside), SIZE).thesis_residual < 1e-6


MIRRORS = {
    "left-handed world": lambda o: Observations(o.p_world * [1, 1, -1], o.q),
    "columns from the right": lambda o: Observations(o.p_world, o.q * [-1, 1] + [767, 0]),
    "rows from below": lambda o: Observations(o.p_world, o.q * [1, -1] + [0, 575]),
    "U and V exchanged": lambda o: Observations(o.p_world, o.q[:, ::-1]),
}


@pytest.mark.parametrize("mirror", MIRRORS.values(), ids=MIRRORS)
@pytest.mark.parametrize("method", METHODS)
def test_mirrored_points_are_refused_by_every_method(cloud, rng, mirror, method):
    with pytest.raises(MirroredPoints, match="left-handed or the image is mirrored"):
        calibrate_camera(mirror(seen(cloud, noise=0.3, rng=rng)), SIZE, method=method)


@pytest.mark.parametrize("mirror", [MIRRORS[k] for k in MIRRORS if k != "U and V exchanged"])
def test_mirrored_points_give_no_pose(cloud, rng, mirror):
    with pytest.raises(MirroredPoints, match="fit a mirrored camera"):
        locate_camera(mirror(seen(cloud, noise=0.3, rng=rng)), CAMERA)


def test_the_mirror_image_of_an_off_centre_camera_is_recognised_for_what_it_is(cloud, rng):
    """The message's residual is the noise only if principal point and skew were mirrored with the picture."""
    camera = Camera.from_focal(SIZE, 800.0, cx=150.0, cy=400.0, skew=25.0)
    o = seen(cloud, camera=camera, noise=0.3, rng=rng)
    with pytest.raises(MirroredPoints, match=r"residual 0\.[2-6]"):
        locate_camera(Observations(o.p_world * [1, 1, -1], o.q), camera)


def test_noise_alone_is_not_taken_for_a_mirror(cloud, rng):
    """Ten px of noise leave a poor fit, but the mirrored camera fits no better."""
    for _ in range(10):
        assert locate_camera(seen(cloud, noise=10.0, rng=rng), CAMERA).thesis_residual < 30


def test_nan_is_refused_with_the_name_of_its_point(cloud):
    p = cloud.copy()
    p[3, 1] = np.nan
    with pytest.raises(BadValue, match="Y of point 'bolt' is nan"):
        Observations(p, np.zeros((12, 2)), names=("a", "b", "c", "bolt", *"efghijkl"))


def test_a_coefficient_that_the_focal_length_explains_is_named(cloud):
    with pytest.raises(DegenerateGeometry, match=r"combination (a1 .* focal|focal .* a1)"):
        calibrate_camera(seen(cloud), SIZE, lens=OddRadial(), free_lens=("a1", "a3"))


def test_a_pixel_outside_the_lens_is_named(cloud):
    lens = Fisheye(0.0, -0.5)
    camera = Camera.from_focal(SIZE, 300.0, lens=lens)
    o = Observations(cloud, np.vstack([np.full((11, 2), 300.0), [[-900.0, 0.0]]]))
    with pytest.raises(BadValue, match="point '12'"):
        locate_camera(o, camera)


def test_points_and_pixels_that_do_not_belong_together_do_not_pass_unnoticed(cloud, rng):
    """Shuffled rows: either a refusal, or a residual and a named point that nobody overlooks."""
    o = seen(cloud)
    shuffled = Observations(o.p_world, rng.permutation(o.q))
    try:
        estimate = calibrate_camera(shuffled, SIZE)
    except DegenerateGeometry:
        return
    assert estimate.thesis_residual > 5
    assert estimate.worst()[1] > 10


BAD = [
    ({"fixed": {"foca": 800.0}}, UnknownName, "did you mean 'focal'"),
    ({"fixed": {"focal": -800.0}}, BadValue, "positive"),
    ({"fixed": {"X": np.inf}}, BadValue, "finite"),
    ({"fixed": {"b": 2.0}}, BadValue, "114.592 deg"),
    ({"method": "best"}, UnknownName, "calibration method"),
    ({"lens": BrownConrady(), "free_lens": ("k9",)}, UnknownName, "brown-conrady"),
    ({"method": "dlt", "fixed": {"skew": 0.0}}, BadValue, "reprojection"),
    ({"method": "dlt", "lens": BrownConrady(0.1)}, BadValue, "reprojection"),
]


@pytest.mark.parametrize(("options", "error", "words"), BAD)
def test_bad_arguments_are_named(cloud, options, error, words):
    with pytest.raises(error, match=words):
        calibrate_camera(seen(cloud), SIZE, **options)


def test_fixing_everything_leaves_nothing_to_do(cloud):
    with pytest.raises(BadValue, match="free parameters"):
        calibrate_camera(seen(cloud), SIZE, fixed=dict.fromkeys(NAMES, 1.0))


def test_different_points_at_one_pixel_have_no_camera(cloud):
    """A column of zeros in place of the pixels: a pose a million metres off would image them so."""
    nowhere = Observations(cloud, np.full((12, 2), 7.0))
    for call in (
        lambda: calibrate_camera(nowhere, SIZE),
        lambda: locate_camera(nowhere, CAMERA),
        lambda: calibrate_jointly([seen(cloud), nowhere], SIZE),
    ):
        with pytest.raises(DegenerateGeometry, match="at one pixel, x = 7, y = 7 px"):
            call()


def test_deep_points_on_a_line_of_the_picture_end_in_an_error_of_ours(cloud, rng):
    """A column of zeros: the linear start of a view has no inverse."""
    q = np.column_stack([rng.uniform(0, SIZE[0], (3, 12)).ravel(), np.zeros(36)]).reshape(3, 12, 2)
    with pytest.raises(CadcamError, match="points and pixels"):
        calibrate_jointly([Observations(cloud, view) for view in q], SIZE)
