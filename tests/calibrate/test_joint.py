"""Joint calibration: exact data to rounding, the optimum against the thesis' routine, and what must be refused."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

from cadcam.calibrate.joint.adjustment import calibrate_jointly, fit_jointly
from cadcam.calibrate.joint.nested import nested_advice
from cadcam.calibrate.points.camera import calibrate_camera, locate_camera
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Division, Fisheye, Ideal, OddRadial
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, DegenerateGeometry, TooFewPoints, UnknownName
from cadcam.fit.robust import Loss
from cadcam.geometry.rigid import Rigid

from .scenes import SIZE, Scene, board, box, scene
from .thesis_mixtures import mixture

SKEWED = Camera.from_focal(SIZE, 1100, fy=1080, cx=655, cy=470, skew=4.0)
AFAR = np.array([1e6, -2e6, 3e5])  # mm
LENSES = [
    (Ideal(), ()),
    (BrownConrady(-0.2, 0.08, 1e-3, -5e-4, -0.01), ("k1", "k2", "p1", "p2", "k3")),
    (Division(-0.12), ("k",)),
    (Fisheye(-0.03, 0.004), ("k1", "k2")),
    (OddRadial(0.0, -0.15, 0.03), ("a3", "a5")),
]


@pytest.mark.parametrize(
    ("kind", "lens", "terms"),
    [
        pytest.param(kind, lens, terms, marks=[pytest.mark.slow] * (kind == "deep" and k > 1), id=f"{kind}-{lens.name}")
        for kind in ("flat", "deep", "mixed")
        for k, (lens, terms) in enumerate(LENSES)
    ],
)
def test_exact_views_give_back_camera_and_poses_without_a_guess(rng, lens, terms, kind):
    """To 1e-7 of the values: the pixels carry 1e-13, the internals see them through a condition of some thousands."""
    flat, deep = [board() for _ in range(5)], [box(rng, n) for n in (12, 40, 25)]
    fields = {"flat": flat, "deep": deep, "mixed": flat[:2] + deep[:2]}[kind]
    world = scene(rng, replace(SKEWED, lens=lens), fields)
    found = calibrate_jointly(world.seen(rng, 0.0), SIZE, lens=type(lens)(), free_lens=terms)
    assert found.rms_px < 1e-8
    assert np.abs(found.camera.K - world.camera.K).max() < 1e-3
    for name in terms:
        assert found.value(name) == pytest.approx(lens.parameters[name], abs=1e-6)
    for j, pose in enumerate(world.poses):
        assert found.pose(j).origin == pytest.approx(pose.origin, abs=1e-4)


def test_one_deep_view_is_the_single_calibration(rng):
    """The same optimum, the same covariance of internals and pose."""
    world = scene(rng, SKEWED, [box(rng, 30)])
    (view,) = world.seen(rng, 0.3)
    one, joint = calibrate_camera(view, SIZE), calibrate_jointly([view], SIZE)
    assert joint.view(0).values == pytest.approx(one.values, rel=1e-7, abs=1e-8)
    assert joint.sum_of_squares == pytest.approx(one.sum_of_squares, rel=1e-10)
    assert joint.dof == one.dof
    sd = np.sqrt(np.diag(one.covariance))
    assert joint.view(0).covariance / np.outer(sd, sd) == pytest.approx(one.covariance / np.outer(sd, sd), abs=1e-5)
    assert joint.by_view is None


def test_a_far_world_origin_changes_nothing(rng):
    """A ship's coordinates: a kilometre away the internals stay the same to 1e-6 px."""
    world = scene(rng, SKEWED, [box(rng) for _ in range(3)])
    views = world.seen(rng, 0.2)
    far = [replace(v, p_world=v.p_world + AFAR, sha256="") for v in views]
    near_by, far_off = calibrate_jointly(views, SIZE), calibrate_jointly(far, SIZE)
    assert np.abs(far_off.camera.K - near_by.camera.K).max() < 1e-4
    assert far_off.pose(1).origin == pytest.approx(near_by.pose(1).origin + AFAR, abs=1e-4)


def test_no_disturbed_start_ends_lower(rng):
    """Twenty guesses within 20 % of focal length and 100 px of the centre: none finds a lower sum of squares."""
    world = scene(rng, replace(SKEWED, lens=BrownConrady(-0.2, 0.05)), [board() for _ in range(6)])
    views = world.seen(rng, 0.3)
    found = calibrate_jointly(views, SIZE, lens=BrownConrady(), free_lens=("k1", "k2"))
    for _ in range(20):
        f, c = 1100 * rng.uniform(0.8, 1.2), np.array([639.5, 479.5]) + rng.uniform(-100, 100, 2)
        guess = Camera.from_focal(SIZE, f, cx=c[0], cy=c[1], lens=BrownConrady(rng.uniform(-0.3, 0.1)))
        other = calibrate_jointly(views, SIZE, lens=BrownConrady(), free_lens=("k1", "k2"), guess=guess)
        assert other.sum_of_squares >= found.sum_of_squares * (1 - 1e-9)


def test_a_view_in_the_wrong_one_of_its_two_poses_is_set_right(rng):
    """Small flat targets far away have two poses; a start in the wrong one is found out by its residual."""
    world = scene(rng, SKEWED, [board()] * 5 + [board(4, 4, 8.0)] * 3, tilt=0.5)
    views = world.seen(rng, 0.02)
    found = calibrate_jointly(views, SIZE)
    assert found.outlier_views() == ()
    assert "worse" not in repr(found)
    for j, pose in enumerate(world.poses):
        assert np.linalg.norm(found.pose(j).rotation - pose.rotation) < 0.05


def test_a_guess_that_puts_points_behind_the_camera_is_survived(rng):
    """Half the distance of the nearest points: linear poses under it may fail, the search for them does not."""
    deep = [rng.uniform(-1, 1, (30, 3)) * [150, 120, 200] for _ in range(4)]
    world = scene(rng, SKEWED, deep)
    views = world.seen(rng, 0.1)
    found = calibrate_jointly(views, SIZE, guess=Camera.from_focal(SIZE, 250))
    assert found.sum_of_squares == pytest.approx(calibrate_jointly(views, SIZE).sum_of_squares, rel=1e-9)


NESTED = [
    ({"skew": 0, "aspect": 1}, ()),
    ({"skew": 0}, ()),
    ({"skew": 0}, ("k1",)),
    ({"skew": 0}, ("k1", "k2")),
    ({"skew": 0}, ("k1", "k2", "p1", "p2", "k3")),
    ({}, ("k1", "k2", "p1", "p2", "k3")),
    ({}, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    ({}, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")),
]


def zhang(shared) -> list[Observations]:
    """Zhang's five views, 1998; inches made mm."""
    folder = shared("data/zhang_planar")
    X = 25.4 * np.loadtxt(folder / "Model.txt").reshape(-1, 2)
    X = np.column_stack([X, np.zeros(len(X))])
    return [Observations(X, np.loadtxt(folder / f"data{i}.txt").reshape(-1, 2), source=f"data{i}") for i in range(1, 6)]


def test_a_richer_model_never_ends_worse_than_what_it_contains(shared):
    """Eight nested models on real views, each without a guess, from the pinhole to rational and prism terms."""
    views, last = zhang(shared), np.inf
    for fixed, terms in NESTED:
        now = calibrate_jointly(views, (640, 480), fixed=fixed, lens=BrownConrady(), free_lens=terms).sum_of_squares
        assert now <= last * (1 + 1e-9)
        last = now


def test_zhangs_published_calibration_is_reproduced(shared):
    """alpha, gamma, beta, u0, v0, k1, k2 of the published file, to its last digits; view 3 stands out."""
    found = calibrate_jointly(zhang(shared), (640, 480), lens=BrownConrady(), free_lens=("k1", "k2"))
    K = found.camera.K
    published = [832.5, 0.204494, 832.53, 303.959, 206.585]
    assert [K[0, 0], K[0, 1], K[1, 1], K[0, 2], K[1, 2]] == pytest.approx(published, abs=6e-4)
    assert found.value("k1") == pytest.approx(-0.228601, abs=1e-6)
    assert found.value("k2") == pytest.approx(0.190353, abs=2e-6)
    assert found.pose(0).translation / 25.4 == pytest.approx([-3.84019, 3.65164, 12.791], abs=2e-4)
    assert [found.names[j] for j in found.outlier_views()] == ["data3"]


def test_an_independent_bundle_adjustment_with_free_points_is_reproduced(shared):
    """96 free dots, 4 fixed, 21 views: values and standard deviations of the published report, to its digits."""
    views = dbat_views(shared("data/dbat_camcal"))
    free = {n for v in views for n in v.names} - {"1001", "1002", "1003", "1004"}
    found = calibrate_jointly(
        views,
        (2272, 1704),
        fixed={"skew": 0, "aspect": 1},
        lens=BrownConrady(),
        free_lens=("k1", "k2", "p1", "p2", "k3"),
        control_sigma=dict.fromkeys(free, 1e4),
    )
    per_mm = 313.371
    assert found.value("focal") / per_mm == pytest.approx(7.45748, abs=1e-5)
    assert found.sigma("focal") / per_mm == pytest.approx(0.00107, abs=5e-6)
    assert (found.value("V0") + 0.5) / per_mm == pytest.approx(3.61634, abs=5e-6)
    assert found.sigma("V0") / per_mm == pytest.approx(0.000866, abs=5e-7)
    assert (found.value("U0") + 0.5) / per_mm == pytest.approx(2.60757, abs=5e-6)
    assert found.sigma("U0") / per_mm == pytest.approx(0.000986, abs=5e-7)
    assert found.correlation[found.free.index("k2"), found.free.index("k3")] == pytest.approx(-0.98, abs=0.002)
    assert found.pose(0).origin == pytest.approx([454.874, 1793.834, 1469.413], abs=1e-3)
    assert np.sqrt(np.diag(found.pose_covariance[0])[:3]) == pytest.approx([0.162, 0.187, 0.207], abs=5e-4)
    assert np.sqrt(found.sum_of_squares / 3726) == pytest.approx(0.162168, abs=1e-6)


def dbat_views(folder) -> list[Observations]:
    """The 21 photos of the camera calibration sheet; pixel corners made centres, metres mm."""

    def rows(name, skip):
        lines = (folder / "pmexports" / name).read_text().splitlines()[skip:]
        return [row for row in csv.reader(lines) if len(row) > 6]

    points = {r[0]: [1e3 * float(x) for x in r[3:6]] for r in rows("weighted-with-orient-3dpts.txt", 5)}
    points |= {"1001": [0, 1e3, 0], "1002": [1e3, 1e3, 0], "1003": [0, 0, 0], "1004": [1e3, 0, 0]}
    seen = rows("weighted-with-orient-2dpts.txt", 4)
    views = []
    for photo in sorted({int(r[1]) for r in seen}):
        own = [r for r in seen if int(r[1]) == photo]
        q = np.array([[float(r[2]), float(r[3])] for r in own]) - 0.5
        names = tuple(r[0] for r in own)
        views.append(Observations([points[n] for n in names], q, names, sigma_px=0.162168, source=f"photo {photo}"))
    return views


def test_tables_2_21_and_2_22_are_reproduced(points, size, golden):
    """Internals of one position in the other: as they are, and with the externals re-optimised (lower than printed)."""
    first, second = points("2_7", 1), points("2_7", 2)
    one, two = (calibrate_camera(v, size, method="dlt-c23") for v in (first, second))
    for name, own, other in (("fixedint.2.21.raw", one, two), ("fixedint.2.22.raw", two, one)):
        swapped = replace(other, camera=own.camera)
        assert swapped.thesis_residual == pytest.approx(golden(name)["value"], abs=golden(name)["tol"])
    totals = [
        0.5 * (one.thesis_residual + locate_camera(second, one.camera).thesis_residual),
        0.5 * (two.thesis_residual + locate_camera(first, two.camera).thesis_residual),
    ]
    assert totals == pytest.approx(golden("joint.alpha0.totals")["value"], abs=1e-5)
    assert locate_camera(second, one.camera).thesis_residual < 1.6  # printed: the thesis' optimiser had not arrived
    assert locate_camera(first, two.camera).thesis_residual < 1.2


def test_table_2_24_is_the_routine_at_a_half_and_the_joint_optimum_is_lower(points, size, golden):
    first, second = points("2_7", 1), points("2_7", 2)
    here, there = mixture(first, second, size, 0.5)
    total = 0.5 * (here.thesis_residual + there.thesis_residual)
    expected = golden("joint.alpha0.5")["value"]
    internals = here.extended_pinhole.vector[6:].copy()
    internals[2] = np.degrees(internals[2])
    assert internals == pytest.approx(expected["internals"], abs=1e-3)
    for found, name in ((here, "ext1"), (there, "ext2")):
        externals = found.extended_pinhole.vector[:6].copy()
        externals[3:] = np.degrees(externals[3:])
        assert externals == pytest.approx(expected[name], abs=5e-3)
    assert [here.thesis_residual, there.thesis_residual] == pytest.approx(expected["residuals"], abs=1e-5)
    assert total == pytest.approx(expected["total"], abs=1e-5)
    joint = calibrate_jointly([first, second], size)
    squares = here.sum_of_squares + there.sum_of_squares
    assert joint.sum_of_squares < 0.99 * squares
    assert joint.view_residuals.mean() < total


def test_a_bowed_board_is_measured_and_left_flat_it_spoils_the_camera(rng):
    """2 mm of bow: recovered within its sigmas; the flat model misses the focal length by many of its own."""
    bow = np.array([2.0, -0.7])
    flat = board()
    x = flat[:, :2] - (flat[:, :2].max(axis=0) + flat[:, :2].min(axis=0)) / 2
    bent = flat + np.array([0, 0, 1.0]) * ((1 - (x / x.max(axis=0)) ** 2) @ bow)[:, None]
    world = scene(rng, SKEWED, [bent] * 8)
    views = [replace(v, p_world=flat, sha256="") for v in world.seen(rng, 0.1)]
    found = calibrate_jointly(views, SIZE, bend=True)
    for name, true in (("bend_x", 2.0), ("bend_y", -0.7), ("focal", 1080.0)):
        assert abs(found.value(name) - true) < 4 * found.sigma(name)
    assert found.rms_px == pytest.approx(0.1, rel=0.1)
    assert found.residual == pytest.approx(np.sqrt(2) * found.rms_px)
    rigid = calibrate_jointly(views, SIZE)
    assert abs(rigid.value("focal") - 1080) > 5 * rigid.sigma("focal")
    with pytest.raises(BadValue, match="board to bend"):
        calibrate_jointly(scene(rng, SKEWED, [box(rng)] * 2).seen(rng, 0.1), SIZE, bend=True)


def test_control_points_within_their_covariance_move_to_where_they_are(rng):
    """Points known to 1 mm, seen to 0.1 px (0.04 mm): they come out ten times better, and the camera honest."""
    true = box(rng, 30)
    world = scene(rng, SKEWED, [true] * 6)
    wrong = true + rng.normal(size=true.shape)
    views = [replace(v, p_world=wrong, sha256="") for v in world.seen(rng, 0.1, stated=True)]
    found = calibrate_jointly(views, SIZE, control_sigma=1.0)
    aligned = _aligned(found.points[0], true)
    assert np.sqrt(np.mean((aligned - true) ** 2)) < 0.1
    for name, value in zip(("focal", "U0", "V0"), (1080, 470, 655), strict=True):
        assert abs(found.value(name) - value) < 4 * found.sigma(name)
    assert found.rms_px < 0.11
    assert calibrate_jointly(views, SIZE).rms_px > 1.0


def _aligned(p, onto):
    """Points after the similarity that the noise of the control leaves free."""
    a, b = p - p.mean(axis=0), onto - onto.mean(axis=0)
    U, s, Vt = np.linalg.svd(a.T @ b)
    return s.sum() / np.sum(a * a) * a @ (U @ Vt) + onto.mean(axis=0)


def test_a_prior_pulls_by_its_weight(rng):
    """Of a flat optimum: a prior of a tenth of sigma holds the value, one of ten sigmas leaves it."""
    world = scene(rng, SKEWED, [board() for _ in range(3)])
    views = world.seen(rng, 0.3, stated=True)
    free = calibrate_jointly(views, SIZE)
    sigma, value = free.sigma("V0"), free.value("V0")
    firm = calibrate_jointly(views, SIZE, priors={"V0": (value + sigma, sigma / 10)})
    assert firm.value("V0") == pytest.approx(value + sigma / 1.01, abs=0.05 * sigma)
    assert firm.sigma("V0") == pytest.approx(sigma / np.sqrt(101), rel=0.02)
    loose = calibrate_jointly(views, SIZE, priors={"V0": (value + sigma, 10 * sigma)})
    assert loose.value("V0") == pytest.approx(value + sigma / 101, abs=0.005 * sigma)


def test_as_many_equations_as_unknowns_need_a_stated_noise(rng):
    """Two views of four points, four internals: they fit exactly, so nothing but the user tells the noise."""
    plain = Camera.from_focal(SIZE, 1100, fy=1080, cx=655, cy=470)
    world = scene(rng, plain, [board(2, 2, 100.0)] * 2)
    with pytest.raises(TooFewPoints, match=r"at least 9 points; 8 given: .* state sigma_px"):
        calibrate_jointly(world.seen(rng, 0.01), SIZE, fixed={"skew": 0.0})
    views = world.seen(rng, 0.01, stated=True)
    found = calibrate_jointly(views, SIZE, fixed={"skew": 0.0})
    assert found.dof == 0
    assert abs(found.value("focal") - 1080) < 4 * found.sigma("focal")
    advice = nested_advice(fit_jointly(views, SIZE, fixed={"skew": 0.0}))
    assert not advice.questions
    assert "add points" in advice.recommendation


def test_noise_stated_for_some_views_only_is_refused(rng):
    """The stated one would have no effect: nothing tells how much the others weigh beside it."""
    views = scene(rng, SKEWED, [board() for _ in range(3)]).seen(rng, 0.3, stated=True)
    half = [views[0], replace(views[1], sigma_px=None), views[2]]
    with pytest.raises(BadValue, match=r"sigma_px of view 2 .* 2 of 3 views state theirs"):
        calibrate_jointly(half, SIZE)


def test_a_robust_loss_bears_wrong_points_and_names_the_bad_view(rng):
    """One point in fifteen 20 px off: with Tukey's loss the camera is as good as without them."""
    world = scene(rng, SKEWED, [board() for _ in range(8)])
    views = world.seen(rng, 0.2)
    clean = calibrate_jointly(views, SIZE)
    spoilt = []
    for v in views:
        q = v.q.copy()
        wrong = rng.random(len(q)) < 1 / 15
        q[wrong] += 20 * rng.normal(size=(wrong.sum(), 2))
        spoilt.append(replace(v, q=q, sha256=""))
    found = calibrate_jointly(spoilt, SIZE, loss=Loss("tukey"))
    assert abs(found.value("focal") - clean.value("focal")) < 1.0 * clean.sigma("focal")
    assert abs(calibrate_jointly(spoilt, SIZE).value("focal") - clean.value("focal")) > 3 * clean.sigma("focal")
    assert found.sigma("focal") == pytest.approx(clean.sigma("focal"), rel=0.25)
    bad = replace(views[4], q=views[4].q + 2.0 * rng.normal(size=views[4].q.shape), sha256="")
    told = calibrate_jointly([*views[:4], bad, *views[5:]], SIZE, loss=Loss("huber"))
    assert [told.names[j] for j in told.outlier_views()] == ["view05"]
    assert repr(told).endswith(", 1 view worse than the others: see .outlier_views())")


def test_views_that_cannot_do_it_are_refused_with_the_reason(rng):
    frontal = Scene(SKEWED, [Rigid(translation=[0, 0, z]) for z in (300, 400, 500)], [board()] * 3)
    with pytest.raises(DegenerateGeometry, match="do not determine"):
        calibrate_jointly(frontal.seen(rng, 0.1), SIZE)
    world = scene(rng, SKEWED, [board() for _ in range(4)])
    views = world.seen(rng, 0.1)
    row = slice(0, 9)
    line = Observations(views[2].p_world[row], views[2].q[row], source="thin")
    with pytest.raises(DegenerateGeometry, match=r"view 3 \(thin\) lie on a line"):
        calibrate_jointly([*views[:2], line, views[3]], SIZE)
    few = Observations(views[0].p_world[:3], views[0].q[:3])
    with pytest.raises(TooFewPoints, match="view 2"):
        calibrate_jointly([views[0], few], SIZE)
    with pytest.raises(DegenerateGeometry, match="do not determine"):
        calibrate_jointly(views[:1], SIZE)
    with pytest.raises(BadValue, match=r"view 5 .* is the same as view 2"):
        calibrate_jointly([*views, views[1]], SIZE)
    with pytest.raises(UnknownName, match="did you mean 'focal'"):
        calibrate_jointly(views, SIZE, fixed={"focl": 3})
    with pytest.raises(BadValue, match="sigma_px"):
        calibrate_jointly(views, SIZE, control_sigma=0.1)
    with pytest.raises(TooFewPoints, match="at least 1 view; 0 given"):
        calibrate_jointly([], SIZE)


def test_entries_of_the_camera_matrix_have_values_and_sigmas(rng):
    """With skew held at 0, fx = focal aspect: to first order its variance is that of the product."""
    camera = Camera.from_focal(SIZE, 1100, fy=1080, cx=655, cy=470)
    views = scene(rng, camera, [board()] * 5)
    found = calibrate_jointly(views.seen(rng, 0.1), SIZE, fixed={"skew": 0.0})
    fx, fy, cx, cy = (found.value(name) for name in ("fx", "fy", "cx", "cy"))
    assert (fx, fy, cx, cy) == pytest.approx((found.camera.fx, found.camera.fy, *found.camera.principal_point))
    by = np.array([{"aspect": fy, "focal": fx / fy}.get(name, 0.0) for name in found.free])
    assert found.sigma("fx") == pytest.approx(np.sqrt(by @ found.covariance @ by))
    assert found.sigma("fx", by_view=True) == pytest.approx(np.sqrt(by @ found.by_view @ by))
    assert [found.sigma("fy"), found.sigma("cx"), found.sigma("cy")] == [found.sigma(n) for n in ("focal", "V0", "U0")]
    with pytest.raises(UnknownName, match=r"unknown shared parameter 'f'.*fx"):
        found.sigma("f")
