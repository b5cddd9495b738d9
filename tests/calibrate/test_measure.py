"""Measuring: exact pixels give exact points, propagation is the derivative, nothing that cannot be measured is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from cadcam.calibrate.measure.points import measure_points
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.observations import Observations
from cadcam.camera.viewpoint import KnownMotion, Viewpoint
from cadcam.errors import BadValue, DegenerateGeometry, InconsistentViews, UnknownName
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid

from .cell import BENCH, EYES, FEW, POINT, SIGMA

CLOUD = np.random.default_rng(5).uniform([-100, -80, 10], [100, 80, 140], (12, 3))
STEP = Rigid.exp([250.0, -120.0, 60.0, 0.1, -0.15, 0.3])


@pytest.fixture(scope="module")
def estimates() -> list[CameraEstimate]:
    """One calibration of each camera."""
    rng = np.random.default_rng(3)
    return [eye.calibrated(rng) for eye in EYES]


@pytest.fixture(scope="module")
def views(estimates: list[CameraEstimate]) -> list[Viewpoint]:
    return [Viewpoint.fixed(name, e) for name, e in zip("abcd", estimates, strict=True)]


def seen(views: list[Viewpoint], p: np.ndarray) -> np.ndarray:
    """What the estimated cameras themselves would see: these pixels fit exactly."""
    return np.array([v.camera.project(v.camera_from_world @ p) for v in views])


@pytest.mark.parametrize("method", ["reprojection", "rays"])
@pytest.mark.parametrize("count", [2, 3, 4])
def test_pixels_without_error_give_the_points(views: list[Viewpoint], method: str, count: int) -> None:
    """Unprojection through a lens is good to 1e-13 of 1000 mm, magnified by the angle of the rays."""
    measured = measure_points(views[:count], seen(views[:count], CLOUD), method=method)
    assert measured.points == pytest.approx(CLOUD, abs=1e-8)
    assert measured.gap.max() < 1e-8
    assert measured.chi2.max() < 1e-12
    assert set(measured.dof) == {2 * count - 3}


@pytest.mark.parametrize("plane", [None, Plane(np.array([0.0, 0.0, 1.0]), np.array(70.0))])
def test_points_in_the_coordinates_of_a_map_are_those_near_the_origin(
    views: list[Viewpoint], plane: Plane | None, rng: np.random.Generator
) -> None:
    """Northings of 5000 km in mm: a coordinate is rounded to a micrometre, and the points move by some of those."""
    there = np.array([5e8, 5e9, 1e6])
    p = CLOUD if plane is None else np.column_stack([CLOUD[:, :2], np.full(len(CLOUD), 70.0)])
    q = seen(views, p) + 0.2 * rng.normal(size=(len(views), len(p), 2))
    poses = [v.camera_from_world for v in views]
    moved = [
        dataclasses.replace(v, camera_from_world=T @ Rigid(translation=-there))
        for v, T in zip(views, poses, strict=True)
    ]
    far = None if plane is None else Plane(plane.normal, plane.offset + plane.normal @ there)
    for sigma in (0.0, 0.1) if plane is not None else (0.0,):
        near = measure_points(views, q, plane=plane, plane_sigma_mm=sigma)
        found = measure_points(moved, q, plane=far, plane_sigma_mm=sigma)
        assert not found.refused
        assert found.points - there == pytest.approx(near.points, abs=20 * np.finfo(float).eps * 5e9)
        assert found.sigma == pytest.approx(near.sigma, rel=1e-6)


def test_a_moved_camera_measures_like_two_cameras(estimates: list[CameraEstimate]) -> None:
    home = Viewpoint.fixed("home", estimates[0])
    away = Viewpoint.moved("away", estimates[0], KnownMotion(STEP))
    centre = estimates[0].camera_from_world.origin
    assert away.camera_from_world.origin == pytest.approx(STEP @ centre, abs=1e-9)
    assert measure_points([home, away], seen([home, away], CLOUD)).points == pytest.approx(CLOUD, abs=1e-8)


@pytest.mark.parametrize("method", ["reprojection", "rays"])
def test_the_gain_is_the_derivative_by_the_pixels(views: list[Viewpoint], method: str) -> None:
    """Central differences over 0.02 px of noisy pixels; the gap's own share of the derivative is left out: 1e-3."""
    rng = np.random.default_rng(8)
    q = seen(views[:3], CLOUD[:1]) + SIGMA * rng.normal(size=(3, 1, 2))
    base = measure_points(views[:3], q, method=method)
    columns = []
    for v in range(3):
        for axis in range(2):
            h = np.zeros_like(q)
            h[v, 0, axis] = 0.01
            plus, minus = (measure_points(views[:3], q + s * h, method=method).points[0] for s in (1, -1))
            columns.append((plus - minus) / 0.02)
    G = np.array(columns).T
    from_pixels = SIGMA**2 * G @ G.T
    assert base.from_pixels[0] == pytest.approx(from_pixels, abs=2e-3 * np.trace(from_pixels))


def test_the_effect_of_a_calibration_is_the_derivative_by_its_numbers(estimates: list[CameraEstimate]) -> None:
    """Moving one number of the calibration moves the points as the effect says, at home and away together."""
    estimate = estimates[0]
    motion = KnownMotion(STEP)

    def measured(e: CameraEstimate):
        views = [Viewpoint.fixed("home", e), Viewpoint.moved("away", e, motion)]
        return measure_points(views, q)

    views = [Viewpoint.fixed("home", estimate), Viewpoint.moved("away", estimate, motion)]
    q = seen(views, CLOUD[:3])
    (source, E), *_ = measured(estimate).effects
    assert source.owner is estimate
    K = estimate.camera.K.copy()
    turned = estimate.camera_from_world.rotation @ Rigid.exp([0, 0, 0, 0, 1e-6, 0]).rotation
    shifted = estimate.camera_from_world.origin + np.array([0, 0, 1e-3])
    R = estimate.camera_from_world.rotation
    K[1, 2] += 1e-3
    for column, step, other in (
        (2, 1e-3, {"camera_from_world": Rigid(R, -R @ shifted)}),
        (4, 1e-6, {"camera_from_world": Rigid(turned, -turned @ estimate.camera_from_world.origin)}),
        (9, 1e-3, {"camera": dataclasses.replace(estimate.camera, K=K)}),
    ):
        moved = measured(dataclasses.replace(estimate, **other)).points - CLOUD[:3]
        assert moved / step == pytest.approx(E[:, :, column], rel=2e-3, abs=2e-3 * np.abs(E[:, :, column]).max())


@pytest.mark.parametrize("kind", ["moved", "placed", "located"])
def test_the_effect_of_a_motion_or_pose_is_the_derivative_by_its_twist(
    estimates: list[CameraEstimate], kind: str
) -> None:
    """Every number of xi in T @ exp(xi) by central differences; a located camera's by its pose's own local numbers."""
    home, other = estimates[0], estimates[1]
    there = home.camera_from_world @ STEP.inv
    pose = EYES[0].located(np.random.default_rng(2), home.camera, there, BENCH)
    known = np.diag([1e-2] * 3 + [1e-8] * 3)

    def views(xi: np.ndarray) -> list[Viewpoint]:
        if kind == "moved":
            away = Viewpoint.moved("away", home, KnownMotion(STEP @ Rigid.exp(xi), known))
        elif kind == "placed":
            away = Viewpoint.placed("away", home, there @ Rigid.exp(xi), pose_covariance=known)
        else:
            R, F = pose.camera_from_world.rotation, pose.camera_from_world.origin + xi[:3]
            R = R @ Rigid.exp([0, 0, 0, *xi[3:]]).rotation
            turned = dataclasses.replace(pose, camera_from_world=Rigid(R, -R @ F))
            away = Viewpoint.located("away", home, turned)
        return [away, Viewpoint.fixed("other", other)]

    q = seen(views(np.zeros(6)), CLOUD[:4])
    base = measure_points(views(np.zeros(6)), q)
    E = base.effects[1][1]
    assert E.any()
    for i, step in enumerate([1e-3] * 3 + [1e-6] * 3):
        plus, minus = (measure_points(views(s * step * np.eye(6)[i]), q).points for s in (1, -1))
        assert (plus - minus) / (2 * step) == pytest.approx(E[:, :, i], abs=2e-3 * np.abs(E[:, :, i]).max())


def test_points_measured_together_err_together(views: list[Viewpoint]) -> None:
    """A short distance is known better than independent points would have it; the joint covariance holds each alone."""
    p = POINT + np.array([[0.0, 0, 0], [5.0, 0, 0], [0, 5.0, 0]])
    sharp = [dataclasses.replace(view, sigma_px=0.05) for view in views[:2]]
    measured = measure_points(sharp, seen(sharp, p), names="ABC")
    joint = measured.joint_covariance()
    for i in range(3):
        assert joint[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] == pytest.approx(measured.covariance[i], rel=1e-12)
    assert np.linalg.eigvalsh(joint).min() > 0
    assert joint == pytest.approx(joint.T, abs=1e-9 * np.abs(joint).max())
    assert measured.joint_covariance("C", "A")[:3, 3:] == pytest.approx(joint[6:, :3], rel=1e-9)
    alone = np.sqrt(measured.covariance[0, 0, 0] + measured.covariance[1, 0, 0])
    length = measured.distance("A", "B")
    assert length.value == pytest.approx(5, abs=1e-8)
    assert length.sigma < 0.9 * alone


def test_the_budget_adds_up(estimates: list[CameraEstimate], views: list[Viewpoint]) -> None:
    motion = KnownMotion(STEP).known_to(0.1, 1e-4, about=estimates[0].camera_from_world.origin)
    both = [views[0], Viewpoint.moved("away", estimates[0], motion), views[1]]
    budget = measure_points(both, seen(both, CLOUD)).budget()
    assert set(budget) == {"pixels", "calibration", "motion to away"}
    total = measure_points(both, seen(both, CLOUD)).sigma
    assert np.sqrt(sum(s**2 for s in budget.values())) == pytest.approx(total, rel=1e-12)


def test_intervals_widen_where_the_noise_was_estimated(views: list[Viewpoint]) -> None:
    """Stated: Gauss. One calibration behind all: Student with its degrees of freedom. Two: Welch and Satterthwaite."""
    from scipy.special import stdtrit

    rng = np.random.default_rng(3)
    few = [eye.calibrated(rng, stated=False, targets=BENCH[FEW]) for eye in EYES[:2]]
    home, other = (Viewpoint.fixed(name, e) for name, e in zip(("home", "other"), few, strict=True))
    away = Viewpoint.moved("away", few[0], KnownMotion(STEP))

    def factor(pair: list[Viewpoint]) -> np.ndarray:
        measured = measure_points(pair, seen(pair, CLOUD))
        length = measured.distance("1", "2")
        return np.append((measured.half_width() / measured.sigma).ravel(), length.half_width / length.sigma)

    dof = few[0].dof
    assert dof == 16 - 11
    assert factor(views[:2]) == pytest.approx(np.full(37, stdtrit(1e9, 0.975)), rel=1e-9)
    assert factor([home, away]) == pytest.approx(np.full(37, stdtrit(dof, 0.975)), rel=1e-9)
    both = factor([home, other])
    assert np.all(both < stdtrit(dof * 1.001, 0.975))
    assert np.all(both > stdtrit(2 * dof + 1e-6, 0.975))


def test_a_poor_view_does_not_harm(estimates: list[CameraEstimate], views: list[Viewpoint]) -> None:
    """Weighted by what the motion is known to, a third view 5 mm off its place leaves the point as good as before."""
    poor = KnownMotion(STEP).known_to(5.0, 5e-3, about=estimates[2].camera_from_world.origin)
    three = [*views[:2], Viewpoint.moved("poor", estimates[2], poor)]
    with_it = measure_points(three, seen(three, CLOUD)).covariance
    without = measure_points(views[:2], seen(views[:2], CLOUD)).covariance
    assert np.linalg.eigvalsh(without - with_it).min() > -1e-12 * np.abs(without).max()


def test_the_weighted_optimum_is_at_least_as_sharp_as_the_rays(views: list[Viewpoint]) -> None:
    q = seen(views, CLOUD)
    sharp, rays = (measure_points(views, q, method=m).covariance for m in ("reprojection", "rays"))
    assert np.linalg.eigvalsh(rays - sharp).min() > -1e-9 * np.abs(rays).max()


@pytest.mark.parametrize("moved", [False, True])
def test_the_gap_is_as_wide_as_its_sigma_says(
    views: list[Viewpoint], estimates: list[CameraEstimate], moved: bool
) -> None:
    """For two rays gap^2/sigma^2 is the misfit, chi-square with one degree of freedom; to first order of the gap.

    A moved camera's calibration opens and closes the gap with both rays at once.
    """
    pair = [views[0], Viewpoint.moved("away", estimates[0], KnownMotion(STEP)) if moved else views[1]]
    q = seen(pair, CLOUD) + SIGMA * np.random.default_rng(4).normal(size=(2, 12, 2))
    measured = measure_points(pair, q)
    assert (measured.gap / measured.gap_sigma) ** 2 == pytest.approx(measured.chi2, rel=2e-2, abs=1e-4)


def test_a_wrong_pixel_is_named_and_the_rest_is_not(views: list[Viewpoint]) -> None:
    q = seen(views, CLOUD) + SIGMA * np.random.default_rng(4).normal(size=(4, 12, 2))
    q[2, 7] += [4.0, -3.0]
    measured = measure_points(views, q)
    assert measured.inconsistent() == ("8",)
    assert "1 whose rays miss each other: see .inconsistent()" in repr(measured)


def test_rays_know_their_own_covariance(views: list[Viewpoint]) -> None:
    """At the point seen, across the ray: pixel noise alone is sigma times distance by focal length, and more."""
    covariance = views[0].ray_covariance(seen(views[:1], CLOUD)[0])
    rays = views[0].rays(seen(views[:1], CLOUD)[0])
    distance = rays.along(CLOUD)
    blocks = np.concatenate([np.broadcast_to(np.eye(3), (12, 3, 3)), distance[:, None, None] * np.eye(3)], axis=-1)
    at_point = blocks @ covariance @ np.swapaxes(blocks, -1, -2)
    along = np.einsum("ni,nij,nj->n", rays.direction, covariance[:, 3:, 3:], rays.direction)
    P = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
    across = np.sqrt(np.linalg.eigvalsh(P @ at_point @ P)[:, -1])
    assert np.abs(along).max() < 1e-20
    assert np.all(across > SIGMA * distance / 1500 * 0.9)
    assert np.all(across < 10 * SIGMA * distance / 1500)


def test_a_camera_less_sure_of_its_place_and_direction_has_rays_as_much_less_sure(views: list[Viewpoint]) -> None:
    mm, rad = 0.3, 2e-4
    q = seen(views[:1], CLOUD)[0]
    rays, sure = views[0].rays(q), views[0].ray_covariance(q)
    added = views[0].less_sure(mm, rad, why="it was moved").ray_covariance(q) - sure
    P = np.eye(3) - rays.direction[:, :, None] * rays.direction[:, None, :]
    scale = np.abs(sure).max()
    np.testing.assert_allclose(added[:, :3, :3], np.broadcast_to(mm**2 * np.eye(3), P.shape), atol=1e-9 * scale)
    np.testing.assert_allclose(added[:, 3:, 3:], rad**2 * P, atol=1e-9 * rad**2)
    np.testing.assert_allclose(added[:, :3, 3:], 0, atol=1e-9 * mm * rad)
    with pytest.raises(BadValue, match="sigma_rad of viewpoint"):
        views[0].less_sure(0.1, -1e-3, why="of a stand that bends")


def test_one_ray_meets_a_plane_and_two_do_better(views: list[Viewpoint]) -> None:
    plane = Plane.through(POINT, [0.1, 0.2, 1.0])
    p = plane.foot(CLOUD)
    for exact in (0.0, 0.05):
        one = measure_points(views[:1], seen(views[:1], p), plane=plane, plane_sigma_mm=exact)
        two = measure_points(views[:2], seen(views[:2], p), plane=plane, plane_sigma_mm=exact)
        assert one.points == pytest.approx(p, abs=1e-8)
        assert np.abs(plane.distance(two.points)).max() < 1e-8
        assert np.all(np.trace(two.covariance, axis1=1, axis2=2) < np.trace(one.covariance, axis1=1, axis2=2))
        assert np.einsum("i,nij,j->n", plane.normal, one.covariance, plane.normal) == pytest.approx(
            np.full(12, exact**2), abs=1e-12
        )


def test_points_that_cannot_be_measured_are_refused_one_by_one(views: list[Viewpoint]) -> None:
    q = np.array(seen(views[:2], CLOUD))
    q[1, 3] = np.nan
    q[:, 5] = np.nan
    behind = views[0].camera_from_world.inv @ np.array([30.0, 20.0, -400.0])
    q[0, 8] = (views[0].camera.K @ (views[0].camera_from_world @ behind))[:2] / -400.0
    q[1, 8] = views[1].camera.project(views[1].camera_from_world @ behind)
    measured = measure_points(views[:2], q)
    assert len(measured) == 9
    assert "seen by 'a' only" in measured.refused["4"]
    assert measured.refused["6"] == "not seen"
    assert "behind 'a'" in measured.refused["9"]
    with pytest.raises(BadValue, match="not measured: seen by 'a' only"):
        measured.point("4")
    with pytest.raises(UnknownName):
        measured.point("99")


def test_rays_that_are_nearly_parallel_are_refused_with_the_angle(estimates: list[CameraEstimate]) -> None:
    home = Viewpoint.fixed("home", estimates[0])
    away = Viewpoint.moved("away", estimates[0], KnownMotion(Rigid(translation=[0.3, 0.1, 0.0])))
    with pytest.raises(DegenerateGeometry, match=r"nearly parallel \(0\.0\d* deg\).*is no measurement"):
        measure_points([home, away], seen([home, away], CLOUD))
    same = Viewpoint.exact("again", home.camera, home.camera_from_world, sigma_px=0.2)
    with pytest.raises(DegenerateGeometry, match="'home', 'again' stand at one place"):
        measure_points([home, same], seen([home, same], CLOUD))


WRONG = {
    "columns of all views": ("the two image columns of all views", lambda q: q[..., ::-1]),
    "columns of one view": ("the two image columns of view 'b'", lambda q: np.stack([q[0], q[1][:, ::-1], q[2]])),
    "rows upwards": ("the rows of all views are counted upwards", lambda q: np.stack([q[..., 0], 959 - q[..., 1]], -1)),
    "views exchanged": ("the pixels of views 'a' and 'c' are exchanged", lambda q: q[[2, 1, 0]]),
}


@pytest.mark.parametrize("wrong", WRONG.values(), ids=WRONG.keys())
def test_pixels_read_wrongly_are_named(views: list[Viewpoint], wrong) -> None:
    words, spoil = wrong
    q = seen(views[:3], CLOUD) + SIGMA * np.random.default_rng(1).normal(size=(3, 12, 2))
    with pytest.raises(InconsistentViews, match=words):
        measure_points(views[:3], spoil(q))
    assert len(measure_points(views[:3], q)) == 12


@pytest.mark.parametrize(
    ("words", "given"),
    [
        ("the motion to 'away' is given the other way round", STEP.inv),
        ("the motion to 'away' is in metres", Rigid(STEP.rotation, STEP.translation / 1000)),
        ("the camera of 'away' has not moved", None),
    ],
)
def test_a_motion_read_wrongly_is_named(estimates: list[CameraEstimate], words: str, given: Rigid | None) -> None:
    home = Viewpoint.fixed("home", estimates[0])
    third = Viewpoint.fixed("third", estimates[1])
    true = Viewpoint.moved("away", estimates[0], KnownMotion(STEP if given is not None else Rigid()))
    told = Viewpoint.moved("away", estimates[0], KnownMotion(STEP if given is None else given))
    q = seen([home, true, third], CLOUD)
    with pytest.raises(InconsistentViews, match=words):
        measure_points([home, told, third], q)


def test_a_camera_in_metres_is_named(views: list[Viewpoint], estimates: list[CameraEstimate]) -> None:
    pose = estimates[1].camera_from_world
    small = Viewpoint.exact("b", estimates[1].camera, Rigid(pose.rotation, pose.translation / 1000), sigma_px=SIGMA)
    with pytest.raises(InconsistentViews, match="the place of camera 'b' is in metres"):
        measure_points([views[0], small], seen(views[:2], CLOUD))


def test_a_misfit_that_nothing_explains_stays_in_the_result(views: list[Viewpoint]) -> None:
    q = seen(views[:2], CLOUD) + 20 * np.random.default_rng(1).normal(size=(2, 12, 2))
    measured = measure_points(views[:2], q)
    assert len(measured.inconsistent()) > 6


def test_what_is_not_asked_properly_is_refused(views: list[Viewpoint], estimates: list[CameraEstimate]) -> None:
    q = seen(views[:2], CLOUD)
    with pytest.raises(BadValue, match="2 viewpoints, 12 points"):
        measure_points(views[:2], q[:1], names=[str(i) for i in range(12)])
    half = q.copy()
    half[1, 4, 0] = np.nan
    with pytest.raises(BadValue, match=r"pixel \(column, row\) of point '5' from 'b'"):
        measure_points(views[:2], half)
    with pytest.raises(BadValue, match="each name once"):
        measure_points([views[0], views[0]], q)
    with pytest.raises(UnknownName, match="measuring method"):
        measure_points(views[:2], q, method="midpoint")
    with pytest.raises(BadValue, match="plane_sigma_mm"):
        measure_points(views[:2], q, plane=Plane([0.0, 0, 1], 1.0), plane_sigma_mm=-1)
    with pytest.raises(BadValue, match="pixel noise"):
        Viewpoint.exact("a", views[0].camera, views[0].camera_from_world, sigma_px=0.0)
    with pytest.raises(BadValue, match="sigma_mm of the motion"):
        KnownMotion(STEP).known_to(-1.0, 0.0, about=[0, 0, 0])
    with pytest.raises(BadValue, match="the located camera"):
        Viewpoint.located("a", estimates[0], estimates[1])


def test_a_calibration_of_unknown_noise_needs_it_stated(estimates: list[CameraEstimate]) -> None:
    e = estimates[0]
    few = Observations(BENCH[[0, 4, 8, 13, 18, 23]], e.observations.q[[0, 4, 8, 13, 18, 23]])
    unknown = dataclasses.replace(e, observations=few, free=e.free[:11])
    assert unknown.dof == 1
    exact = dataclasses.replace(unknown, observations=Observations(few.p_world[:5], few.q[:5]))
    with pytest.raises(BadValue, match="calibration noise"):
        Viewpoint.fixed("a", exact, sigma_px=0.2)
