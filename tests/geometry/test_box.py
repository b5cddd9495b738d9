"""Lines cut by a box: held against points all along them."""

from __future__ import annotations

import numpy as np

from cadcam.geometry.box import clipped_to_box

BOX = np.array([[-1.0, -2.0, 0.0], [2.0, 1.0, 3.0]])


def test_a_part_of_a_line_in_a_box_is_where_its_points_are(rng: np.random.Generator) -> None:
    """Lines anywhere, along one axis, and in the planes of the box."""
    ends = rng.uniform(-4, 4, (300, 2, 3))
    ends[100:200, 1, 1:] = ends[100:200, 0, 1:]
    ends[200:, :, 0] = rng.choice(BOX[:, 0], 100)[:, None]
    inside, cut = clipped_to_box(ends, BOX)
    assert inside.any()
    assert not inside.all()
    t = np.linspace(0, 1, 2001)[:, None]
    for line, has, part in zip(ends, inside, cut, strict=True):
        points = line[0] + t * (line[1] - line[0])
        held = points[((points >= BOX[0]) & (points <= BOX[1])).all(axis=1)]
        step = np.linalg.norm(line[1] - line[0]) / 2000
        if not has:
            assert len(held) <= 1
            np.testing.assert_array_equal(part, line)
        elif len(held):
            assert np.linalg.norm(part - held[[0, -1]], axis=1).max() <= step * (1 + 1e-9)


def test_a_line_that_touches_a_corner_has_no_part_in_the_box() -> None:
    corner = np.array([BOX[1] - [1.0, -1.0, 0.0], BOX[1] + [1.0, -1.0, 0.0]])
    assert not clipped_to_box(corner[None], BOX)[0].any()
