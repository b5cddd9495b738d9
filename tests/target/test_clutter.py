"""Marks among clutter: what the search asks for is bounded, whatever the candidates' number and size."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.target.boards.photometric import patches
from cadcam.target.marks import candidates, find, window
from cadcam.target.marks.candidates import MarkCandidates, mark_candidates, screened
from cadcam.target.marks.find import find_marks
from cadcam.target.marks.fit import MarkFit, fit_marks, likeness
from cadcam.target.marks.ideal import marks_picture
from cadcam.target.marks.mark import dot, dot_and_ring
from cadcam.target.marks.model import affine, mark_model
from cadcam.target.marks.pose_ambiguity import fit_both_tilts

MOST = 2_000_000  # pixels of windows at a time


def _large(radius: float) -> tuple[Picture, Array, Array]:
    """Return a picture of a dot of that many px, its centre and its shape, px per mm."""
    side = int(2 * radius + 60)
    camera = Camera.from_focal((side, side), 500.0, cx=side / 2 + 0.3, cy=side / 2 - 0.2)
    mark = dot(20.0)
    pose = Rigid(np.eye(3), [0.0, 0.0, 500.0 * mark.radius / radius])
    rng = np.random.default_rng(4)
    picture = marks_picture([mark], camera, [pose], blur_px=0.8, noise=0.01, rng=rng, background=0.8, paper=0.8)
    return picture, np.array([side / 2 + 0.3, side / 2 - 0.2]), radius / mark.radius * np.eye(2)


def test_many_large_candidates_are_processed_in_batches(monkeypatch: pytest.MonkeyPatch) -> None:
    """The windows' squares stay below 2 million pixels at a time, and no mark's fit depends on the batches."""
    picture, centre, shape = _large(150.0)
    asked: list[int] = []

    def counted(gray: Picture, q: Array, reach: Array, step: int = 1) -> tuple[Array, Array, Array]:
        values, pixels, there = patches(gray, q, reach, step)
        asked.append(values.size)
        return values, pixels, there

    monkeypatch.setattr(window, "patches", counted)
    fit = fit_marks(picture, dot(20.0), np.tile(centre + 0.4, (30, 1)), np.tile(shape, (30, 1, 1)))
    assert sum(asked) > MOST > max(asked)
    assert len(fit) == 30
    assert np.ptp(fit.q, axis=0).max() < 1e-9
    assert np.abs(fit.q - centre).max() < 5 * np.sqrt(fit.covariance[:, [0, 1], [0, 1]]).max() + 0.004


def test_beside_a_large_mark_poses_of_small_ones_are_fitted_in_windows_of_their_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Twelve dots of 8 px and one of 150 px: in windows as large as its own they were nearly 3 million pixels."""
    camera = Camera.from_focal((900, 420), 800.0)
    places = [(x, y) for x in range(60, 460, 100) for y in range(60, 310, 100)]
    small = [Rigid(np.eye(3), [(x - 449.5) * 1.0, (y - 209.5) * 1.0, 800.0]) for x, y in places]
    mark = dot(16.0)  # 8 px at 800 mm
    large = Rigid(np.eye(3), np.array([680 - 449.5, 0, 800.0]) * 8 / 150)
    rng = np.random.default_rng(4)
    poses = [*small, large]
    picture = marks_picture([mark] * 13, camera, poses, blur_px=0.8, noise=0.01, rng=rng, background=0.8, paper=0.8)
    asked: list[int] = []

    def counted(gray: Picture, q: Array, reach: Array, step: int = 1) -> tuple[Array, Array, Array]:
        values, pixels, there = patches(gray, q, reach, step)
        asked.append(values.size)
        return values, pixels, there

    shapes = np.array([800.0 / pose.translation[2] * np.eye(2) for pose in poses])
    q = camera.project(np.array([pose.translation for pose in poses]))
    fit = fit_marks(picture, mark, q + 0.3, shapes)
    monkeypatch.setattr(window, "patches", counted)
    found = fit_both_tilts(picture, mark, camera, fit)
    assert sum(asked) < 400_000
    assert found.good.all()
    sd = np.sqrt(np.einsum("bii->bi", found.covariance))  # of the large one some px: both tilts fit it
    assert (np.abs(found.q - q) < 5 * sd + 0.01).all()
    assert found.poses is not None
    depth = np.array([pose.translation[2] for pose in found.poses])
    assert depth == pytest.approx([pose.translation[2] for pose in poses], rel=0.02)


def test_what_is_left_out_of_a_window_is_not_computed(rng: np.random.Generator) -> None:
    """Half of the pixels of fits without a wedge are left out: the others' values and slopes do not depend on that."""
    geometry = affine(turned=False, perspective=False)
    p = np.zeros((3, geometry.free + 3))
    p[:, geometry.levels] = [-0.6, 0.8, 0.8, 0.0, 0.0, 0.0, 3.0, 0.5]
    p[:, 2], p[:, geometry.places[4]] = 1.0, 1.0
    pixels, weight = rng.uniform(-15, 15, (3, 60, 2)), (rng.uniform(size=(3, 60)) < 0.5).astype(float)
    model = mark_model(dot(20.0), geometry, loose=3)
    (value, J), (some, slopes) = model(p, pixels), model(p, pixels, weight)
    assert np.abs(J).max() > 0
    np.testing.assert_array_equal(some, value * weight)
    np.testing.assert_array_equal(slopes, J * weight[..., None])
    with pytest.raises(BadValue, match="weight is of shape"):
        model(p, pixels, weight[:2])


def test_marks_fitted_on_all_cores_are_those_fitted_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Half-covered dots among clutter: the answers are in order, to the last bit."""
    rng = np.random.default_rng(7)
    picture = np.full((300, 400), 0.8, np.float32)
    y, x = np.mgrid[:300, :400]
    places = np.array([[x, y] for x in range(30, 390, 60) for y in range(40, 290, 80)]) + rng.uniform(-5, 5, (24, 2))
    for cx, cy in places:
        picture[np.hypot(x - cx, y - cy) < 9] = 0.2
        picture[np.hypot(x - cx - 8, y - cy) < 5] = rng.uniform(0.3, 1.0)
    picture += rng.normal(scale=0.01, size=picture.shape).astype(np.float32)
    shapes = np.tile(0.9 * np.eye(2), (24, 1, 1))
    several = fit_marks(picture, dot(20.0), places, shapes)
    monkeypatch.setattr("cadcam.cores.usable_cores", lambda: 1)
    one = fit_marks(picture, dot(20.0), places, shapes)
    assert (one.hidden > 0).sum() > 10
    for name in ("q", "covariance", "score", "hidden", "good"):
        np.testing.assert_array_equal(getattr(several, name), getattr(one, name))


@pytest.mark.parametrize("radius", [400.0, pytest.param(700.0, marks=pytest.mark.slow)])
def test_a_huge_mark_is_fitted_to_as_many_pixels_as_tell_its_place(radius: float) -> None:
    """All along its border, and no more than a few ten thousand within and around it."""
    picture, centre, shape = _large(radius)
    mark = dot(20.0)
    seen = window.Window.around(picture, centre[None], shape[None], mark, 0.7)
    assert 10 * radius < seen.values.shape[1] < 60_000
    fit = fit_marks(picture, mark, centre[None] + 0.4, shape[None])
    sigma = np.sqrt(np.diag(fit.covariance[0]))
    assert fit.good[0]
    assert sigma.max() < 0.01
    assert (np.abs(fit.q[0] - centre) < 5 * sigma + 0.004).all()


def test_no_motion_is_longer_than_the_window(rng: np.random.Generator) -> None:
    """The mean over it would take hundreds of times as long, and no mark would be seen."""
    mark, geometry = dot(20.0), affine(turned=False, perspective=False)
    p = np.zeros((2, geometry.free + 3))
    p[:, geometry.levels] = [-0.6, 0.8, 0.8, 0.0, 0.0, 0.0, 3.0, 0.0]
    p[:, 2], p[:, geometry.places[4]] = 1.0, 1.0
    p[1, geometry.motion] = 300.0, 400.0
    value, _ = mark_model(mark, geometry, loose=3)(p, rng.uniform(-15, 15, (2, 50, 2)))
    assert np.isfinite(value[0]).all()
    assert np.isnan(value[1]).all()


def test_candidates_larger_than_the_picture_are_not_tried() -> None:
    """The core of a mark twelve times its size may be seen where the mark itself cannot."""
    picture = np.pad(_large(25.0)[0], 60, mode="edge")
    assert len(mark_candidates(picture, dot(20.0), "blobs", None))
    assert not len(mark_candidates(picture, dot_and_ring(20.0, 220.0, 240.0), "blobs", None))


def test_thousands_of_candidates_are_first_compared_coarsely(monkeypatch: pytest.MonkeyPatch) -> None:
    """What is then compared in full is a small part of them; the mark is kept."""
    picture, centre, shape = _large(20.0)
    rng = np.random.default_rng(6)
    q = np.concatenate([centre[None], rng.uniform(0, picture.shape[0], (3000, 2))])
    seen = MarkCandidates(q, np.tile(shape, (len(q), 1, 1)))
    full: list[int] = []

    def counted(*given: object, **how: object) -> Array:
        if how.get("sparser", 1) == 1:
            full.append(len(given[2]))  # type: ignore[arg-type]
        return likeness(*given, **how)  # type: ignore[arg-type]

    monkeypatch.setattr(candidates, "likeness", counted)
    kept = screened(picture, dot(20.0), seen, most=10, margin=0.7)
    assert np.abs(kept.q[0] - centre).max() < 1.0
    assert sum(full) < 1000


def test_clutter_is_seen_for_what_it_is_before_covers_and_motion_are_looked_for(
    monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """Such a fit takes many times as long as a plain one; of the places that look like marks few get that far."""
    picture = np.full((240, 320), 0.5)
    for x, y, wide, high, level in rng.uniform((0, 0, 5, 5, 0), (320, 240, 60, 60, 1), (250, 5)):
        picture[int(y) : int(y + high), int(x) : int(x + wide)] = level
    picture = (gaussian_filter(picture, 2.0) + 0.01 * rng.standard_normal(picture.shape)).clip(0, 1)
    asked: list[tuple[int, bool]] = []

    def counted(gray: Picture, *given: Any, **how: Any) -> MarkFit:
        asked.append((len(given[1]), how.get("roughly", False)))
        return fit_marks(gray, *given, **how)

    monkeypatch.setattr(find, "fit_marks", counted)
    monkeypatch.setattr(candidates, "fit_marks", counted)
    mark = dot_and_ring(8.0, 16.0, 24.0)
    find_marks(picture, mark, radius_px=12.0)
    roughly, fully = (sum(n for n, rough in asked if rough is how) for how in (True, False))
    assert roughly > 20 > 5 > fully
