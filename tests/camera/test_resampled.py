"""A camera of scaled, binned or cut pictures projects where they show it, and measures with the same covariance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from cadcam.calibrate.points.camera import calibrate_camera
from cadcam.calibrate.rig.adjustment import RigCamera, calibrate_rig
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.camera.resampled import PictureMap, resampled_rig
from cadcam.camera.rig_estimate import RigEstimate
from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid

from ..calibrate.rigs import rig

CAMERA = Camera.from_focal((801, 600), 700.0, fy=695.0, cx=410.0, cy=290.0, skew=1.5, lens=BrownConrady(k1=-0.1))
MAPS = {
    "half": PictureMap.resized((801, 600), (400, 300)),
    "double": PictureMap.resized((801, 600), (1602, 1200)),
    "stretched": PictureMap.resized((801, 600), (400, 600), stretched=True),
    "binned": PictureMap.binned((801, 600), (2, 2)),
    "binned across": PictureMap.binned((801, 600), (3, 1)),
    "cut": PictureMap.cut((801, 600), (100, 50), (500, 400)),
}
each = pytest.mark.parametrize("to", MAPS.values(), ids=MAPS.keys())


def observed(rng: np.random.Generator, sigma_px: float | None = None) -> Observations:
    p = rng.uniform([-400, -300, 900], [400, 300, 1500], size=(30, 3))
    q = CAMERA.project(p) + rng.normal(scale=0.3, size=(30, 2))
    return Observations(p, q, tuple(map(str, range(30))), sigma_px)


def calibrated(seen: Observations, size: tuple[int, int] = CAMERA.size) -> CameraEstimate:
    return calibrate_camera(seen, size, lens=BrownConrady(k1=0.0), free_lens=("k1",))


@pytest.mark.parametrize(
    ("name", "size", "pixel"),
    [  # of old pixel (40, 21), by the pixels of the old picture that the new one's take together
        ("half", (400, 300), ((40.5 * 400 / 801 - 0.5), 10.25)),
        ("binned", (400, 300), (19.75, 10.25)),
        ("binned across", (267, 600), (40.5 / 3 - 0.5, 21.0)),
        ("cut", (500, 400), (-60.0, -29.0)),
    ],
)
def test_pixels_lie_where_the_new_picture_shows_them(
    name: str, size: tuple[int, int], pixel: tuple[float, float]
) -> None:
    ray = CAMERA.unproject(np.array([40.0, 21.0]))
    camera = MAPS[name].camera(CAMERA)
    assert camera.size == size
    np.testing.assert_allclose(camera.project(ray), pixel, atol=1e-9)


def test_binning_is_the_mean_of_pixels() -> None:
    """A ramp along x, binned by 3: each new pixel has the ramp's value at the place that the map says."""
    ramp = np.arange(801.0)
    binned = ramp[: 267 * 3].reshape(267, 3).mean(axis=1)
    new = (ramp + 0.5) / 3 - 0.5
    np.testing.assert_allclose(np.interp(np.arange(267), new, ramp), binned, atol=1e-9)
    camera = PictureMap.binned((801, 600), (3, 3)).camera(CAMERA)
    np.testing.assert_allclose(camera.principal_point, (CAMERA.principal_point + 0.5) / 3 - 0.5)


@each
def test_a_resized_estimate_is_that_of_resized_observations(to: PictureMap, rng: np.random.Generator) -> None:
    """Calibrated with the points in the new picture: the same camera and covariance."""
    seen = observed(rng)
    estimate, moved = calibrated(seen), to.estimate(calibrated(seen))
    assert moved.camera.size == to.size
    assert moved.camera.lens == estimate.camera.lens
    if to.scale[0] != pytest.approx(to.scale[1], rel=1e-2):
        return  # stretched, the residuals weigh otherwise
    again = calibrated(moved.observations, to.size)
    sd = np.sqrt(np.diag(again.covariance)) + 1e-300
    np.testing.assert_allclose(moved.values, again.values, atol=2e-2 * sd.max())
    free = np.isin(again.parameters, again.free)
    np.testing.assert_allclose(
        np.sqrt(np.diag(moved.covariance))[free], np.sqrt(np.diag(again.covariance))[free], rtol=1e-2
    )


@each
@pytest.mark.parametrize("sigma_px", [None, 0.25])
def test_what_is_measured_has_the_same_covariance_in_mm(
    to: PictureMap, sigma_px: float | None, rng: np.random.Generator
) -> None:
    """Rays of the same pixels err alike, but for the pixel's own noise, through either camera."""
    estimate = calibrated(observed(rng, sigma_px))
    moved = to.estimate(estimate)
    q = np.array([[200.0, 150.0], [390.0, 310.0], [550.0, 420.0]])
    there = (q + 0.5) * to.scale - 0.5 - to.origin
    of_old, of_new = (
        Viewpoint.placed("v", one, Rigid(), sigma_px=1e-6).ray_covariance(at)
        for one, at in ((estimate, q), (moved, there))
    )
    np.testing.assert_allclose(of_new, of_old, rtol=1e-6, atol=1e-9 * np.abs(of_old).max())
    np.testing.assert_allclose(moved.pose_covariance, estimate.pose_covariance, rtol=1e-9)
    p = estimate.observations.p_world[:4]
    D = np.diag(to.scale)
    np.testing.assert_allclose(
        moved.projection_covariance(p), D @ estimate.projection_covariance(p) @ D, rtol=1e-6, atol=1e-15
    )


@pytest.fixture(scope="module")
def mounted() -> RigEstimate:
    """Three cameras on a mount; the pictures of the third are of another size."""
    rng = np.random.default_rng(3)
    return calibrate_rig(rig(rng, 3, 5).seen(rng, {"left": 0.1, "right": 0.3, "top": 0.2}))


def test_a_resampled_rig_is_that_of_resampled_pictures(mounted: RigEstimate) -> None:
    """Calibrated with the points in the new pictures: the same cameras, mounts and covariances."""
    maps = {"left": PictureMap.binned((1280, 960), (2, 2)), "top": PictureMap.cut((1024, 1024), (30, 40), (900, 800))}
    moved = resampled_rig(mounted, maps)
    assert [camera.size for camera in moved.cameras] == [(640, 480), (1280, 960), (900, 800)]
    again = calibrate_rig(
        {
            name: RigCamera(views, camera.size, {"skew": 0.0}, BrownConrady(), ("k1", "k2"))
            for name, views, camera in zip(moved.names, moved.views, moved.cameras, strict=True)
        }
    )
    sd = np.sqrt(np.diag(again.covariance))
    np.testing.assert_allclose(moved.covariance / np.outer(sd, sd), again.covariance / np.outer(sd, sd), atol=2e-2)
    np.testing.assert_allclose(moved.by_frame / np.outer(sd, sd), again.by_frame / np.outer(sd, sd), atol=5e-2)
    np.testing.assert_allclose(moved.noise_px, again.noise_px, rtol=2e-2)
    for name in moved.names:
        for parameter, value in moved.values(name).items():
            assert value == pytest.approx(again.values(name)[parameter], abs=0.05 * moved.sigma(name, parameter) + 1e-9)
    np.testing.assert_allclose(moved.residuals[0][0], mounted.residuals[0][0] / 2, atol=1e-9)


def test_a_resampled_rig_measures_as_surely_as_before(mounted: RigEstimate) -> None:
    q = {"left": (600.0, 400.0), "right": (500.0, 480.0), "top": (512.0, 500.0)}
    maps = {"right": PictureMap.resized((1280, 960), (320, 480), stretched=True)}
    moved = resampled_rig(mounted, maps)
    there = {**q, "right": ((500.5) / 4 - 0.5, (480.5) / 2 - 0.5)}
    for views, pixels in zip(
        zip(mounted.viewpoints(sigma_px=1e-6), moved.viewpoints(sigma_px=1e-6), strict=True), q, strict=True
    ):
        of_old, of_new = (
            view.ray_covariance(np.array([at[pixels]])) for view, at in zip(views, (q, there), strict=True)
        )
        np.testing.assert_allclose(of_new, of_old, rtol=1e-6, atol=1e-9 * np.abs(of_old).max())
    assert moved.relative("left", "right").baseline_sigma() == mounted.relative("left", "right").baseline_sigma()
    with pytest.raises(UnknownName, match=r"'lef'.*did you mean 'left'"):
        resampled_rig(mounted, {"lef": maps["right"]})


def test_as_many_equations_as_unknowns_stay_without_noise(rng: np.random.Generator) -> None:
    seen = observed(rng)
    six = Observations(seen.p_world[:6], seen.q[:6], tuple("abcdef"))
    estimate = calibrate_camera(six, CAMERA.size, fixed={"skew": 0.0}, lens=BrownConrady(), free_lens=("k1", "k2"))
    moved = MAPS["binned"].estimate(estimate)
    assert not np.isfinite(moved.noise_px)
    np.testing.assert_array_equal(np.isinf(np.diag(moved.covariance)), np.isinf(np.diag(estimate.covariance)))


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: PictureMap.resized((801, 600), (400, 250)),
            r"400 x 250 px, in another ratio .* 400 x 300 or 334 x 250",
        ),
        (lambda: PictureMap.binned((801, 600), (0, 2)), "binning is 0 x 2"),
        (lambda: PictureMap.binned((801, 600), (2, 900)), "binning is 2 x 900"),
        (lambda: PictureMap.cut((801, 600), (400, 0), (500, 100)), r"cut is 500 x 100 px from \(400, 0\) on"),
        (lambda: PictureMap.cut((801, 600), (-1, 0), (500, 100)), "cut is"),
    ],
)
def test_what_no_such_picture_is_is_refused(make: Callable[[], PictureMap], message: str) -> None:
    with pytest.raises(BadValue, match=message):
        make()


@each
def test_a_viewpoint_of_the_new_picture_sees_the_same_and_errs_by_the_same(
    to: PictureMap, rng: np.random.Generator
) -> None:
    """Places, and what errors do to them, are those of the old picture, scaled; to rounding of a thousand px."""
    n = 11 + len(CAMERA.lens.parameters)
    source = ErrorSource("all", np.eye(n), object())
    view = Viewpoint("camera", CAMERA, Rigid(translation=np.array([5.0, -3.0, 400.0])), 0.3, ((source, np.eye(n)),))
    p = rng.uniform(-60, 60, (20, 3))
    q, by_point, (by_error,) = view.project(p)
    new_q, new_by_point, (new_by_error,) = to.viewpoint(view).project(p)
    scale = np.array(to.scale)
    assert to.viewpoint(view).camera.size == to.size
    assert to.viewpoint(view).sigma_px == pytest.approx(0.3 * to.noise)
    np.testing.assert_allclose(new_q, scale * (q + 0.5) - 0.5 - np.array(to.origin), atol=1e-9)
    np.testing.assert_allclose(new_by_point, scale[:, None] * by_point, atol=1e-9)
    np.testing.assert_allclose(new_by_error, scale[:, None] * by_error, rtol=1e-9, atol=1e-9 * np.abs(by_error).max())
