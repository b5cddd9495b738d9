"""Eleven parameters, camera + pose, 3x4 matrix: exact both ways, for either sign of det M."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.camera.extended_pinhole import (
    NAMES,
    ExtendedPinhole,
    pixels_from_uv,
    rotation_of,
    uv_from_pixel_matrix,
    uv_matrix,
)
from cadcam.errors import BadValue, DegenerateGeometry

EPS = np.finfo(float).eps


def random_pinholes(rng: np.random.Generator, n: int) -> list[ExtendedPinhole]:
    """Random cameras with skew up to 20 deg, anywhere around the origin: about half have it behind them (det M > 0)."""
    low = [-2e3, -2e3, -2e3, -np.pi, -1.5, -np.pi, 0.5, 200, -0.35, -200, -200]
    high = [2e3, 2e3, 2e3, np.pi, 1.5, np.pi, 2.0, 4000, 0.35, 2000, 2000]
    return [ExtendedPinhole.from_vector(v) for v in rng.uniform(low, high, (n, 11))]


def relative(found: ExtendedPinhole, true: ExtendedPinhole) -> float:
    """Largest difference relative to each parameter's scale (position and image: their norm; angles: 1 rad)."""
    d = np.abs(found.vector - true.vector)
    d[3:6] = np.abs((d[3:6] + np.pi) % (2 * np.pi) - np.pi)
    position = np.linalg.norm(true.vector[:3])
    image = np.linalg.norm(true.vector[[7, 9, 10]])
    return float((d / [position, position, position, 1, 1, 1, true.aspect, true.focal, 1, image, image]).max())


def test_decompose_undoes_compose_for_both_signs_of_det_m(rng: np.random.Generator) -> None:
    """Within 1e-12 relative, 16 times the largest error of 5000 such cameras; skew up to 20 deg."""
    signs = set()
    for true in random_pinholes(rng, 2000):
        C = true.matrix
        signs.add(float(np.sign(np.linalg.det(C[:, :3]))))
        assert relative(ExtendedPinhole.from_matrix(C), true) < 1e-12
    assert signs == {-1.0, 1.0}


def test_recompose_undoes_decompose(rng: np.random.Generator) -> None:
    """Within 1e-12 of the largest entry of each row, in the scale of K; C = K/K23 adds the rounding of K23."""
    for true in random_pinholes(rng, 500):
        K = true.unnormalized_matrix
        again = ExtendedPinhole.from_matrix(-3.0 * K).unnormalized_matrix
        assert (np.abs(again - K) / np.abs(K).max(axis=1, keepdims=True)).max() < 1e-12
        C, K23 = true.matrix, abs(K[2, 3]) / np.abs(K[2]).max()
        again = ExtendedPinhole.from_matrix(C).matrix
        assert (np.abs(again - C) / np.abs(C).max(axis=1, keepdims=True)).max() < 1e-12 * max(1.0, 0.1 / K23)


def test_camera_and_pose_carry_the_same_eleven_numbers(rng: np.random.Generator) -> None:
    for true in random_pinholes(rng, 500):
        found = ExtendedPinhole.from_camera(true.camera((768, 576)), true.camera_from_world)
        assert relative(found, true) < 1e-12


def test_the_scale_and_sign_of_the_matrix_do_not_matter(rng: np.random.Generator) -> None:
    for true in random_pinholes(rng, 200):
        C = uv_matrix(true.camera((768, 576)), true.camera_from_world)
        for scale in (1.0, -1.0, 1e-9, -1e7):
            assert relative(ExtendedPinhole.from_matrix(scale * C), true) < 1e-12


def test_projection_is_the_thesis_own_formula(rng: np.random.Generator) -> None:
    """U = U0 + f x'/(-z'), V = V0 + f p (sin(beta) x' + cos(beta) y')/(-z') with X' = R (X - F)."""
    for e in random_pinholes(rng, 100):
        X = rng.normal(size=(20, 3)) * 500
        x, y, z = (e.rotation @ (X - [e.X, e.Y, e.Z]).T) / 1.0
        front = -z > 0
        U = e.U0 + e.focal * x / -z
        V = e.V0 + e.focal * e.aspect * (np.sin(e.skew) * x + np.cos(e.skew) * y) / -z
        q = e.camera((768, 576)).project(e.camera_from_world @ X)
        expected = pixels_from_uv(np.stack([U, V], axis=-1))
        assert np.array_equal(np.isnan(q).any(axis=1), ~front)
        assert np.allclose(q[front], expected[front], rtol=1e-11, atol=1e-8)


def test_matrix_projects_as_camera_and_pose_do(rng: np.random.Generator) -> None:
    for e in random_pinholes(rng, 100):
        X = rng.normal(size=(20, 3)) * 500
        u, v, t = e.matrix @ np.column_stack([X, np.ones(20)]).T
        front = (e.camera_from_world @ X)[:, 2] > 1
        q = e.camera((768, 576)).project(e.camera_from_world @ X)
        assert np.allclose(q[front], np.stack([v / t, u / t], axis=-1)[front], rtol=1e-9, atol=1e-7)


def test_at_b_of_90_degrees_the_rotation_is_kept_though_the_angles_are_not_unique() -> None:
    for b in (np.pi / 2, -np.pi / 2):
        true = ExtendedPinhole(10, 20, 30, 0.3, b, 0.4, 1.1, 800, 0.01, 300, 400)
        found = ExtendedPinhole.from_camera(true.camera((768, 576)), true.camera_from_world)
        assert np.allclose(found.rotation, true.rotation, rtol=0, atol=1e-9)


def test_rotation_is_right_handed_and_composed_in_the_thesis_order() -> None:
    a, b, c = 0.2, -0.4, 0.7
    assert np.allclose(rotation_of(a, b, c), rotation_of(0, 0, c) @ rotation_of(0, b, 0) @ rotation_of(a, 0, 0))
    assert np.linalg.det(rotation_of(a, b, c)) == pytest.approx(1, rel=10 * EPS)


def test_rows_of_a_pixel_matrix_are_swapped_by_the_adapter() -> None:
    P = np.arange(12.0).reshape(3, 4)
    assert np.array_equal(uv_from_pixel_matrix(P), P[[1, 0, 2]])
    assert np.array_equal(uv_from_pixel_matrix(uv_from_pixel_matrix(P)), P)


def test_what_is_no_pinhole_is_refused() -> None:
    with pytest.raises(DegenerateGeometry, match="row 2"):
        ExtendedPinhole.from_matrix([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
    with pytest.raises(DegenerateGeometry, match="no inverse"):
        ExtendedPinhole.from_matrix([[1, 0, 0, 0], [0, 1, 0, 0], [1, 1, 0, 1]])
    with pytest.raises(BadValue, match="focal"):
        ExtendedPinhole(0, 0, 0, 0, 0, 0, 1, -800, 0, 300, 400)
    with pytest.raises(BadValue, match="aspect"):
        ExtendedPinhole(0, 0, 0, 0, 0, 0, 0, 800, 0, 300, 400)
    for skew in (-np.pi / 2, np.pi / 2, 3.0):
        with pytest.raises(BadValue, match="skew below 90 deg"):
            ExtendedPinhole(0, 0, 0, 0, 0, 0, 1, 800, skew, 300, 400)
    with pytest.raises(BadValue, match="U0"):
        ExtendedPinhole(0, 0, 0, 0, 0, 0, 1, 800, 0, np.nan, 400)
    with pytest.raises(DegenerateGeometry, match="C23 = 1"):
        _ = ExtendedPinhole(5, 0, 0, 0, 0, 0, 1, 800, 0, 300, 400).matrix


def test_names_are_the_thesis_own_in_golden_order() -> None:
    assert NAMES == ("X", "Y", "Z", "a", "b", "c", "aspect", "focal", "skew", "U0", "V0")
