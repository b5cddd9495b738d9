"""One conformance suite: a new lens is a new row of cameras.py and inherits every theorem here."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.camera.lens import (
    LENSES,
    BrownConrady,
    Division,
    DoubleSphere,
    Fisheye,
    Ideal,
    Lens,
    OddRadial,
    TiltedBrownConrady,
    lens_from_opencv,
)
from cadcam.errors import BadValue

from .cameras import CAMERAS

EPS = np.finfo(float).eps
every_camera = pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS.keys())


def points_within(camera: Camera, rng: np.random.Generator, n: int = 400, share: float = 0.97) -> Array:
    """Points in front, up to `share` of the largest angle the lens images (at most 80 deg), 0.1 to 10 m away."""
    limit = min(share * np.arctan(camera.lens.valid_radius), np.radians(80))
    t, phi, d = rng.uniform(0, limit, n), rng.uniform(0, 2 * np.pi, n), rng.uniform(100, 10_000, n)
    return d[:, None] * np.stack([np.sin(t) * np.cos(phi), np.sin(t) * np.sin(phi), np.cos(t)], axis=-1)


@every_camera
def test_unproject_undoes_project(camera: Camera, rng: np.random.Generator) -> None:
    p = points_within(camera, rng)
    d = camera.unproject(camera.project(p))
    assert np.allclose(np.linalg.norm(d, axis=1), 1, rtol=0, atol=4 * EPS)
    # near the fold the inverse amplifies rounding by 1/slope: at 97 % of the way the slope is above 0.02
    assert np.abs(np.cross(d, p) / np.linalg.norm(p, axis=1)[:, None]).max() < 2000 * EPS


@every_camera
def test_project_undoes_unproject_over_the_picture(camera: Camera) -> None:
    q = camera.pixel_grid()[::37, ::41].reshape(-1, 2)
    d = camera.unproject(q)
    imaged = ~np.isnan(d).any(axis=1)
    assert imaged.mean() > 0.3  # the two that fold do not reach the corners
    assert np.abs(camera.project(d[imaged]) - q[imaged]).max() < 1e-9  # px; 1e4 eps times the picture


@every_camera
def test_jacobian_with_respect_to_the_point(camera: Camera, rng: np.random.Generator) -> None:
    p = points_within(camera, rng, share=0.9)
    q, J = camera.project_with_jacobian(p)
    assert np.array_equal(q, camera.project(p), equal_nan=True)
    for k, e in enumerate(np.eye(3)):
        h = 1e-5 * np.linalg.norm(p, axis=1, keepdims=True)
        difference = (camera.project(p + h * e) - camera.project(p - h * e)) / (2 * h)
        scale = np.linalg.norm(J, axis=(1, 2))
        # central differences: third derivative h^2, rounding eps/h; a wrong term is off by per cents
        assert (np.linalg.norm(difference - J[..., k], axis=1) / scale).max() < 1e-6


@every_camera
def test_the_axis_is_nothing_special(camera: Camera) -> None:
    """The lenses divide by the distance off the axis: value and slope there are those of its neighbourhood."""
    axis, h = np.array([0.0, 0.0, 250.0]), 1e-3
    q, J = camera.project_with_jacobian(axis)
    for k, e in enumerate(np.eye(3)):
        difference = (camera.project(axis + h * e) - camera.project(axis - h * e)) / (2 * h)
        assert np.abs(difference - J[:, k]).max() < 1e-7 * np.abs(J).max()
    assert np.abs(camera.project(axis * [1, 1, 7]) - q).max() < 1e-12 * max(camera.size)
    assert np.abs(np.cross(camera.unproject(q), axis / 250)).max() < 4 * EPS


@every_camera
def test_jacobian_with_respect_to_the_coefficients(camera: Camera, rng: np.random.Generator) -> None:
    p, lens, h = points_within(camera, rng, share=0.7), camera.lens, 1e-6
    m, _, C = lens.project_with_jacobians(p)
    names = list(lens.parameters)
    assert C.shape == (*m.shape, len(names))
    for k, name in enumerate(names):
        plus = type(lens)(**{**lens.parameters, name: lens.parameters[name] + h}).project(p)
        minus = type(lens)(**{**lens.parameters, name: lens.parameters[name] - h}).project(p)
        scale = 1 + np.abs(C[..., k]).max()
        assert np.abs((plus - minus) / (2 * h) - C[..., k]).max() < 1e-7 * scale


@every_camera
def test_image_radius_rises_up_to_the_valid_radius(camera: Camera) -> None:
    """No direction is imaged twice: along every azimuth the image moves outwards, all the way."""
    limit = min(np.arctan(camera.lens.valid_radius), np.radians(85))
    t = np.linspace(0, limit * (1 - 1e-9), 500)[:, None]
    phi = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    e = np.stack([np.cos(phi), np.sin(phi)], axis=-1)
    p = np.concatenate([np.sin(t)[..., None] * e, np.broadcast_to(np.cos(t)[..., None], (500, 72, 1))], axis=-1)
    m = camera.lens.project(p)
    steps = np.sum(np.diff(m, axis=0) * e, axis=-1)
    assert np.all(steps > 0)


@every_camera
def test_nothing_behind_or_beyond_the_valid_radius_is_imaged(camera: Camera) -> None:
    assert np.isnan(camera.project(np.array([[0.0, 0, 0], [0, 0, -1], [1, 2, -3], [1, 0, 0]]))).all()
    assert np.isnan(camera.project(np.array([np.nan, 0, 1]))).all()
    r = camera.lens.valid_radius
    if np.isfinite(r):
        assert np.isnan(camera.project(np.array([1.0001 * r, 0, 1]))).all()
        assert np.isfinite(camera.project(np.array([0.5 * r, 0, 1]))).all()


def test_the_valid_radius_is_where_the_radial_curve_turns() -> None:
    k1, k2 = -0.35, 0.05
    r = BrownConrady(k1, k2).valid_radius
    assert abs(1 + 3 * k1 * r**2 + 5 * k2 * r**4) < 1e-12
    assert Division(0.2).valid_radius == pytest.approx(1 / (2 * np.sqrt(0.2)), rel=4 * EPS)
    assert Fisheye(-0.15).max_angle == pytest.approx(np.sqrt(1 / 0.45), rel=1e-12)
    assert BrownConrady(0.1, 0.2).valid_radius == np.inf
    assert Fisheye(-0.15, k4=1e-320).max_angle == Fisheye(-0.15).max_angle
    assert BrownConrady(k4=-1.0).valid_radius <= 1  # the denominator's pole


def test_tangential_distortion_shrinks_the_valid_radius_to_its_own_fold() -> None:
    plain, tangential = BrownConrady(-0.3), BrownConrady(-0.3, 0, 0.02, -0.03)
    r = tangential.valid_radius
    assert r < plain.valid_radius
    phi = np.linspace(0, 2 * np.pi, 1000)
    for factor, folded in ((0.999, False), (1.01, True)):
        u = factor * r * np.stack([np.cos(phi), np.sin(phi)], axis=-1)
        J = tangential._plane_jacobian(u)
        assert bool((np.linalg.det(J) <= 0).any()) is folded


def test_a_pole_is_approached_from_inside_whichever_side_rounding_puts_it_on() -> None:
    """k4 = -1/s has its pole at r^2 = s: the curve takes every value up to there, and each has its direction."""
    for s in np.linspace(0.5, 3, 60):
        lens = BrownConrady(k4=-1 / s)
        p = np.array([share * np.sqrt(s) * np.array([0.6, 0.8, 0]) + [0, 0, 1] for share in (0.01, 0.5, 0.9, 0.999)])
        d = lens.unproject(lens.project(p))
        assert np.abs(np.cross(d, p)).max() < 100 * EPS


@pytest.mark.parametrize("lens", [BrownConrady(-0.266, -0.038, 0, 0, 0.238), BrownConrady(-0.27, -0.04, 2e-3, 0, 0.24)])
def test_a_polynomial_is_inverted_wherever_it_rises_to(lens: BrownConrady) -> None:
    """At 89 degrees a direction is imaged 4e11 focal lengths off; rounding of m over the slope is far below p's."""
    u = np.tan(np.radians([70.0, 80, 84, 86, 88, 89]))[:, None] * [0.6, 0.8]
    p = np.column_stack([u, np.ones(6)])
    assert np.abs(np.cross(lens.unproject(lens.project(p)), p / np.linalg.norm(p, axis=1)[:, None])).max() < 10 * EPS


def test_every_direction_within_the_valid_radius_is_found_again_near_the_fold(rng: np.random.Generator) -> None:
    """Where prisms and tangential terms bend much, Newton's first steps from the radial solution leave the disc."""
    strong = [BrownConrady(0.48, 0.13, -0.005, 0.003, -0.054, 0.4, 0.1, 0.025, -0.026, -6e-4, 0.026, -6e-3)]
    for _ in range(40):
        k1, k2, k3 = rng.normal(size=3) * [0.3, 0.1, 0.05]
        p1, p2, s1, s2, s3, s4 = rng.normal(size=6) * [0.02, 0.02, 0.02, 0.005, 0.02, 0.005]
        k4, k5, k6 = rng.normal(size=3) * [0.3, 0.1, 0.05]
        strong.append(BrownConrady(k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4))
    for lens in strong:
        r, phi = min(lens.valid_radius, 5.0) * rng.uniform(0, 0.99, 400), rng.uniform(0, 2 * np.pi, 400)
        p = np.stack([r * np.cos(phi), r * np.sin(phi), np.ones(400)], axis=-1)
        m, J, _ = lens.project_with_jacobians(p)
        gain = np.linalg.norm(m, axis=1) / np.linalg.svd(J[..., :2], compute_uv=False)[:, 1]
        d = lens.unproject(m)
        wrong = np.linalg.norm(d[:, :2] / d[:, 2:] - p[:, :2], axis=1)
        # rounding of m, and of the monomials in it, by the inverse's least gain; and of the direction's components
        assert np.all(wrong < 1000 * EPS * (1 + r**2 + gain)), lens


def test_brown_conrady_is_opencvs(rng: np.random.Generator) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    for name in ("OpenCV stereo sample, left", "phone, rational", "rational with thin prism"):
        camera = CAMERAS[name]
        square = Camera.from_focal(camera.size, camera.fx, fy=camera.fy, lens=camera.lens)
        p = points_within(square, rng, share=0.5)
        theirs = cv2.projectPoints(
            p, np.zeros(3), np.zeros(3), np.array(square.K), np.array(list(square.lens.parameters.values()))
        )[0].reshape(-1, 2)
        assert np.abs(square.project(p) - theirs).max() < 1e-9 * 4000


def test_fisheye_is_opencvs(rng: np.random.Generator) -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is a peer here, not a dependency")
    camera = Camera.from_focal((1280, 960), 400.0, lens=Fisheye(0.03, -0.008, 0.001, -0.0002))
    p = points_within(camera, rng, share=0.9)
    K, D = np.array(camera.K), np.array(list(camera.lens.parameters.values()))
    theirs = cv2.fisheye.projectPoints(p[None], np.zeros((3, 1)), np.zeros((3, 1)), K, D)[0].reshape(-1, 2)
    assert np.abs(camera.project(p) - theirs).max() < 1e-9 * 1000


def test_opencvs_vector_gives_the_plainest_lens_that_it_is() -> None:
    assert lens_from_opencv([]) == Ideal()
    assert lens_from_opencv(np.zeros(5)) == Ideal()
    assert lens_from_opencv([0.1, 0, 0, 0]) == BrownConrady(0.1)
    assert lens_from_opencv([0.1, *[0] * 13]) == BrownConrady(0.1)
    assert lens_from_opencv([*[0] * 12, 0.1, 0]) == TiltedBrownConrady(tau_x=0.1)
    assert Camera.from_opencv((8, 6), np.diag([5.0, 5, 1]), [*[0] * 13, 0.2]).lens == TiltedBrownConrady(tau_y=0.2)


def test_the_thesis_polynomial_adds_dr_along_the_radius() -> None:
    a = (0.001, -0.12, 0.05, -0.02)
    r = np.linspace(0.01, 0.5, 9)
    dr = a[0] * r + a[1] * r**3 + a[2] * r**5 + a[3] * r**7  # EQ 2.5 as printed
    e = np.array([0.6, 0.8])
    p = np.concatenate([r[:, None] * e, np.ones((9, 1))], axis=1)
    assert np.allclose(OddRadial(*a).project(p), (r + dr)[:, None] * e, rtol=4 * EPS, atol=0)


@pytest.mark.parametrize("lens", LENSES.values(), ids=LENSES.keys())
def test_where_an_estimate_starts_every_coefficient_is_seen(lens: type[Lens]) -> None:
    """At its zero the field-of-view lens does not depend on w to first order: no estimate could leave it."""
    p = np.array([[x, y, 1.0] for x in (-0.4, 0.1, 0.5) for y in (-0.3, 0.2, 0.4)])
    C = lens(**lens.start).project_with_jacobians(p)[2]
    assert np.all(np.abs(C).max(axis=(0, 1)) > 1e-3)


def test_bad_coefficients_are_refused() -> None:
    with pytest.raises(BadValue, match="k1"):
        BrownConrady(np.nan)
    with pytest.raises(BadValue, match=r"k1 is 1e\+200; expected a number of at most 1e\+30"):
        BrownConrady(1e200)
    with pytest.raises(BadValue, match="a1"):
        OddRadial(-1.5)
    with pytest.raises(BadValue, match="number of distortion coefficients is 6"):
        BrownConrady.from_opencv(np.zeros(6))
    assert BrownConrady.from_opencv([*range(12), 0, 0]).parameters == dict(
        zip(LENSES["brown-conrady"]().parameters, range(12), strict=True)
    )


@pytest.mark.parametrize("xi", [-0.95, -0.5, -0.1, 0.0, 0.4, 1.0])
@pytest.mark.parametrize("alpha", [0.0, 0.2, 0.45, 0.55, 0.8, 1.0])
def test_a_double_sphere_ends_where_its_curve_turns_or_has_its_pole(xi: float, alpha: float) -> None:
    """Or at 90 degrees: up to there the image moves outwards, and an angle of 1e-6 beyond it is not imaged so."""
    lens = DoubleSphere(xi, alpha)
    rho, slope = lens._curve(np.linspace(0, lens.max_angle, 2000)[1:-1])
    assert (rho > 0).all()
    assert (slope > 0).all()
    if lens.max_angle < np.pi / 2:
        rho, slope = lens._curve(np.array([lens.max_angle + 1e-6]))
        assert rho[0] < 0 or slope[0] < 0


def test_the_quick_bound_never_reaches_beyond_the_fold(rng: np.random.Generator) -> None:
    """Three hundred decentred lenses: where the bound says that nothing folds, the search finds nothing either."""
    said = 0
    for _ in range(300):
        k1, k2, k3 = rng.normal(size=3) * [0.3, 0.1, 0.05]
        p1, p2, s1, s2, s3, s4 = rng.normal(size=6) * rng.choice([0.002, 0.02, 0.2], 6)
        lens = BrownConrady(k1, k2, p1, p2, k3, s1=s1, s2=s2, s3=s3, s4=s4)
        radius = rng.uniform(0.1, 3)
        if lens._upright_to(radius):
            said += 1
            assert radius <= lens.valid_radius
    assert said > 50
