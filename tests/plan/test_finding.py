"""The law of how well marks are found: its integrals, its limits, and a picture that is fitted."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import sensor_format
from cadcam.errors import BadValue
from cadcam.plan.uncertainty.finding import (
    Finder,
    circle_covariance,
    defocus,
    edge_variance,
    outline,
    point_covariance,
)


@pytest.mark.parametrize(
    "A",
    [
        np.diag([9.0, 9.0]),
        np.diag([9.0, 8.9997]),  # by the series
        np.diag([9.0, 8.99]),
        np.array([[3.0, 7.0], [-2.0, 1.0]]),
        np.diag([2.0, 30.0]),
    ],
)
def test_the_closed_form_of_an_outline_is_its_integral(A: np.ndarray) -> None:
    t = 2 * np.pi * (np.arange(20000) + 0.5) / 20000
    along = A @ np.stack([-np.sin(t), np.cos(t)])
    normal = np.stack([along[1], -along[0]]) / np.hypot(*along)
    integral = (normal * np.hypot(*along)) @ normal.T * (2 * np.pi / len(t))
    sums, a = outline(A)
    np.testing.assert_allclose(sums, integral, rtol=1e-6, atol=1e-6)
    assert a == pytest.approx(np.linalg.svd(A)[1][0])


def test_blur_of_many_distances_is_that_of_the_optics() -> None:
    optics = Optics(sensor_format("IMX264"), 16.0, 1500.0, 4.0)
    z = np.array([900.0, 1500.0, 2500.0])
    disc = np.array([optics.defocus_px(float(d)) for d in z])
    np.testing.assert_allclose(defocus(optics, z), disc)
    for finder, in_focus in (
        (Finder(sigma_px=1.0, blur_px=0.0), optics.airy_sigma_px() ** 2 + 1 / 12),
        (Finder(sigma_px=1.0, blur_px=0.7), 0.7**2),
    ):
        np.testing.assert_allclose(finder.blur(optics, z) ** 2, disc**2 / 16 + in_focus)
        assert finder.blur(None, 1.0) ** 2 == pytest.approx(max(finder.blur_px**2, 1 / 12))


def test_the_covariance_of_a_disc_is_the_cramer_rao_bound_of_its_picture() -> None:
    # an ellipse drawn with a Gaussian edge: Fisher information of its centre from all pixels, by differences
    A, blur, grey, contrast = np.array([[9.0, 2.0], [1.0, 5.0]]), 0.9, 0.02, 0.6

    def picture(dx: float, dy: float) -> np.ndarray:
        from scipy.ndimage import gaussian_filter

        fine = 8
        sub = (np.arange(41 * fine) + 0.5) / fine - 20.5
        X, Y = np.meshgrid(sub - dx, sub - dy)
        inside = (np.linalg.norm(np.einsum("ij,jkl->ikl", np.linalg.inv(A), np.stack([X, Y])), axis=0) < 1) * contrast
        smooth = gaussian_filter(inside, blur * fine, truncate=6)
        return smooth[fine // 2 :: fine, fine // 2 :: fine]

    step = 0.25
    slopes = np.stack([(picture(step, 0) - picture(-step, 0)), (picture(0, step) - picture(0, -step))]) / (2 * step)
    information = np.einsum("iyx,jyx->ij", slopes, slopes) / grey**2
    found = circle_covariance(Finder(gray=grey, contrast=contrast), A, blur, sharp_px=blur)
    # the law takes the outline for straight over the blur: off by (blur/radius)^2, and differences by (step/blur)^2/6
    np.testing.assert_allclose(np.linalg.inv(found), information, rtol=0.06, atol=0.03 * np.trace(information))


def test_slant_costs_along_the_long_axis_only_and_blur_both() -> None:
    finder = Finder(sigma_px=0.05)
    facing = circle_covariance(finder, np.diag([10.0, 10.0]), 0.5, sharp_px=0.5)
    np.testing.assert_allclose(facing, 0.05**2 * np.eye(2))
    slanted = circle_covariance(finder, np.diag([10.0, 5.0]), 0.5, sharp_px=0.5)
    assert slanted[0, 0] > 2 * facing[0, 0]
    assert (
        0.7 * facing[1, 1] < slanted[1, 1] < facing[1, 1]
    )  # along the short one the outline runs across: a little better
    blurred = circle_covariance(finder, np.diag([10.0, 10.0]), 2.0, sharp_px=0.5)
    np.testing.assert_allclose(blurred, 4 * facing)


def test_an_edge_twice_as_long_is_known_twice_as_well() -> None:
    finder = Finder(gray=0.01, contrast=0.5)
    one, two = edge_variance(finder, [50.0, 100.0], 0.7, sharp_px=0.7)
    assert one == pytest.approx(2 * two)


@pytest.mark.parametrize("noise", [{"sigma_px": 0.05}, {"sigma_px": 0.05, "gray": 0.01, "contrast": 0.5}])
def test_what_remains_whatever_the_noise_is_added_to_every_kind_of_feature(noise: dict[str, float]) -> None:
    without, floor = Finder(**noise), Finder(**noise, floor_px=0.03)
    A, sharp = np.diag([10.0, 5.0]), {"sharp_px": 0.5}
    for sized in (True, False):
        pure = circle_covariance(without, A, 0.7, **sharp, sized=sized)
        np.testing.assert_allclose(
            circle_covariance(floor, A, 0.7, **sharp, sized=sized), pure + 0.03**2 * np.eye(2), rtol=1e-12
        )
    np.testing.assert_allclose(point_covariance(floor, 1.0, **sharp), (2 * 0.05**2 + 0.03**2) * np.eye(2))
    assert edge_variance(floor, 80.0, 0.7, **sharp) == pytest.approx(edge_variance(without, 80.0, 0.7, **sharp) + 9e-4)


@pytest.mark.parametrize("stated", [{}, {"gray": 0.01}, {"sigma_px": -1.0}, {"sigma_px": 0.1, "floor_px": -1.0}])
def test_noise_that_is_none_is_refused(stated: dict[str, float]) -> None:
    with pytest.raises(BadValue):
        Finder(**stated)


@pytest.mark.parametrize("blur", [0.5, 0.6, 1.0])
def test_the_variance_of_an_edge_is_the_cramer_rao_bound_of_pixels_that_integrate(blur: float) -> None:
    """Lens and pixel's area together have the stated blur; the edge crosses pixels at all phases along its length."""
    from scipy.special import ndtr

    grey, contrast, length, step = 0.02, 0.6, 64, 1e-3
    lens = np.sqrt(blur**2 - 1 / 12)
    across = np.arange(-9, 10)[:, None] + np.arange(length) / length

    def ramp(x: np.ndarray) -> np.ndarray:  # the integral of ndtr: a pixel's mean is its difference over the pixel
        return x * ndtr(x) + np.exp(-(x**2) / 2) / np.sqrt(2 * np.pi)

    def pixels(at: float) -> np.ndarray:
        return contrast * lens * (ramp((across - at + 0.5) / lens) - ramp((across - at - 0.5) / lens))

    information = (((pixels(step) - pixels(-step)) / (2 * step)) ** 2).sum() / grey**2
    finder = Finder(gray=grey, contrast=contrast, blur_px=blur)
    found = edge_variance(finder, float(length), finder.blur(None, 1.0), sharp_px=blur)
    assert 1 / information == pytest.approx(float(found), rel=0.01)  # of a box in the blur, the second moment counts
