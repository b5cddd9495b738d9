"""What a set of cameras is said to measure: against the prediction for points, and against trials."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

import cadcam
from cadcam.cad.mesh import Mesh
from cadcam.errors import BadValue
from cadcam.plan.assessment.assess import Outcome, assess, outcome
from cadcam.plan.layout import CandidateSurvey, plan_layout, survey
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, Mount, Sigmas
from cadcam.plan.sight.candidate import Candidate, calibrated, candidates
from cadcam.plan.uncertainty.finding import Finder
from cadcam.plan.uncertainty.predict import predict_points
from cadcam.plan.what_if import rebuilt, what_if
from cadcam.report.layout.words import assumptions
from cadcam.verify.tolerances.tolerance import Limit, Quantity, Rule
from cadcam.verify.tolerances.verdict import Verdict, decided

from .scenes import MIDDLE, features, position, ring, scene


def points_only(**changes: object) -> CandidateSurvey:
    """Return a survey of features without a normal: their pixels' noise is that of the finder, in focus."""
    places = ([60.0, 80, 10], [260.0, 60, 10], [315.0, 115, 90])
    marks = tuple(LayoutFeature(f"p{i}", Kind.POINT, np.array(p), position(0.3)) for i, p in enumerate(places))
    sharp = {"cam": replace(scene().cameras["cam"], f_number=None)}
    return survey(scene(9, features=marks, cameras=sharp, **changes))


@pytest.mark.parametrize("moved", [False, True], ids=["cameras of their own", "one camera that is moved"])
def test_points_are_assessed_as_they_are_predicted(moved: bool) -> None:
    seen = points_only(mounts=(replace(ring(9), one_camera=moved),))
    chosen = (0, 2, 4, 7)
    found = seen.assess(chosen)
    for i, pose in enumerate(seen.poses):
        p = pose @ seen.places.centre
        views = [seen.candidates[c].viewpoint for c in chosen]
        shown = np.array([seen.visibility[c].seen[i] for c in chosen])
        predicted = predict_points(views, p, seen=shown)
        several = shown.sum(axis=0) >= 2
        assert several.any()
        np.testing.assert_allclose(found.sigma[i][several], predicted.worst[several], rtol=1e-6)


def test_a_shared_calibration_is_not_averaged_away() -> None:
    exact = Sigmas()
    calibration = Sigmas(0.2, 1e-4, 0.5, 0.5)
    together, apart = (
        points_only(mounts=(replace(ring(9), one_camera=moved),), calibration=calibration, motion=exact).assess(
            range(9)
        )
        for moved in (True, False)
    )
    assert (together.sigma > apart.sigma).all()


@pytest.mark.parametrize("plane_mm", [None, 0.05])
def test_the_search_and_the_assessment_agree_where_no_errors_are_shared(plane_mm: float | None) -> None:
    """With the heights of marks unknown, and known so well that two cameras hardly know them better."""
    marks = tuple(replace(f, plane_mm=plane_mm) if f.kind is Kind.CIRCLE else f for f in features())
    seen = survey(scene(9, features=marks))
    chosen = (0, 2, 4, 7)
    exact, summed = seen.assess(chosen), seen.problem.ratios(chosen).reshape(2, -1)
    measured = np.isfinite(exact.sigma)
    assert measured.sum() >= 8
    np.testing.assert_allclose(summed[measured], exact.ratio[measured], rtol=1e-5)
    shared = survey(scene(9, mounts=(replace(ring(9), one_camera=True),)))
    assert not np.allclose(
        shared.problem.ratios(chosen).reshape(2, -1)[measured], shared.assess(chosen).ratio[measured]
    )


def test_the_shares_of_the_causes_add_up() -> None:
    seen = survey(scene(9, mounts=(replace(ring(9), one_camera=True),)))
    found = seen.assess((0, 2, 4, 7))
    measured = found.ratio > 0
    assert {"pixels", "calibration", "motion"} <= set(found.shares)
    np.testing.assert_allclose(sum(found.shares.values())[measured], 1.0, rtol=1e-6)


OBLIQUE = np.array([np.sqrt(3) / 2, 0, 0.5])  # at 30 deg to the edge, which runs along x


def test_an_edge_is_measured_in_a_direction() -> None:
    """A displacement along an oblique direction moves the edge across itself by half as much."""
    whole = features()[4]
    limits = tuple(position(0.2, d)[0] for d in (np.array([0.0, 0, 1]), OBLIQUE, np.array([0.0, 1, 0])))
    seen = survey(scene(9, features=(replace(whole, limits=(*position(0.2), *limits)),)))
    chosen = (0, 2, 6, 8)
    found = seen.assess(chosen)
    worst, up, oblique, aside = found.sigma.T
    assert (found.ratio > 0).all()
    np.testing.assert_allclose(oblique, 2 * up)
    assert ((worst >= np.maximum(up, aside) * (1 - 1e-9)) & (worst <= np.hypot(up, aside))).all()
    np.testing.assert_allclose(np.linalg.norm(found.direction, axis=-1), 1.0)
    np.testing.assert_allclose(sum(found.shares.values()), 1.0, rtol=1e-6)
    np.testing.assert_allclose(seen.problem.ratios(chosen).reshape(2, -1), found.ratio, rtol=1e-5)


def test_an_edge_is_measured_across_an_axis_as_far_as_across_itself() -> None:
    """Across z a displacement shows that is along y; across the edge itself, x, all that shows of it at all."""
    whole = features()[4]
    z, x = (Limit(Quantity.POSITION, 0.2, axis=axis) for axis in (np.eye(3)[2], np.eye(3)[0]))
    limits = (*position(0.2), *position(0.2, np.eye(3)[1]), z, x)
    seen = survey(scene(9, features=(replace(whole, limits=limits),)))
    chosen = (0, 2, 6, 8)
    found = seen.assess(chosen)
    worst, aside, across_z, across_x = found.sigma.T
    np.testing.assert_allclose(across_z, aside)
    np.testing.assert_allclose(across_x, worst)
    np.testing.assert_allclose(seen.problem.ratios(chosen).reshape(2, -1), found.ratio, rtol=1e-5)


def test_an_edge_is_not_measured_along_itself() -> None:
    with pytest.raises(BadValue, match="direction of front is along the edge; expected one across it"):
        replace(features()[4], limits=position(0.2, np.array([-1.0, 0, 0])))


def test_an_edge_s_place_and_direction_scatter_as_predicted() -> None:
    # each camera errs as a whole and sees the edge's stations with noise; a straight line is put through them
    seen = survey(scene(9, features=features()[4:], calibration=Sigmas(0.05, 5e-5, 0.3, 0.3)))
    chosen, pose = (0, 2, 6, 8), seen.poses[0]
    predicted = seen.assess(chosen)
    rng, n = np.random.default_rng(4), 500
    cameras = [seen.candidates[c] for c in chosen if seen.visibility[c].seen[0, 0]]
    assert len(cameras) >= 2
    shift, turn = (np.array([_line(camera, seen, pose, rng, n) for camera in cameras])[..., i] for i in range(2))
    for found, limit, data in ((predicted.sigma[0, 0], 0, shift), (predicted.sigma[0, 1], 1, turn)):
        A, weights = _rows(cameras, seen, limit)
        gain = np.linalg.solve(A.T @ (weights[:, None] * A), A.T * weights)
        estimates = gain @ data
        covariance = np.cov(estimates)
        spread = float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))
        # a standard deviation of n trials is good to 1/sqrt(2 n): three of these, and 5 % for perspective
        assert spread == pytest.approx(found, rel=3 / np.sqrt(2 * n) + 0.05)


def _normal(camera: Candidate, seen: CandidateSurvey) -> tuple[np.ndarray, np.ndarray]:
    """Return the direction (2,) across the edge's picture, and how it moves (2,) with the edge across itself."""
    view, (a, b) = camera.viewpoint, seen.places.ends[0]
    q, J, _ = view.project(np.array([a, (a + b) / 2, b]))
    along = q[2] - q[0]
    n = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    return n, n @ J[1][:, 1:]  # the edge runs along x: it can move in y and z


def _line(camera: Candidate, seen: CandidateSurvey, pose: object, rng: np.random.Generator, n: int) -> np.ndarray:
    """Return how far n lines lie off in the middle (px), and how much they turn (px by mm), (n, 2)."""
    view, stations = camera.viewpoint, seen.places.p
    _, _, effects = view.project(stations)
    normal, _ = _normal(camera, seen)
    off = np.zeros((n, len(stations)))
    for (source, _), D in zip(view.errors, effects, strict=True):
        t = source.root @ rng.normal(size=(len(source.covariance), n))
        off += np.einsum("sik,kn,i->ns", D, t, normal)
    sigma = seen.visibility[seen.candidates.index(camera)].sigma_px[0, 0]
    off += rng.normal(scale=sigma * np.sqrt(len(stations)), size=off.shape)
    x = seen.places.from_middle
    return np.stack([off.mean(axis=1), off @ x / (x @ x)], axis=-1)


def _rows(cameras: list[Candidate], seen: CandidateSurvey, limit: int) -> tuple[np.ndarray, np.ndarray]:
    """Return how each camera's number moves with the edge (V, 2), and its weight."""
    rows = np.array([_normal(c, seen)[1] for c in cameras])
    variances = []
    for c in cameras:
        o, (n, _) = seen.visibility[seen.candidates.index(c)], _normal(c, seen)
        S, evidence = (o.shift, o.evidence) if limit == 0 else (o.bend, o.turns)
        variances.append(n @ S[0, 0] @ n + 1 / (n @ evidence.W[0, 0] @ n))
    return rows, 1 / np.array(variances)


def test_a_calibration_from_points_is_that_of_calibrating() -> None:
    made = scene(1, calibration=CalibratedFrom(40, 0.1))
    candidate = candidates(made)[0]
    pose, camera = candidate.viewpoint.camera_from_world, candidate.camera
    sigma = np.sqrt(np.diag(calibrated(made, CalibratedFrom(40, 0.1), camera, pose, internals=True)))
    low, high = made.part.bounds
    rng = np.random.default_rng(2)
    spread = []
    for _ in range(4):  # as many points at random over the same picture and depth
        q = rng.uniform(-0.5, np.array(camera.size) - 0.5, (40, 2))
        corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
        depth = (pose @ corners)[:, 2]
        z = rng.uniform(depth.min(), depth.max(), 40)
        rays = camera.unproject(q)
        world = pose.inv @ (rays / rays[:, 2:] * z[:, None])
        points = cadcam.Observations(world, q, sigma_px=0.1)
        estimate = cadcam.calibrate_camera(points, size=camera.size, fixed={"aspect": 1.0, "skew": 0.0})
        spread.append([estimate.sigma(name) for name in ("X", "Y", "Z", "focal", "U0", "V0")])
    typical = np.median(spread, axis=0)
    assert np.all(np.abs(np.log(sigma[[0, 1, 2, 7, 9, 10]] / typical)) < np.log(1.6))


def test_one_camera_measures_on_a_known_plane_and_not_off_it() -> None:
    on_plane = replace(features()[1], plane_mm=0.1)
    one = survey(scene(features=(on_plane, features()[3]), mounts=(ring(1),), choose=1))
    found = one.assess((0,))
    assert np.isfinite(found.sigma[:, 0]).all()
    assert np.isnan(found.sigma[:, 1]).all()
    assert found.shares["plane"][0, 0] > 0
    # of the height only the slant of the view reaches the place on the plane
    slant = np.tan(one.visibility[0].incidence[0, 0])
    assert found.shares["plane"][0, 0] * found.sigma[0, 0] ** 2 == pytest.approx((0.1 * slant) ** 2, rel=0.05)


@pytest.mark.parametrize("rule", list(Rule))
@pytest.mark.parametrize("ratio", [0.5, 0.99, 1.01, 2.9, 3.1, 10.0])
def test_an_outcome_promises_what_verify_would_decide(rule: Rule, ratio: float) -> None:
    limit = Limit(Quantity.POSITION, 1.0, rule=rule)
    sigma = limit.value / (limit.k * ratio)
    can_pass = decided(0.0, sigma, limit) is Verdict.PASS
    said = outcome(ratio, limit, wanted=5.0)
    assert (said in (Outcome.SUITABLE, Outcome.MARGINAL)) == can_pass
    assert (said is Outcome.SUITABLE) == (can_pass and ratio >= 5.0)
    assert outcome(0.0, limit, wanted=3.0) is Outcome.NOT_MEASURED


def test_another_distance_moves_cameras_along_their_axes() -> None:
    layout = plan_layout(scene(8))
    for before, after in zip(layout.cameras, rebuilt(layout.survey.scene, layout.cameras, stretch=0.8), strict=True):
        np.testing.assert_allclose(after.eye - after.aim, 0.8 * (before.eye - before.aim), atol=1e-9)
        assert (after.optics.distance_mm, before.optics.distance_mm) == pytest.approx((912.1, 1140.2), abs=0.1)


def test_a_moved_camera_rebuilt_is_still_calibrated_at_the_first_place_of_its_mount() -> None:
    """Without any change the table compares with the plan itself, also where that place is not chosen."""
    seen = survey(scene(9, mounts=(replace(ring(9), one_camera=True),), calibration=CalibratedFrom(30, 0.1, 0.1)))
    chosen = [seen.candidates[i] for i in (2, 4, 7)]
    again = rebuilt(seen.scene, chosen)
    found = assess(again, [seen.visibility[i] for i in (2, 4, 7)], seen.places, seen.poses, seen.asked)
    np.testing.assert_allclose(found.sigma, seen.assess((2, 4, 7)).sigma, rtol=1e-9)


def test_what_one_camera_sees_is_not_measured_however_badly_it_is_calibrated() -> None:
    """Calibration errors take most of the information away; what rounding leaves of it along the ray is nothing."""
    calibrations = Sigmas(3.0, 3e-3, 10.0, 10.0), Sigmas(0.03, 3e-5, 0.2, 0.3), CalibratedFrom(8, 1.0, 1.0)
    for calibration in calibrations:
        seen = survey(scene(8, calibration=calibration))
        lonely = 0
        for pair in combinations(range(8), 2):
            found = seen.assess(pair)
            alone = found.cameras < 2
            lonely += int(alone.sum())
            assert (found.ratio[alone] == 0).all()
            assert np.isnan(found.sigma[alone]).all()
        assert lonely > 50


def test_focal_length_is_not_known_from_points_in_one_plane() -> None:
    """A sheet seen straight on: focal length and distance are known only together, so nearer poses are uncertain.

    As for a camera that is hardly tilted; a pseudo-inverse would call the two known exactly, straight on alone.
    """
    flat = Mesh.single([[0.0, 0, 0], [400, 0, 0], [400, 300, 0], [0, 300, 0]], [[0, 1, 2], [0, 2, 3]])
    mark = LayoutFeature("m", Kind.POINT, np.array([60.0, 80, 0]), position(1.0), normal=np.array([0.0, 0, 1]))
    poses = {"flat": cadcam.Rigid(), "nearer": cadcam.Rigid(np.eye(3), [0.0, 0, 20])}

    def sigma(tilt: float) -> np.ndarray:
        eyes = np.array([[200.0, 150 - tilt, 1000], [300.0, 150 - tilt, 1000]])
        mounts = (Mount("m", eyes, eyes * (1, 0, 0) + [0, 150, 0], ("cam",)),)
        made = scene(part=flat, features=(mark,), poses=poses, mounts=mounts, calibration=CalibratedFrom(30, 0.1))
        return survey(made).assess((0, 1)).sigma[:, 0]

    straight, tilted = sigma(0.0), sigma(0.01)
    np.testing.assert_allclose(straight, tilted, rtol=0.01)
    assert straight[1] > 10 * straight[0]


def test_what_if_of_a_calibrated_camera_changes_its_own_calibration() -> None:
    """A perfect one leaves the pixels' noise alone; half as good is twice the share of its internals."""
    rng = np.random.default_rng(3)
    camera, pose = cadcam.Camera.from_focal((2448, 2048), 4600.0), cadcam.Rigid.look_at([0.0, -900, 700], MIDDLE)
    p = rng.uniform([0, 0, 0], [400, 300, 120], (20, 3))
    q = camera.project(pose @ p) + rng.normal(0, 0.1, (20, 2))
    estimate = cadcam.calibrate_camera(cadcam.Observations(p, q, sigma_px=0.1), size=camera.size)
    own = CameraType("cam", own=estimate.camera, estimate=estimate)
    layout = plan_layout(scene(8, cameras={"cam": own}, calibration=Sigmas(), features=features()[:2]))
    table = {w.change: w for w in what_if(layout)}
    exact = replace(layout.survey.scene, cameras={"cam": CameraType("cam", own=own.own)})
    assert table["a perfect calibration"].worst == pytest.approx(survey(exact).assess(layout.chosen).worst)
    twice = replace(own, estimate=replace(estimate, cofactor=4 * estimate.cofactor))
    worse = survey(replace(layout.survey.scene, cameras={"cam": twice}))
    assert table["a calibration half as good"].worst == pytest.approx(worse.assess(layout.chosen).worst)
    assert table["a perfect calibration"].worst > 1.1 * table["as planned"].worst
    assert "internals err as the camera file states instead, alike wherever" in " ".join(assumptions(layout))


def test_half_as_good_is_twice_the_error_also_of_a_calibration_that_is_shared() -> None:
    """By two types of one file, and by the views of one joint calibration."""
    rng = np.random.default_rng(3)
    camera, p = cadcam.Camera.from_focal((2448, 2048), 4600.0), rng.uniform([0, 0, 0], [400, 300, 120], (20, 3))
    views = []
    for x in (-300.0, 0.0, 300.0):
        pose = cadcam.Rigid.look_at([x, -900, 700], MIDDLE)
        views.append(cadcam.Observations(p, camera.project(pose @ p) + rng.normal(0, 0.1, (20, 2)), sigma_px=0.1))
    own = cadcam.calibrate_jointly(views, size=camera.size).view(0)
    types = {name: CameraType(name, own=own.camera, estimate=own) for name in ("a", "b")}
    mounts = (replace(ring(6), cameras=("a",)), replace(ring(5), name="other", cameras=("b",)))
    made = scene(cameras=types, mounts=mounts, calibration=Sigmas(), motion=Sigmas(), features=features()[:2])
    layout = plan_layout(replace(made, finder=Finder(sigma_px=1e-4)), 4)
    assert {c.type.name for c in layout.cameras} == {"a", "b"}
    table = {w.change: w for w in what_if(layout)}
    assert table["as planned"].worst > 0
    assert table["a calibration half as good"].worst == pytest.approx(table["as planned"].worst / 2, rel=1e-3)


def test_what_if_says_what_planning_anew_says() -> None:
    layout = plan_layout(scene(8))
    table = {w.change: w for w in what_if(layout)}
    noisy = survey(replace(layout.survey.scene, finder=Finder(sigma_px=0.1)))
    assert table["twice the noise"].worst == pytest.approx(noisy.assess(layout.chosen).worst)
    assert table["as planned"].worst == layout.assessment.worst
    lost = [i for i in layout.chosen if i != layout.chosen[0]]
    name = f"without {layout.cameras[0].name}"
    assert table[name].worst == pytest.approx(layout.survey.assess(lost).worst)
    assert table["half the noise"].worst >= table["as planned"].worst >= table["twice the noise"].worst
