"""Direction fields: lines of any direction, contrast and lens are seen alike; noise is not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Division, Ideal
from cadcam.errors import MissingCore
from cadcam.image.direction_field import SECTORS, direction_fields
from cadcam.native import core

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)

SIZE = (161, 121)
CAMERA = Camera.from_focal(SIZE, 150.0)


def half_plane(angle: float, *, contrast: float = 0.6, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return a picture whose right half, turned by `angle` about its middle, is brighter; blurred as by a lens."""
    x, y = np.meshgrid(np.arange(size[0]) - size[0] // 2, np.arange(size[1]) - size[1] // 2)
    edge = np.clip(x * np.cos(angle) + y * np.sin(angle) + 0.5, 0, 1)
    return gaussian_filter(0.5 + contrast * (edge - 0.5), 0.7).astype(np.float32)


@pytest.mark.parametrize("degrees", [0, 22.5, 45, 80, 100, 135, 170])
def test_an_edge_is_sure_in_the_sector_of_its_normal_and_nowhere_across(degrees: float) -> None:
    angle = np.radians(degrees)
    field = direction_fields(half_plane(angle), CAMERA, levels=1)[0]
    along = np.arange(-30, 31, 5)
    x, y = np.rint([80 - along * np.sin(angle), 60 + along * np.cos(angle)]).astype(int)
    best = max_around(field.planes.values, x, y) / 255
    own = round(angle / (np.pi / SECTORS)) % SECTORS
    across = (own + SECTORS // 2) % SECTORS
    assert best[own].min() > 0.5
    assert best[across].max() < 0.02
    assert field.planes.values[own].mean() < 5  # and only there


def max_around(planes: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.max([planes[:, y + j, x + i] for i in (-1, 0, 1) for j in (-1, 0, 1)], axis=0)


def test_contrast_and_exposure_do_not_count() -> None:
    strong = direction_fields(half_plane(0.4), CAMERA, levels=1)[0].planes.values
    weak = direction_fields(0.2 + 0.3 * half_plane(0.4), CAMERA, levels=1)[0].planes.values
    on = strong.max(axis=0) > 128
    assert on.sum() > 100
    assert np.median(np.abs(strong.max(axis=0)[on].astype(int) - weak.max(axis=0)[on])) < 8


def test_noise_alone_is_nearly_nothing_whatever_its_level(rng: np.random.Generator) -> None:
    noise = rng.normal(size=SIZE[::-1])
    means = [
        direction_fields((0.5 + sigma * noise).astype(np.float32), CAMERA, levels=1)[0].planes.mean.mean()
        for sigma in (0.01, 0.03, 0.08)
    ]
    assert max(means) < 0.05 * 255
    assert max(means) < 1.05 * min(means)


def test_a_line_stays_as_sure_on_every_level() -> None:
    x = np.full(SIZE[::-1], 0.3, np.float32)
    x[:, 79:82] = 0.8  # a bar three px wide: both its sides, which would cancel if the picture itself were made smaller
    fields = direction_fields(gaussian_filter(x, 0.7), CAMERA, levels=4)
    assert [f.reduction for f in fields] == [1, 2, 4, 8]
    for field in fields:
        row = field.planes.values[0, field.camera.height // 2]
        assert row.max() > 0.5 * 255
        assert abs((np.argmax(row) + 0.5) * field.reduction - 0.5 - 80) <= 2.5 + field.reduction / 2


def test_cameras_of_fields_see_the_photo_s_points_where_its_pixels_are() -> None:
    camera = Camera.from_focal((203, 151), 150.0, fy=160.0, skew=3.0)
    p = np.array([[0.1, -0.2, 1.0], [-0.4, 0.3, 1.2]])
    region = (11, 6, 197, 149)
    for field in direction_fields(np.full((151, 203), 0.5), camera, reduction=3, levels=2, region=region):
        expected = (camera.project(p) - region[:2] + 0.5) / field.reduction - 0.5
        assert np.allclose(field.camera.project(p), expected, rtol=0, atol=1e-9)


def test_through_a_lens_the_field_is_that_of_an_ideal_camera() -> None:
    camera = Camera.from_focal(SIZE, 110.0, lens=Division(-0.4))
    ray = camera.unproject(camera.pixel_grid())
    photo = np.clip(
        (ray[..., 0] / ray[..., 2] - 0.35) * 110 + 0.5, 0, 1
    )  # a plane's edge at x/z = 0.35, bent by the lens
    field = direction_fields(gaussian_filter(photo, 0.7).astype(np.float32), camera, levels=1)[0]
    y = np.linspace(-0.3, 0.3, 13)
    q = np.rint(field.camera.project(np.column_stack([np.full(13, 0.35), y, np.ones(13)]))).astype(int)
    bent = camera.project(np.array([[0.35, -0.3, 1.0], [0.35, 0.0, 1.0]]))
    assert abs(bent[0, 0] - bent[1, 0]) > 0.8  # else the lens would not matter
    assert max_around(field.planes.values, *q.T)[0].min() > 0.5 * 255
    assert field.camera.lens == Camera.from_focal(SIZE, 1.0).lens


@pytest.mark.parametrize(("fx", "fy", "skew"), [(75.0, 150.0, 0.0), (150.0, 75.0, 0.0), (150.0, 150.0, 60.0)])
def test_pixels_far_from_square_become_square_ones(fx: float, fy: float, skew: float) -> None:
    camera = Camera.from_focal((161, 121), fx, fy=fy, skew=skew)
    ray = camera.unproject(camera.pixel_grid())
    normal, along = np.array([np.cos(0.6), np.sin(0.6), 0.0]), np.array([-np.sin(0.6), np.cos(0.6), 0.0])
    photo = np.clip((ray / ray[..., 2:]) @ normal * np.sqrt(fx * fy) + 0.5, 0, 1)  # the edge of a half plane
    field = direction_fields(gaussian_filter(photo, 0.7).astype(np.float32), camera, levels=1)[0]
    on = np.linspace(-0.2, 0.2, 9)[:, None] * along + [0, 0, 1]
    across = on + 1e-3 * normal  # across the edge in space, and with square pixels in the field too
    q = field.camera.project(on)
    d = field.camera.project(across) - q
    assert np.allclose(np.arctan2(d[:, 1], d[:, 0]), 0.6, rtol=0, atol=1e-9)
    assert field.camera.skew == 0
    assert field.camera.fx == pytest.approx(np.sqrt(fx * fy)) == field.camera.fy
    sector = round(0.6 / (np.pi / SECTORS))
    assert max_around(field.planes.values, *np.rint(q).astype(int).T)[sector].min() > 0.5 * 255


def test_what_lies_far_away_does_not_count(rng: np.random.Generator) -> None:
    """An edge is judged against what is within some pixels of it, not against the picture's border."""
    picture = half_plane(0.4)
    cluttered = picture.copy()
    cluttered[:10] = rng.random((10, SIZE[0]))
    one, other = (direction_fields(p, CAMERA, levels=1)[0].planes.values.astype(int) for p in (picture, cluttered))
    assert np.abs(one[:, :10] - other[:, :10]).max() > 100
    assert np.abs(one[:, 20:] - other[:, 20:]).max() <= 1  # sums of floats, cut to bytes


def test_a_region_shows_what_the_whole_photo_shows_there() -> None:
    """Through a lens too, where the region is the photo's and the field is straightened."""
    for lens in (Ideal(), Division(-0.2)):
        camera = Camera.from_focal(SIZE, 130.0, cx=70.0, lens=lens)
        whole = direction_fields(half_plane(0.4), camera, levels=1)[0]
        region = (38, 21, 121, 98)
        part = direction_fields(half_plane(0.4), camera, levels=1, region=region)[0]
        x, y = np.rint(whole.camera.principal_point - part.camera.principal_point).astype(int)
        inner = part.planes.values[:, 8:-8, 8:-8]  # beyond the region nothing counts as clutter
        of_whole = whole.planes.values[:, y + 8 :, x + 8 :][:, : inner.shape[1], : inner.shape[2]]
        assert inner.shape[1] >= region[3] - region[1] - 18
        assert inner.max() > 128
        assert np.array_equal(inner, of_whole)


def test_instruction_sets_give_the_same_field(rng: np.random.Generator) -> None:
    if core.choose_variant(-1) == "baseline":
        pytest.skip("this processor has the baseline only")
    picture = gaussian_filter(rng.random(SIZE[::-1]), 1.5).astype(np.float32)
    try:
        fields = []
        for level in (-1, 0):
            core.choose_variant(level)
            fields.append(direction_fields(picture, CAMERA, levels=2))
        for fast, slow in zip(*fields, strict=True):
            assert np.array_equal(fast.planes.values, slow.planes.values)
    finally:
        core.choose_variant(-1)


@pytest.mark.parametrize("how", ["ideal", "lens", "oblong"])
def test_the_photo_s_border_is_no_line_and_hides_none(how: str, rng: np.random.Generator) -> None:
    """What was made straight had black beyond the photo: its border was the surest line, those beside it the least."""
    lens = {"ideal": Camera.from_focal((320, 240), 300.0), "oblong": Camera.from_focal((320, 240), 300.0, fy=200.0)}
    camera = lens.get(how) or Camera.from_focal((320, 240), 300.0, lens=BrownConrady(k1=-0.02))
    photo = np.full((240, 320), 0.5)
    photo[235:] += 0.06
    photo = gaussian_filter(photo, 0.7) + 0.005 * rng.normal(size=photo.shape)
    field = direction_fields(photo.astype(np.float32), camera, levels=1)[0]
    best, x = field.planes.values.max(axis=0), np.arange(60.0, 260.0)

    def sure(row: float) -> float:
        q = np.rint(field.camera.project(camera.unproject(np.stack([x, np.full(len(x), row)], axis=1)))).astype(int)
        near = [best[np.clip(q[:, 1] + k, 0, len(best) - 1), q[:, 0]] for k in (-1, 0, 1, 2)]
        return float(np.max(near, axis=0).mean())

    assert sure(234.5) > 200  # 4.5 px from the border
    assert sure(0.0) < 60


def test_mean_and_variance_are_those_of_what_is_open(rng: np.random.Generator) -> None:
    photo = gaussian_filter(rng.normal(0.5, 0.3, SIZE[::-1]), 2.0).astype(np.float32)
    known = np.zeros(SIZE[::-1], bool)
    known[:, :70] = True
    for camera in (CAMERA, Camera.from_focal(SIZE, 110.0, lens=Division(-0.4))):
        for field in direction_fields(photo, camera, levels=2, explained=known):
            every = field.planes.values.reshape(len(field.planes.values), -1).astype(np.float64)
            np.testing.assert_allclose(field.planes.mean, every.mean(axis=1), rtol=1e-3)
            np.testing.assert_allclose(field.planes.variance, every.var(axis=1), rtol=1e-3)
