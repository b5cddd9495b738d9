"""What a photo shows of a line is where the line is: of a bent one too, whose cells and blur lie inside the bend."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.cad.parts.shape import circle, prism
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.light import Blur
from cadcam.locate.lines.cells import Cells, CellSize, measured_steps
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo

CAMERA = Camera.from_focal((160, 120), 900.0)
FINE = 8  # samples a pixel, each way
SLOPE, NOISE, PHOTOS = 1e-3, 0.01, 12  # brightness a px; of a pixel


def disc(radius: float) -> np.ndarray:
    """Return a bright disc (H, W) around the principal point, its border exact but for 1/8 px, blurred by 0.5 px."""
    x, y = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 for n in CAMERA.size)
    cx, cy = CAMERA.principal_point
    d = np.hypot(x - cx, y[:, None] - cy)
    fine = gaussian_filter(0.2 + 0.5 * np.clip(0.5 + FINE * (radius - d), 0, 1), 0.5 * FINE)
    return np.asarray(fine.reshape(120, FINE, 160, FINE).mean(axis=(1, 3)), np.float32)


@pytest.mark.parametrize("radius", [8.0, 12.0, 40.0])
def test_the_border_of_a_disc_is_measured_where_it_is(radius: float) -> None:
    """Taken for straight, cells of 4 px and a blur of 0.58 px put it 0.83 px^2 / radius inside: 0.10 px at 8 px.

    The tolerance is a quarter of the 0.07 px at 12 px, near all of the 0.02 px at 40 px.
    """
    part = Part.of(prism(circle((0, 0), radius, 720), 0, 40, name="pin"))
    pose = Rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, CAMERA.fx + 40]))  # its top in scale 1 px to 1 mm
    sight = Sight.of(part, Photo.of(disc(radius), CAMERA), pose, step_px=4.0, reach_px=9.0)
    at = sight.project(pose)
    cells = Cells.of(sight, at, CellSize(2.0, 4.5, 2.5))
    found = measured_steps(sight, at, cells, np.zeros(len(sight.samples)))
    outward = np.sign(((at.q - CAMERA.principal_point) * at.normal).sum(axis=1))
    assert found.usable.mean() > 0.9
    assert abs(np.mean((outward * found.offset)[found.usable])) < 0.018


@pytest.mark.parametrize("defocus", [2.0, 3.0])
def test_a_wide_blur_is_told_by_wide_cells(defocus: float) -> None:
    """Across cells of 4.5 px a disc of blur of 3 px is a slope, which the widest blur that is tried fits best, 3.5 px.

    A uniform disc of radius r spreads by r / 2 along any direction, the pixel and 0.5 px beside it: 1.18 and 1.61 px.
    """
    part = Part.of(prism([(-40, -30), (40, -30), (40, 30), (-40, 30)], 0, 40, name="block"))
    pose = Rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, CAMERA.fx + 40]))
    x, y = ((np.arange(FINE * n) + 0.5) / FINE - 0.5 for n in CAMERA.size)
    cx, cy = CAMERA.principal_point
    inside = (np.abs(x - cx) < 40) & (np.abs(y[:, None] - cy) < 30)
    fine = gaussian_filter(0.2 + 0.5 * inside, 0.5 * FINE)
    sharp = fine.reshape(120, FINE, 160, FINE).mean(axis=(1, 3)).astype(np.float32)
    gray = Blur(0.0, defocus).apply(sharp, np.random.default_rng(0))
    sight = Sight.of(part, Photo.of(gray, CAMERA), pose, step_px=4.0, reach_px=9.0)
    spread = np.sqrt(0.25 + 1 / 12 + defocus**2 / 4)
    blur = sight.blur(sight.project(pose), half_length=2.0, reach_px=4.5)
    assert np.sqrt(np.linalg.eigvalsh(blur)) == pytest.approx(spread, rel=0.25)


def test_cells_of_a_blurred_photo_reach_farther_across_blurred_edges_alone() -> None:
    """Motion along x blurs the upright borders; level and slope cannot be told from a step within 2 blurs of it."""
    part = Part.of(prism([(-40, -30), (40, -30), (40, 30), (-40, 30)], 0, 40, name="block"))
    pose = Rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, CAMERA.fx + 40]))
    sight = Sight.of(part, Photo.of(disc(30.0), CAMERA), pose, step_px=4.0, reach_px=9.0)
    at = sight.project(pose)
    spread = np.diag([1.6**2, 0.6**2])
    cells = Cells.of(sight, at, CellSize(2.0, 4.5, 2.5), spread=spread)
    upright = np.abs(at.normal[cells.which, 0]) > 0.9
    np.testing.assert_allclose(cells.blurs, np.where(upright, 1.6, 0.6))
    np.testing.assert_allclose(np.minimum(cells.below, cells.above), np.where(upright, 4.8, 4.5))
    each = cells.alike()
    assert len(each) == 2
    assert sorted(np.concatenate([own for own, _ in each])) == list(range(len(cells.which)))
    sums = cells.sums_at(sight, at, None).sums
    for own, blur in each:
        one = replace(
            cells, **{name: getattr(cells, name)[own] for name in ("which", "below", "above", "bow", "twins")}
        )
        alone = replace(one, blurs=np.full(len(own), blur)).sums_at(sight, at, None).sums
        np.testing.assert_allclose(sums[own], alone, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("as_lines", [True, False])
def test_ground_that_slopes_less_than_a_cell_tells_draws_no_edge_as_a_whole(as_lines: bool) -> None:
    """A plate that gets brighter to the right, by a tenth of the noise each px: its left and right edges stay.

    The mean of an edge over its sigma, in the mean of 24, is 0 to within three of its own sigmas. Slopes held as each
    cell asks for draw it by more than that.
    """
    camera = Camera.from_focal((320, 240), 900.0)
    part = Part.of(prism([(-110, -90), (110, -90), (110, 90), (-110, 90)], 0, 40, name="plate"))
    pose = Rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, camera.fx + 40]))
    x, y = ((np.arange(FINE * n) + 0.5) / FINE - n / 2 for n in camera.size)
    inside = (np.abs(x) < 110) & (np.abs(y[:, None]) < 90)
    fine = gaussian_filter(np.where(inside, 0.5 + SLOPE * x, 0.3), 0.5 * FINE)
    sharp = fine.reshape(240, FINE, 320, FINE).mean(axis=(1, 3))
    rng, drawn = np.random.default_rng(0), list[float]()
    for _ in range(PHOTOS):
        noisy = (sharp + NOISE * rng.standard_normal(sharp.shape)).astype(np.float32)
        sight = Sight.of(part, Photo.of(noisy, camera), pose, step_px=4.0, reach_px=14.0)
        at = sight.project(pose)
        cells = Cells.of(sight, at, CellSize(2.0, 7.0, 2.5))
        found = measured_steps(sight, at, cells, np.zeros(len(sight.samples)), as_lines=as_lines)
        for side in (-1, 1):
            rows = found.usable & (np.abs(at.normal[:, 0]) > 0.9) & (side * (at.q[:, 0] - 160) > 0)
            weight, along_x = 1 / found.sigma[rows] ** 2, np.sign(at.normal[rows, 0]) * found.offset[rows]
            drawn.append(float(weight @ along_x / np.sqrt(weight.sum())))
    assert bool(abs(np.mean(drawn)) < 3 / np.sqrt(len(drawn))) is as_lines
