"""Tables of a lens: one for all renderers, no more of them than the memory set aside for them."""

from __future__ import annotations

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.geometry.rigid import Rigid
from cadcam.render.lens_tables import TABLE_BYTES, LensTables
from cadcam.render.thin_lens import ThinLens

CAMERA = Camera.from_focal((40, 30), 50.0, lens=BrownConrady(k1=-0.1))
ONE = TABLE_BYTES * 40 * 30


def test_a_camera_like_another_gets_the_same_table() -> None:
    tables = LensTables()
    again = Camera.from_focal((40, 30), 50.0, lens=BrownConrady(k1=-0.1))
    assert tables.table(CAMERA, 1) is tables.table(again, 1)


def test_other_lenses_sizes_and_samples_get_others() -> None:
    tables = LensTables()
    others = [
        (CAMERA, 2),
        (Camera.from_focal((40, 30), 50.0, lens=BrownConrady(k1=-0.2)), 1),
        (CAMERA.crop(1, 0, (40, 30)), 1),
    ]
    made = [tables.table(CAMERA, 1), *(tables.table(camera, n) for camera, n in others)]
    assert len(set(map(id, made))) == 4
    assert made[1].size == (80, 60)


def test_the_one_used_longest_ago_goes_where_memory_is_short() -> None:
    tables = LensTables(kept_bytes=2 * ONE)
    first, second, third = (Camera.from_focal((40, 30), f, lens=BrownConrady(k1=-0.1)) for f in (50.0, 51.0, 52.0))
    kept, gone = tables.table(first, 1), tables.table(second, 1)
    assert tables.table(first, 1) is kept
    tables.table(third, 1)
    assert tables.table(first, 1) is kept
    assert tables.table(second, 1) is not gone


def test_a_large_table_is_kept_alone_until_another_is_made() -> None:
    """A service whose lens changes from picture to picture holds one; one with one lens makes it once."""
    tables = LensTables(kept_bytes=ONE // 2)
    kept = tables.table(CAMERA, 1)
    assert tables.table(CAMERA, 1) is kept
    tables.table(Camera.from_focal((20, 15), 50.0, lens=BrownConrady(k1=-0.1)), 1)
    assert tables.table(CAMERA, 1) is not kept
    tables = LensTables(kept_bytes=ONE // 2 - 1)
    assert tables.table(CAMERA, 1) is not tables.table(CAMERA, 1)


def test_lenses_that_nobody_asks_for_again_are_not_kept() -> None:
    tables = LensTables(kept_bytes=ONE)
    kept = tables.table(CAMERA, 1)
    pinhole = ThinLens(CAMERA, None).pinhole(Rigid(), np.array([0.1, 0.2]), np.zeros(2))
    tables.table(pinhole.camera, 1)
    assert tables.table(CAMERA, 1) is kept
