"""OpenGL's matrices put every point where the camera does; the thesis' tables, as printed and as corrected."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.arrays import Array
from cadcam.camera import opengl
from cadcam.camera.camera import Camera
from cadcam.camera.extended_pinhole import ExtendedPinhole
from cadcam.errors import BadValue

Shared = Callable[[str], Path]
Golden = Callable[[str], dict[str, Any]]


def position_1(golden: Golden) -> ExtendedPinhole:
    values = np.array(golden("dlt.pos1.params")["value"])
    values[[3, 4, 5, 8]] = np.radians(values[[3, 4, 5, 8]])
    return ExtendedPinhole.from_vector(values)


def targets(shared: Shared) -> Array:
    table = shared("thesis/tables/table_2_7.csv")
    return np.loadtxt(table, delimiter=",", skiprows=3)[:, :3]


def pixel_from_ndc(camera: Camera, ndc: Array) -> Array:
    """Return our pixels (..., 2) of normalised device coordinates (..., >= 2), as docs/conventions.md defines them."""
    x = (ndc[..., 0] + 1) * camera.width / 2 - 0.5
    y = (1 - ndc[..., 1]) * camera.height / 2 - 0.5
    return np.stack([x, y], axis=-1)


def gl_pixels(camera: Camera, projection: Array, model_view: Array, X: Array) -> tuple[Array, Array]:
    """Window positions as OpenGL computes them, in our pixels, and clip w."""
    clip = (projection @ model_view @ np.column_stack([X, np.ones(len(X))]).T).T
    return pixel_from_ndc(camera, clip[:, :3] / clip[:, 3:]), clip[:, 3]


def skewed() -> tuple[Camera, ExtendedPinhole]:
    e = ExtendedPinhole(1500, -700, 400, 0.9, 0.5, -0.3, 1.2, 900, 0.12, 200, 500)
    return e.camera((800, 600)), e


def test_the_exact_matrix_carries_skew_and_aspect(rng: np.random.Generator) -> None:
    """Errata: "skewness and aspect cannot be described in OpenGL"; one 4x4 does it, to rounding."""
    camera, e = skewed()
    T = e.camera_from_world
    X = T.inv @ (rng.uniform([-300, -300, 500], [300, 300, 3000], (200, 3)))
    P = opengl.projection_matrix(camera, near=100.0, far=5000.0)
    q, w = gl_pixels(camera, P, opengl.model_view_matrix(T), X)
    assert np.allclose(q, camera.project(T @ X), rtol=0, atol=1e-9)
    assert np.allclose(w, (T @ X)[:, 2], rtol=1e-12)


def test_depth_runs_from_minus_one_at_near_to_one_at_far() -> None:
    camera, _ = skewed()
    P = opengl.projection_matrix(camera, near=100.0, far=5000.0)
    for z, depth in ((100.0, -1.0), (5000.0, 1.0)):
        clip = P @ [0, 0, -z, 1]
        assert clip[2] / clip[3] == pytest.approx(depth, rel=1e-12)


def test_frustum_equals_the_exact_matrix_when_there_is_no_skew() -> None:
    camera = Camera.from_focal((768, 576), 811.0, fy=805.0, cx=354.7, cy=319.7)
    frustum = opengl.frustum(camera, near=50.0, far=9000.0)
    assert np.allclose(frustum.matrix, opengl.projection_matrix(camera, near=50.0, far=9000.0), rtol=0, atol=1e-12)


def test_glu_look_at_equals_the_model_view_matrix() -> None:
    _, e = skewed()
    look = opengl.look_at(Camera.from_focal((800, 600), 900.0), e.camera_from_world)
    assert np.allclose(look.matrix, opengl.model_view_matrix(e.camera_from_world), rtol=0, atol=1e-9)


def test_viewport_is_table_3_6(shared: Shared) -> None:
    rows = shared("thesis/tables/table_3_6.csv").read_text().splitlines()[3:]
    printed = tuple(int(row.split(",")[1]) for row in rows)
    assert opengl.viewport(Camera.from_focal((768, 576), 800.0)) == printed


def test_frustum_reproduces_table_3_7_and_its_corrected_bottom_and_top(golden: Golden) -> None:
    """Table 3.2: any near works with all sides scaled; U points down, so bottom = U0 - 576, top = U0."""
    entry = golden("gl.frustum_as_printed")
    left, right, bottom, top, near = entry["value"]
    e = position_1(golden)
    square = Camera.from_focal((768, 576), e.focal, cx=e.V0, cy=e.U0)
    f = opengl.frustum(square, near=near, far=1e5, pixel_corners=False)
    assert np.allclose([f.left, f.right, f.near], [left, right, near], rtol=0, atol=entry["tol"])
    assert np.allclose([f.bottom, f.top], [-top, -bottom], rtol=0, atol=entry["tol"])  # printed ones are mirrored
    near_mm = opengl.frustum(square, near=10.0, far=1e5, pixel_corners=False)
    assert np.allclose(near_mm.left / 10.0, f.left / near, rtol=1e-12)


def test_look_at_reproduces_the_corrected_table_3_8(golden: Golden) -> None:
    """Table 3.4: centre = F - sign(det M) M2/|M2|, up = sign(det M) x first column of M^-1."""
    e = position_1(golden)
    look = opengl.look_at(e.camera((768, 576)), e.camera_from_world)
    for value, key in ((look.center - look.eye, "gl.view_direction"), (look.up, "gl.up")):
        entry = golden(key)
        assert np.allclose(value, entry["value"], rtol=0, atol=entry["tol"])
    M = e.matrix[:, :3]
    sign = np.sign(np.linalg.det(M))
    up = sign * np.linalg.inv(M)[:, 0]
    assert np.allclose(look.center - look.eye, -sign * M[2] / np.linalg.norm(M[2]), rtol=0, atol=1e-9)
    assert np.allclose(look.up, up / np.linalg.norm(up), rtol=0, atol=1e-9)
    assert sign > 0  # the world origin is behind: the printed centre F + M2 holds for the other sign only


def test_up_and_centre_hold_for_the_other_sign_of_det_m_too() -> None:
    e = ExtendedPinhole(100, 50, 400, 0.2, 0.1, 0.3, 1.0, 800, 0.0, 288, 384)
    M = e.matrix[:, :3]
    assert np.linalg.det(M) < 0
    look = opengl.look_at(e.camera((768, 576)), e.camera_from_world)
    up = -np.linalg.inv(M)[:, 0]
    assert np.allclose(look.center - look.eye, M[2] / np.linalg.norm(M[2]), atol=1e-9)
    assert np.allclose(look.up, up / np.linalg.norm(up), atol=1e-9)


def test_the_printed_numbers_of_table_3_8_are_those_of_the_joint_calibration(golden: Golden) -> None:
    """Its direction and up belong to Table 2.24, with the direction reversed; its eye to Table 2.9."""
    joint = golden("joint.alpha0.5")["printed"]["ext1"]
    e = ExtendedPinhole.from_vector([*joint[:3], *np.radians(joint[3:]), 1.007, 805.3, np.radians(-0.15), 318.7, 328.4])
    look = opengl.look_at(e.camera((768, 576)), e.camera_from_world)
    entry = golden("gl.table3.8_from_joint")
    direction, up = np.array(entry["value"])
    assert np.allclose(look.center - look.eye, -direction, rtol=0, atol=entry["tol"])
    assert np.allclose(look.up, up, rtol=0, atol=entry["tol"])
    assert np.allclose(np.round([direction, up], 3), entry["printed"], rtol=0, atol=1.01e-3)


def test_what_the_printed_formulas_do_to_position_1(shared: Shared, golden: Golden) -> None:
    """golden gl.printed_formulas, rows: as printed; centre = F - M2; bottom and top corrected too.

    Columns: largest clip w (must be positive), mean window x minus V, mean row from the top minus U, against the
    pinhole with aspect 1 and skew 0, which is all that glFrustum was given.
    """
    entry = golden("gl.printed_formulas")
    e, X = position_1(golden), targets(shared)
    square = Camera.from_focal((768, 576), e.focal, cx=e.V0, cy=e.U0)
    q = square.project(e.camera_from_world @ X)
    good = opengl.frustum(square, near=e.focal, far=1e5, pixel_corners=False)
    shifted = replace(good, bottom=-good.top, top=-good.bottom)
    ahead = opengl.look_at(e.camera((768, 576)), e.camera_from_world)
    M = e.matrix[:, :3]
    back = opengl.LookAt(ahead.eye, ahead.eye + M[2], np.linalg.inv(M)[:, 0])

    rows = []
    for frustum, look in ((shifted, back), (shifted, ahead), (good, ahead)):
        clip = (frustum.matrix @ look.matrix @ np.column_stack([X, np.ones(len(X))]).T).T
        ndc = clip[:, :2] / clip[:, 3:]
        x, row = (ndc[:, 0] + 1) * 384, (1 - ndc[:, 1]) * 288  # the thesis counts from the corner
        rows.append([clip[:, 3].max(), np.mean(x - q[:, 0]), np.mean(row - q[:, 1])])
    assert np.allclose(rows, entry["value"], rtol=0, atol=entry["tol"])
    assert rows[2][2] - rows[1][2] == pytest.approx(2 * e.U0 - 576, abs=1e-6)


def test_table_3_1_needs_its_signs(shared: Shared) -> None:
    """As printed, -far + near and -2 far - near put near and far nowhere near -1 and 1."""
    near, far = 10.0, 1000.0
    m = opengl.Frustum(-1, 1, -1, 1, near, far).matrix
    assert m[2, 2] == -(far + near) / (far - near)
    assert m[2, 3] == -2 * far * near / (far - near)
    printed = (-far + near) / (far - near), (-2 * far - near) / (far - near)
    assert abs((printed[0] * -near + printed[1]) / near - (-1)) > 0.5


def test_near_of_table_3_2_leaves_five_millimetres(shared: Shared, golden: Golden) -> None:
    """near = focal (805.9, read as mm) nearly clips the nearest template at 811.1 mm."""
    e = position_1(golden)
    depth = (e.camera_from_world @ targets(shared))[:, 2].min()
    assert depth == pytest.approx(811.08, abs=0.01)
    assert 0 < depth - e.focal < 5.3


def test_table_3_9_shows_the_half_pixel_of_the_viewport(shared: Shared, golden: Golden) -> None:
    """The printed mean shift (0.55, 0.45) px is half a pixel, between pixel centres and corners: no perturbation."""
    rows = np.loadtxt(shared("thesis/tables/table_3_9.csv"), delimiter=",", skiprows=3)
    d = rows[:, :2] - rows[:, 2:4]
    entry = golden("table3.9.differences")
    found = [*d.mean(axis=0), *np.abs(d).mean(axis=0)]
    assert np.allclose(found, entry["value"], rtol=0, atol=1e-6)
    standard_error = d.std(axis=0, ddof=1) / np.sqrt(len(d))
    assert np.all(np.abs(d.mean(axis=0) - 0.5) < 2 * standard_error)
    assert np.all(d.mean(axis=0) > 2 * standard_error)  # it is not zero
    camera = Camera.from_focal((768, 576), 800.0)
    corner = pixel_from_ndc(camera, np.array([-1.0, 1.0, 0.0]))
    assert tuple(corner) == (-0.5, -0.5)


def test_impossible_ranges_are_refused() -> None:
    camera = Camera.from_focal((768, 576), 800.0)
    for near, far in ((0, 10), (-1, 10), (10, 10), (10, 5), (1, np.inf), (np.nan, 5)):
        with pytest.raises(BadValue, match="near"):
            opengl.projection_matrix(camera, near=near, far=far)
