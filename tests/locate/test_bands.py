"""Bands beside lines that the model does not have: told by stretches of cells, they no longer draw the lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from scipy.special import ndtr

from cadcam.cad.parts.shape import box
from cadcam.camera.camera import Camera
from cadcam.errors import DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.image.profile import StepSums, step_rests, step_sums
from cadcam.locate.lines.bands import banded
from cadcam.locate.lines.cells import Cells, CellSize, measured_steps
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.refine import refinement
from cadcam.locate.refine.refinement import refine_pose
from cadcam.locate.refine.solution import PoseSolution
from cadcam.native.core import choose_variant
from cadcam.native.profiles import StepCells, band_gains

from .photos import noisy

CAMERA = Camera.from_focal((240, 200), 900.0)
BLUR = 0.6
SIZE = CellSize(half_length=2.0, reach=4.5, room=2.5)


def plate(band: float, height: float, *, blur: float = BLUR) -> np.ndarray:
    """Return (H, W) a bright rectangle of 120 x 80 px, turned by 0.1, a band of a width (px) and height all around."""
    y, x = np.mgrid[: CAMERA.height, : CAMERA.width] - np.array(CAMERA.principal_point)[::-1, None, None]
    u, v = x * np.cos(0.1) + y * np.sin(0.1), y * np.cos(0.1) - x * np.sin(0.1)

    def inside(wider: float) -> np.ndarray:
        sides = [(60 + wider - s * u, 40 + wider - s * v) for s in (1, -1)]
        return np.prod([ndtr(d / blur) for pair in sides for d in pair], axis=0)

    return np.asarray(0.4 + height * (inside(band) - inside(0)) + 0.3 * inside(0), np.float32)


def sighted(gray: np.ndarray) -> tuple[Sight, Rigid]:
    """Return the sight of a part of 120 x 80 mm whose top is seen in scale 1 px to 1 mm, as it stands."""
    part = Part.of(box((-60, -40, 0), (60, 40, 40), name="plate"))
    turned = Rigid.exp(np.array([0, 0, 0, 0, 0, 0.1]))
    pose = Rigid(np.diag([1.0, -1.0, -1.0]) @ turned.rotation.T, np.array([0.0, 0.0, CAMERA.fx + 40]))
    return Sight.of(part, Photo.of(gray, CAMERA), pose, step_px=4.0, reach_px=9.0), pose


def offsets(sight: Sight, pose: Rigid, *, told: bool) -> np.ndarray:
    """Return where (n,) the steps of all edges are seen, with bands told or not."""
    at, where = sight.project(pose), np.zeros(len(sight.samples))
    cells = Cells.of(sight, at, SIZE)
    if told:
        _, cells, sums = banded(sight, at, cells, where, anew=True)
    else:
        sums = cells.sums_at(sight, at, where)
    found = measured_steps(sight, at, cells, where, sums=sums)
    assert found.usable.mean() > 0.8
    return np.asarray(found.offset[found.usable])


@pytest.mark.parametrize(("band", "height"), [(3.2, -0.2), (4.0, -0.2), (2.2, 0.12), (2.5, 0.12), (3.2, 0.12)])
def test_a_band_no_longer_draws_the_line(band: float, height: float, rng: np.random.Generator) -> None:
    """By 0.09 to 0.33 px, all edges to one side, as long as it is not told; then by less than a quarter of that."""
    sight, pose = sighted(noisy(plate(band, height), 0.01, rng))
    untold, told = (np.abs(np.median(offsets(sight, pose, told=t))) for t in (False, True))
    assert untold > 0.08
    assert told < 0.25 * untold


def test_where_there_is_no_band_none_is_told(rng: np.random.Generator) -> None:
    """60 plates have some 500 stretches: one that is told by chance does no harm, one in a hundred would."""
    told = stretches = 0
    for _ in range(60):
        sight, pose = sighted(noisy(plate(0.0, 0.0), 0.03, rng))
        at = sight.project(pose)
        cells = Cells.of(sight, at, SIZE)
        _, looked, _ = banded(sight, at, cells, np.zeros(len(sight.samples)), anew=True)
        told += int((looked.doubt > 0).sum())
        stretches += len(cells.which)
    assert told < 0.01 * stretches


def test_a_photo_too_small_for_cells_has_no_bands() -> None:
    sight, pose = sighted(plate(2.5, -0.2))
    none = sight.select(slice(0, 0))
    at = none.project(pose)
    cells = Cells.of(none, at, SIZE)
    assert banded(none, at, cells, np.zeros(0), anew=True)[1] is cells


@pytest.mark.parametrize(("band", "height"), [(2.5, 0.12), (3.2, 0.12)])
def test_beside_bands_a_part_is_found_as_surely_as_is_said(
    band: float, height: float, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part with bands all around is farther off than it is said to be, as long as these are not looked for."""
    _, pose = sighted(plate(band, height))
    part = Part.of(box((-60, -40, 0), (60, 40, 40), name="plate"))
    photos = [Photo.of(noisy(plate(band, height), 0.01, rng), CAMERA) for _ in range(8)]

    def normalised() -> float:
        z2 = []
        for photo in photos:
            found = refine_pose(part, [photo], pose).pose
            xi = (pose.inv @ found.world_from_part).log()
            z2.append(xi @ np.linalg.solve(found.covariance, xi) / 6)
        return float(np.sqrt(np.mean(z2)))

    told = normalised()
    monkeypatch.setattr(refinement, "_BANDED", 2.0)  # more than all lines
    untold = normalised()
    assert told < 1.6
    assert untold > 1.5 * told


def test_lines_beside_bands_that_leave_the_pose_open_are_no_pose(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each line may be drawn by its band: then few lines that gave a pose as long as none was do so no more."""

    def open_beside_bands(self: PoseSolution) -> PoseSolution:
        raise DegenerateGeometry("its lines do not determine the pose")

    sight, pose = sighted(noisy(plate(3.0, 0.1), 0.01, rng))
    monkeypatch.setattr(PoseSolution, "tells_lines", property(lambda self: False))
    monkeypatch.setattr(PoseSolution, "beside_its_bands", open_beside_bands)
    part = Part.of(box((-60, -40, 0), (60, 40, 40), name="plate"))
    found = refine_pose(part, [sight.photo], pose)
    assert not found.found
    assert "do not determine the pose" in found.reason


def cells_of(gray: np.ndarray, rng: np.random.Generator, n: int) -> tuple[StepCells, StepSums]:
    q, angle = rng.uniform(20, 180, (n, 2)), rng.uniform(0, 2 * np.pi, n)
    twins = np.tile([[-np.inf, 0.0], [np.inf, 0.0]], (n, 1, 1))
    twins[::2, 1] = [3.0, 0.1]
    below, above = rng.uniform(3, 6, (2, n))
    cells = StepCells(q, np.stack([np.cos(angle), np.sin(angle)], axis=1), below, above, 2.0, BLUR, twins)
    return cells, step_sums(gray, cells)


@pytest.mark.parametrize("level", [0, -1])
def test_what_is_left_over_is_so_by_least_squares(level: int, rng: np.random.Generator) -> None:
    """Residuals of numpy's least squares, summed up by distance; the bell's integral is good to 8e-8."""
    gray = (0.5 + 0.1 * rng.normal(size=CAMERA.size[::-1])).astype(np.float32)
    cells, sums = cells_of(gray, rng, 20)
    choose_variant(level)
    rest, number, variance = step_rests(gray, cells, sums, bins=24, width=0.5)
    for i in range(20):
        offset = np.stack(np.meshgrid(np.arange(240), np.arange(200)), axis=-1).reshape(-1, 2) - cells.q[i]
        nx, ny = cells.normal[i]
        d, t = offset @ (nx, ny), offset @ (-ny, nx)
        inside = (np.abs(t) <= 2) & (d >= -cells.below[i]) & (d <= cells.above[i])
        d, t, y = d[inside], t[inside], gray.reshape(-1)[inside].astype(float)
        A = columns(d)
        if i % 2 == 0:
            A = np.column_stack([A, ndtr((d - 3.0 - 0.1 * t) / BLUR)])
        r = y - A @ np.linalg.lstsq(A, y)[0]
        np.testing.assert_allclose(number[i], np.histogram(d, 24, (-6, 6))[0])
        np.testing.assert_allclose(rest[i], np.histogram(d, 24, (-6, 6), weights=r)[0], atol=2e-3)
        assert variance[i] == pytest.approx(r @ r / (len(y) - A.shape[1]), rel=1e-3)


def columns(d: np.ndarray) -> np.ndarray:
    step, bell = ndtr(d / BLUR), np.exp(-0.5 * (d / BLUR) ** 2) / (BLUR * np.sqrt(2 * np.pi))
    ramp = d * step + BLUR**2 * bell
    return np.stack([np.ones_like(d), step, bell, d - ramp, ramp], axis=-1)


def left_over(A: np.ndarray, y: np.ndarray) -> float:
    return float(np.sum((y - A @ np.linalg.lstsq(A, y)[0]) ** 2))


def test_a_gain_is_what_one_more_column_takes_from_the_squares(rng: np.random.Generator) -> None:
    d = (np.arange(24) - 11.5) * 0.5
    number = rng.integers(1, 9, (5, 24)).astype(float)
    rest, variance, known = number * rng.normal(size=(5, 24)), rng.uniform(0.5, 2, 5), np.full((5, 3), np.nan)
    known[1, 0], known[2, 2], known[3] = -2.3, 3.1, (-2.0, np.nan, 4.0)
    tried, room = np.array([-3.0, -1.0, 1.5, 2.5]), np.array([[4.0, 4.0]] * 4 + [[2.0, 0.0]])
    gain = band_gains(rest, number, variance, known, room, tried, width=0.5, blur=BLUR)
    for i in range(5):
        own = [ndtr(np.sign(k) * (d - k) / BLUR) for k in known[i] if np.isfinite(k)]
        A, root = np.column_stack([columns(d), *own]), np.sqrt(number[i])
        y = rest[i] / number[i] * root
        for t, place in enumerate(tried):
            more = np.column_stack([A, ndtr(np.sign(place) * (d - place) / BLUR)])
            squares = [left_over(M * root[:, None], y) for M in (A, more)]
            expected = (squares[0] - squares[1]) / variance[i] if abs(place) < room[i, int(place > 0)] else 0.0
            assert gain[i, t] == pytest.approx(expected, rel=1e-6, abs=1e-9)


@pytest.fixture(autouse=True)
def fastest() -> Iterator[None]:
    yield
    choose_variant(-1)
