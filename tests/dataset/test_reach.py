"""Where a part may be imaged beyond the border: never too small, and through a lens as tight as its outline allows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import cadcam.dataset.reach as module
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye, Ideal, Lens
from cadcam.dataset.reach import beyond, reach
from cadcam.dataset.view_renderer import NOWHERE
from cadcam.geometry.rigid import Rigid
from cadcam.native.layers import mask_region
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Look

from .sets import inputs_and_sampler, plan, renderer_of, scene

SIZE = (160, 120)
LENSES = {
    "ideal": Ideal(),
    "barrel": BrownConrady(-0.2, 0.03, 2e-3, -1e-3),
    "narrow": BrownConrady(-0.3),  # images nothing beyond 46 degrees from the axis, 12 px outside of the picture
    "pincushion": BrownConrady(0.15),
    "fisheye": Fisheye(0.02, -0.01),
}


def poses(n: int) -> list[Rigid]:
    """Return poses with the part about the border, some of them around the camera."""
    rng = np.random.default_rng(8)
    out = []
    for _ in range(n):
        towards = rng.normal(size=3)
        eye = rng.uniform(1.2, 6) * np.linalg.norm(scene().mesh.size_mm) / 2 * towards / np.linalg.norm(towards)
        aside = Rigid.exp(np.concatenate([np.zeros(3), rng.normal(0, 0.5, 3)]))
        out.append(aside @ Rigid.look_at(eye, [0.0, 0, 0]))
    return out


@pytest.mark.parametrize("lens", LENSES.values(), ids=list(LENSES))
def test_silhouettes_are_those_of_the_whole_canvas(lens: Lens, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three pictures wide and high, as BOP counts; drawn are a good deal fewer pixels."""
    monkeypatch.setattr(module, "KEPT_BYTES", 0)  # as in pictures too large for tables to be kept
    camera = Camera.from_focal(SIZE, 130.0, lens=lens)
    renderer, part = renderer_of(inputs_and_sampler(plan())[0]), RasterRenderer(scene(), threads=1)
    (width, height), shot, drawn, cut_off = SIZE, inputs_and_sampler(plan())[1].shot(0), 0, 0
    for pose in poses(30):
        wide = part.render(camera.crop(-width, -height, (3 * width, 3 * height)), pose, channels=Channel.DEPTH).depth
        count, box = mask_region(wide < np.inf)
        own = mask_region(wide[height : 2 * height, width : 2 * width] < np.inf)
        expected = (box[0] - width, box[1] - height, box[2] - width, box[3] - height) if count else NOWHERE
        assert renderer._silhouette(replace(shot, camera=camera, camera_from_part=pose), *own) == (count, expected)
        left, top, right, bottom = reach(camera, pose @ scene().mesh.vertices, samples=Look().supersampling)
        drawn += sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in beyond((left, top, right, bottom), SIZE))
        cut_off += count > own[0]
    assert cut_off > 10
    assert drawn < 0.6 * 30 * 8 * width * height


def test_of_small_pictures_the_area_is_one_so_that_its_table_returns() -> None:
    camera = Camera.from_focal(SIZE, 130.0, lens=LENSES["barrel"])
    areas = {reach(camera, pose @ scene().mesh.vertices, samples=3) for pose in poses(5)}
    assert areas == {(-160, -120, 320, 240)}


@pytest.mark.parametrize(
    "area", [(-5, -7, 12, 9), (2, 3, 6, 5), (-5, 2, -1, 4), (12, 1, 15, 3), (3, -4, 5, -1), (-2, 9, 3, 12)]
)
def test_what_lies_beyond_a_picture_is_each_pixel_once(area: tuple[int, int, int, int]) -> None:
    grid = np.zeros((40, 40), int)
    for x0, y0, x1, y1 in beyond(area, (10, 8)):
        grid[y0 + 20 : y1 + 20, x0 + 20 : x1 + 20] += 1
    expected = np.zeros((40, 40), int)
    expected[area[1] + 20 : area[3] + 20, area[0] + 20 : area[2] + 20] = 1
    expected[20:28, 20:30] = 0
    np.testing.assert_array_equal(grid, expected)
