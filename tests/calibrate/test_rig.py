"""Rigs: exact data to rounding, errors within their covariance, what a rig measures, and what must be refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, chi2

from cadcam.calibrate.joint.adjustment import fit_jointly
from cadcam.calibrate.measure.points import measure_points
from cadcam.calibrate.rig.adjustment import RigCamera, calibrate_rig
from cadcam.camera.extended_pinhole import internals_of
from cadcam.camera.observations import Observations
from cadcam.camera.rig_estimate import MOUNT, RigEstimate
from cadcam.errors import BadValue, DegenerateGeometry, InconsistentViews, TooFewPoints, UnknownName, UnreadableFile
from cadcam.files.rig import read_rig, write_rig
from cadcam.fit.robust import Loss
from cadcam.geometry.rigid import Rigid

from .rigs import Rig, reordered, rig, without


def errors(found: RigEstimate, world: Rig) -> np.ndarray:
    """True less estimated values of `parameters`; of mounts xi in camera_from_rig @ exp(xi)."""
    out = []
    for c, name in enumerate(found.names):
        camera = world.cameras[name]
        true = dict(zip(("aspect", "focal", "skew", "U0", "V0"), internals_of(camera.K), strict=True))
        true |= camera.lens.parameters
        out += [true[p] - found.values(name)[p] for p in found.free[c]]
        if c:
            out += (found.mount(name).inv @ world.mounts[name]).log().tolist()
    return np.array(out)


@pytest.mark.parametrize("cameras", [2, 3])
def test_exact_frames_give_back_cameras_mounts_and_poses_without_a_guess(rng, cameras):
    """To 1e-6 px, mm: the pixels carry 1e-13, the parameters see them through a condition of some thousands."""
    world = rig(rng, cameras, 5)
    found = calibrate_rig(world.seen(rng, 0.0))
    assert found.rms_px < 1e-8
    assert np.abs(errors(found, world)).max() < 1e-4
    for j, pose in enumerate(world.poses):
        assert found.frame(j).matrix == pytest.approx(pose.matrix, abs=1e-5)
    assert found.relative("left", "right").baseline == pytest.approx(np.linalg.norm([120, 3, 5]), abs=1e-5)


@pytest.mark.parametrize("cameras", [2, 3])
def test_errors_are_as_large_as_the_covariance_says(rng, cameras):
    """All parameters together, noise stated: chi-square within its 99.98 % interval; and each pose."""
    world = rig(rng, cameras, 8)
    found = calibrate_rig(world.seen(rng, 0.3, stated=True))
    e = errors(found, world)
    assert 1e-4 < chi2.sf(e @ np.linalg.solve(found.covariance, e), len(e)) < 1 - 1e-4
    for j, pose in enumerate(world.poses):
        xi = (found.frame(j).inv @ pose).log()
        assert chi2.sf(xi @ np.linalg.solve(found.pose_covariance[j], xi), 6) > 1e-5


QUANTITIES = ("baseline", "tx", "tz", "ry", "focal", "V0", "point")


def held(rng: np.random.Generator, rounds: int) -> dict[str, int]:
    """In how many of `rounds` rigs the 95 % interval holds the truth; noise unknown and unequal, new frames each."""
    inside = dict.fromkeys(QUANTITIES, 0)
    target = np.array([40.0, -30.0, 420.0])
    for _ in range(rounds):
        world = rig(rng, 2, 6)
        found = calibrate_rig(world.seen(rng, {"left": 0.15, "right": 0.4}))
        sd, e = np.sqrt(np.diag(found.covariance)), errors(found, world)
        for name in ("tx", "tz", "ry", "focal", "V0"):
            i = found.parameters.index(f"right.{name}")
            inside[name] += abs(e[i]) < 1.96 * sd[i]
        pose = found.relative("left", "right")
        off = pose.baseline - np.linalg.norm(world.mounts["right"].translation)
        inside["baseline"] += abs(off) < 1.96 * pose.baseline_sigma()
        q = [world.cameras[n].project(world.mounts[n] @ target) for n in found.names]
        q = [x + s * rng.normal(size=2) for x, s in zip(q, (0.15, 0.4), strict=True)]
        point = measure_points(found.viewpoints(), np.array(q)[:, None])
        d = point.points[0] - target
        inside["point"] += d @ np.linalg.solve(point.covariance[0], d) < chi2.ppf(0.95, 3)
    return inside


@pytest.mark.slow
def test_intervals_hold_as_often_as_they_say(rng):
    """24 rigs: each count within the 1e-4 tails of the binomial."""
    low, high = binom.ppf([1e-4, 1 - 1e-4], 24, 0.95)
    assert all(low <= count <= high for count in held(rng, 24).values())


@pytest.mark.slow
def test_intervals_hold_in_five_hundred_rigs():
    """Each share within 4 of its sigma, 0.0097."""
    shares = {name: count / 500 for name, count in held(np.random.default_rng(500), 500).items()}
    print(shares)
    assert max(abs(share - 0.95) for share in shares.values()) < 4 * 0.0097


def test_a_mount_is_better_known_than_from_cameras_calibrated_alone(rng):
    """Than the mean over frames of the relative poses of two joint calibrations, in every coordinate."""
    world = rig(rng, 2, 8)
    seen = world.seen(rng, 0.3, stated=True)
    found = calibrate_rig(seen)
    alone = {
        n: fit_jointly(c.views, c.size, fixed=c.fixed, lens=c.lens, free_lens=c.free_lens) for n, c in seen.items()
    }
    k = len(world.poses)
    mean = np.zeros((6, 6))
    Ad = world.mounts["right"].adjoint()
    for fit, J in ((alone["right"], np.eye(6)), (alone["left"], Ad)):
        for i in range(k):
            for j in range(k):
                mean += J @ (fit.known.own[i] if i == j else fit.known.between(i, j)) @ J.T / k**2
    back = world.mounts["right"].inv.adjoint()
    separate = np.sqrt(np.diag(back @ mean @ back.T))
    together = np.sqrt(np.diag(found.relative("left", "right").covariance))
    assert (together < separate).all()
    assert together[2] < 0.9 * separate[2]


def test_cameras_that_never_see_the_board_together_are_linked_by_a_third(rng):
    """left and top share no frame; right sees all: top's mount is found through it."""
    world = rig(rng, 3, 9)
    seen = world.seen(rng, 0.1)
    seen["left"], seen["top"] = without(seen["left"], 0, 1, 2, 3), without(seen["top"], 4, 5, 6, 7, 8)
    found = calibrate_rig(seen)
    xi = (found.mount("top").inv @ world.mounts["top"]).log()
    C = found.relative("left", "top").covariance
    assert chi2.sf(xi @ np.linalg.solve(C, xi), 6) > 1e-4
    assert np.isnan(found.view_residuals[0, 0])
    assert found.residuals[2][8] is None


def test_cameras_may_see_different_points(rng):
    """The left camera misses a third of the board, the right one another third."""
    world = rig(rng, 2, 6)
    seen = world.seen(rng, 0.2)
    for name, part in (("left", slice(16, None)), ("right", slice(0, 32))):
        views = [Observations(v.p_world[part], v.q[part]) for v in seen[name].views]
        seen[name] = replace(seen[name], views=views)
    found = calibrate_rig(seen)
    e = errors(found, world)
    assert chi2.sf(e @ np.linalg.solve(found.covariance, e), len(e)) > 1e-4


def test_which_camera_is_first_is_no_matter(rng):
    """The same optimum seen from the other camera: inverse mount, the same covariance carried over."""
    world = rig(rng, 2, 6)
    seen = world.seen(rng, 0.3)
    one, other = calibrate_rig(seen), calibrate_rig(dict(reversed(seen.items())))
    forth, back = one.relative("left", "right"), other.relative("left", "right")
    assert forth.b_from_a.matrix == pytest.approx(back.b_from_a.matrix, abs=1e-6)
    sd = np.sqrt(np.diag(forth.covariance))
    assert forth.covariance / np.outer(sd, sd) == pytest.approx(back.covariance / np.outer(sd, sd), abs=1e-4)


def test_a_known_camera_keeps_its_internals_and_sharpens_the_rest(rng):
    world = rig(rng, 2, 6)
    seen = world.seen(rng, 0.3)
    free = calibrate_rig(seen)
    seen["right"] = RigCamera(seen["right"].views, known=world.cameras["right"])
    found = calibrate_rig(seen)
    assert np.allclose(found.cameras[1].K, world.cameras["right"].K, rtol=1e-12)
    assert found.free[1] == ()
    assert found.sigma("right", "focal") == 0
    assert found.relative("left", "right").baseline_sigma() < free.relative("left", "right").baseline_sigma()


def test_each_camera_has_its_own_noise(rng):
    """A tenth: 96 points a frame give a sigma of 3 %."""
    found = calibrate_rig(rig(rng, 2, 8).seen(rng, {"left": 0.1, "right": 0.5}))
    assert found.noise_px == pytest.approx([0.1, 0.5], rel=0.1)


def test_a_robust_loss_bears_wrong_points(rng):
    world = rig(rng, 2, 6)
    seen = world.seen(rng, 0.1)
    views = list(seen["right"].views)
    q = views[2].q.copy()
    q[::7] += 15.0
    views[2] = Observations(views[2].p_world, q)
    seen["right"] = replace(seen["right"], views=views)
    plain, robust = calibrate_rig(seen), calibrate_rig(seen, loss=Loss("cauchy"))
    off = [abs(f.relative("left", "right").baseline - np.linalg.norm([120, 3, 5])) for f in (plain, robust)]
    assert off[1] < 0.3 < 10 * off[0]
    assert robust.outlier_frames() == (2,)
    assert "1 frame worse than the others: see .outlier_frames()" in repr(robust)


def test_what_a_rig_measures_errs_as_one(rng):
    """Both cameras name one source; the rig's error moves two near points alike: their distance is known better."""
    found = calibrate_rig(rig(rng, 2, 6).seen(rng, 0.3))
    left, right = found.viewpoints(sigma_px=0.05)
    assert left.errors[0][0].owner is right.errors[0][0].owner
    p = np.array([[0.0, 0, 450], [20, 0, 450]])
    measured = measure_points([left, right], np.stack([v.project(p)[0] for v in (left, right)]), names=("A", "B"))
    assert measured.points == pytest.approx(p, abs=1e-6)
    budget = measured.budget()["rig calibration"]
    assert measured.distance("A", "B").sigma < 0.5 * np.hypot(*measured.sigma[:, 2])
    assert (budget > 0).all()


def test_a_viewpoint_moves_with_the_mount_as_the_rig_does(rng):
    """Its derivatives against central differences of 1e-5 mm, rad, px: to 1e-6 of the largest; none of the other's."""
    found = calibrate_rig(rig(rng, 2, 5).seen(rng, 0.3))
    view, camera, p = found.viewpoints()[1], found.cameras[1], np.array([[30.0, -20, 450], [-60, 40, 400]])
    _, _, (by_source,) = view.project(p)
    for i, h in enumerate(1e-5 * np.eye(6)):
        forth, back = (camera.project(found.mount("right") @ Rigid.exp(s * h) @ p) for s in (1, -1))
        column = by_source[..., found.parameters.index(f"right.{MOUNT[i]}")]
        assert column == pytest.approx((forth - back) / 2e-5, abs=1e-6 * np.abs(column).max())
    focal = by_source[..., found.parameters.index("right.focal")]
    expected = (camera.project(found.mount("right") @ p) - camera.principal_point) / camera.fy
    assert focal == pytest.approx(expected, rel=1e-9)
    assert not by_source[..., : len(found.free[0])].any()


def test_viewpoints_take_the_scatter_between_frames_where_asked(rng):
    found = calibrate_rig(rig(rng, 2, 6).seen(rng, 0.3))
    view = found.viewpoints(by_frame=True)[1]
    assert view.errors[0][0].covariance == pytest.approx(found.by_frame)
    assert view.errors[0][0].dof == 5
    few = replace(found, by_frame=None)
    with pytest.raises(BadValue, match="too few frames"):
        few.viewpoints(by_frame=True)


def test_two_frames_whose_pictures_are_exchanged_are_named(rng):
    seen = rig(rng, 2, 8).seen(rng, 0.3)
    seen["right"] = reordered(seen["right"], [0, 1, 5, 3, 4, 2, 6, 7])
    with pytest.raises(InconsistentViews, match=r"(?s)in 2 of 8 frames.*3 \(left03 \| right06\).*exchanged"):
        calibrate_rig(seen)


@pytest.mark.parametrize(
    ("order", "says"),
    [([1, 2, 3, 4, 5, 6, 7, 0], "is the one 1 picture earlier"), ([7, 6, 5, 4, 3, 2, 1, 0], "in reverse order")],
)
def test_frames_in_another_order_are_refused_with_the_order_that_fits(rng, order, says):
    seen = rig(rng, 2, 8).seen(rng, 0.3)
    seen["right"] = reordered(seen["right"], order)
    with pytest.raises(InconsistentViews, match=says):
        calibrate_rig(seen)


def test_a_frame_in_which_the_cameras_are_exchanged_is_named(rng):
    seen = rig(rng, 2, 8).seen(rng, 0.3)
    left, right = list(seen["left"].views), list(seen["right"].views)
    left[4], right[4] = right[4], left[4]
    cameras = {"left": replace(seen["left"], views=left), "right": replace(seen["right"], views=right)}
    with pytest.raises(InconsistentViews, match=r"(?s)in 1 of 8 frames.*two cameras in frame 5 .* exchanged"):
        calibrate_rig(cameras)


def test_a_board_that_moved_between_the_pictures_of_a_frame_is_named(rng):
    """By 25 mm refused; by 1 mm, 0.2 % of the picture, marked as an outlier frame."""
    for shift, refused in ((25.0, True), (1.0, False)):
        world = rig(rng, 2, 8)
        seen = world.seen(rng, 0.1)
        q = world.cameras["right"].project(
            world.mounts["right"] @ world.poses[6] @ (world.points + np.array([shift, 0, 0]))
        )
        views = list(seen["right"].views)
        views[6] = Observations(world.points, q, source="right07")
        seen["right"] = replace(seen["right"], views=views)
        if refused:
            with pytest.raises(InconsistentViews, match=r"(?s)in 1 of 8 frames.*7 \(left07 \| right07\).*same moment"):
                calibrate_rig(seen)
        else:
            assert calibrate_rig(seen).outlier_frames() == (6,)


def test_what_cannot_be_a_rig_is_refused(rng):
    seen = rig(rng, 2, 6).seen(rng, 0.3)
    apart = {"left": without(seen["left"], 0, 1, 2), "right": without(seen["right"], 3, 4, 5)}
    with pytest.raises(DegenerateGeometry, match="no frame is seen by camera 'right' together with 'left'"):
        calibrate_rig(apart)
    short = replace(seen["right"], views=seen["right"].views[:5])
    with pytest.raises(BadValue, match="6 of camera 'left', 5 of camera 'right'"):
        calibrate_rig({"left": seen["left"], "right": short})
    with pytest.raises(BadValue, match="to the last bit what camera 'left' saw in left01"):
        calibrate_rig({"left": seen["left"], "right": seen["left"]})
    with pytest.raises(BadValue, match="2 or more"):
        calibrate_rig({"left": seen["left"]})
    with pytest.raises(TooFewPoints, match="'right' by itself"):
        calibrate_rig({"left": seen["left"], "right": without(seen["right"], *range(6))})
    alone = replace(without(seen["right"], 1, 2, 3, 4, 5), lens=None, free_lens=())
    with pytest.raises((TooFewPoints, DegenerateGeometry), match="camera 'right' by itself"):
        calibrate_rig({"left": seen["left"], "right": alone})
    with pytest.raises(BadValue, match="beside a known camera"):
        RigCamera(seen["left"].views, fixed={"skew": 0.0}, known=rig(rng).cameras["left"])
    found = calibrate_rig(seen)
    with pytest.raises(UnknownName, match="rigth"):
        found.mount("rigth")


def test_a_camera_that_saw_nothing_or_a_frame_that_none_saw_is_no_part_of_a_rig(rng):
    found = calibrate_rig(rig(rng, 2, 5).seen(rng, 0.3))
    blind = (found.views[0], (None,) * 5)
    with pytest.raises(BadValue, match=f"{found.names[1]!r}.*without anything seen"):
        replace(found, views=blind)
    dark = tuple((None, *views[1:]) for views in found.views)
    with pytest.raises(BadValue, match=f"{found.frames[0]!r}.*without anything seen"):
        replace(found, views=dark)


def test_a_rig_file_round_trips_to_the_last_bit(rng, tmp_path):
    seen = rig(rng, 3, 6).seen(rng, 0.3)
    seen["top"] = without(seen["top"], 1)
    found = calibrate_rig(seen)
    write_rig(tmp_path / "rig.json", found)
    again = read_rig(tmp_path / "rig.json")
    for name in ("names", "frames", "free", "dof", "method"):
        assert getattr(again, name) == getattr(found, name)
    for name in ("covariance", "by_frame", "pose_covariance", "noise_px", "view_residuals"):
        assert np.array_equal(getattr(again, name), getattr(found, name), equal_nan=True)
    assert np.array_equal(again.camera_from_rig.matrix, found.camera_from_rig.matrix)
    assert again.views[2][1] is None
    assert np.array_equal(again.views[2][2].q, found.views[2][2].q)


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('"version": 1', '"version": 2', "reads version 1"),
        ('"cadcam rig"', '"cadcam camera"', "only 'cadcam rig' is read here"),
        ('"residual_px": 0', '"residual_px": 1', "was edited"),
        ('"free": [', '"free": ["nose", ', "nose"),
        ('"covariance_of"', '"covariance_off"', "covariance_of"),
    ],
)
def test_a_rig_file_that_is_not_right_is_refused(rng, tmp_path, old, new, says):
    file = tmp_path / "rig.json"
    write_rig(file, calibrate_rig(rig(rng, 2, 5).seen(rng, 0.3)))
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises(UnreadableFile, match=says):
        read_rig(file)


def test_the_relative_pose_of_two_other_cameras_is_that_of_their_mounts(rng):
    """right to top of a rig of three: the same when the rig is counted from right."""
    seen = rig(rng, 3, 6).seen(rng, 0.3)
    one = calibrate_rig(seen).relative("right", "top")
    other = calibrate_rig({n: seen[n] for n in ("right", "left", "top")}).relative("right", "top")
    assert one.b_from_a.matrix == pytest.approx(other.b_from_a.matrix, abs=1e-6)
    sd = np.sqrt(np.diag(one.covariance))
    assert one.covariance / np.outer(sd, sd) == pytest.approx(other.covariance / np.outer(sd, sd), abs=1e-4)
    assert isinstance(one.b_from_a, Rigid)


def test_entries_of_a_camera_matrix_have_sigmas_on_a_rig_too(rng):
    """Noise stated: fx is focal times aspect where skew is next to nothing, and its variance that of the product."""
    found = calibrate_rig(rig(rng, 2, 6).seen(rng, 0.3, stated=True))
    for name in found.names:
        values = found.values(name)
        pair = [found.parameters.index(f"{name}.{p}") for p in ("aspect", "focal")]
        by = np.array([values["focal"], values["aspect"]])
        assert found.sigma(name, "fx") == pytest.approx(
            np.sqrt(by @ found.covariance[np.ix_(pair, pair)] @ by), rel=1e-3
        )
        assert found.sigma(name, "cx") == found.sigma(name, "V0")
        assert found.sigma(name, "fy", by_frame=True) == found.sigma(name, "focal", by_frame=True)
    with pytest.raises(UnknownName, match=r"unknown parameter of camera 'left' 'f'.*fx"):
        found.sigma("left", "f")
