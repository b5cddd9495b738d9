"""The spot finder's response is the second weakest of eight steps, and its peaks are where spots are."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.errors import MissingCore
from cadcam.native import core
from cadcam.target.marks.spots import spot_response, spots

try:
    core.library()
except MissingCore as error:
    pytest.skip(str(error), allow_module_level=True)


@pytest.mark.parametrize("width", [61, 64, 67])  # rows that eight-wide steps do and do not fill
def test_the_response_is_the_second_weakest_step(width: int, rng: np.random.Generator) -> None:
    gray = rng.uniform(0, 1, (40, width)).astype(np.float32)
    response = spot_response(gray, 5.0, 2.0, dark=True)
    turn = np.arange(8) * np.pi / 4
    outer, inner = (np.rint(r * np.stack([np.cos(turn), np.sin(turn)], axis=-1)).astype(int) for r in (7.0, 3.0))
    reach = 7
    y, x = np.mgrid[reach : 40 - reach, reach : width - reach]
    steps = []
    for (ox, oy), (ix, iy) in zip(outer, inner, strict=True):
        out, in_ = gray[y + oy, x + ox], gray[y + iy, x + ix]
        steps.append((out - in_) / np.maximum(out + in_, np.float32(0.02)))
    assert np.allclose(response[reach:-reach, reach:-reach], np.sort(steps, axis=0)[1], atol=1e-6)
    assert (response[:reach] == -1).all()
    assert (response[:, -reach:] == -1).all()


@pytest.mark.parametrize("radius", [4.0, 9.0, 30.0])
def test_spots_are_found_to_a_third_of_their_radius(radius: float) -> None:
    x, y = np.meshgrid(np.arange(200.0), np.arange(160.0))
    gray = np.where(np.hypot(x - 90.3, y - 70.6) < radius, 0.2, 0.7).astype(np.float32)
    q, strength = spots(gray, radius, radius, dark=True)
    assert np.hypot(*(q - [90.3, 70.6]).T).max() < 0.35 * radius  # within it all places are as good without noise
    assert strength[0] > 0.5
    assert not len(spots(gray, radius, radius, dark=False)[0])
