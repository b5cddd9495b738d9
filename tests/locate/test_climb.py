"""Which of many poses are one."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.native.fields import firsts


@pytest.mark.parametrize(("most", "apart"), [(200, 0.0), (200, 0.4), (7, 0.4), (200, 9.0)])
def test_the_first_of_poses_that_are_near_each_other_is_kept(most: int, apart: float, rng: np.random.Generator) -> None:
    corners = rng.choice(rng.uniform(0, 1, (40, 4, 3)), 200) + rng.uniform(0, 0.1, (200, 4, 3))
    kept: list[int] = []
    for k in range(len(corners)):
        if len(kept) < most and all(np.linalg.norm(corners[k] - corners[j], axis=1).max() > apart for j in kept):
            kept.append(k)
    assert firsts(corners, most, apart).tolist() == kept


def test_of_no_poses_none_is_kept() -> None:
    assert len(firsts(np.zeros((0, 4, 3)), 5, 1.0)) == 0
