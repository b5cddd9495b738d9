"""Of a body that glare hides nothing is known, there or gone, and less light is asked for; in a shadow, more."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.arrays import Picture
from cadcam.geometry.rigid import Rigid
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import FeatureDeviation, State, Unclear
from cadcam.verify.inspection import inspect

from .scene import CAMERA, POSE, displaced, part, photographed, plate

BLOCK = (95.0, -40.0, 28.0)  # its middle


def near_block(gray: Picture, width_px: float) -> np.ndarray:
    """Return how near (H, W), 1 to 0, the pixels are to the middle of the block."""
    u, v = CAMERA.project(POSE @ np.array(BLOCK))
    y, x = np.mgrid[: gray.shape[0], : gray.shape[1]]
    return np.asarray(np.exp(-((((x - u) ** 2 + (y - v) ** 2) / (2 * width_px**2)) ** 2)))


def seen_in(picture: np.ndarray) -> dict[str, FeatureDeviation]:
    shown = np.asarray(np.round(np.clip(picture, 0, 1) * 255) / 255, np.float32)
    return {f.name: f for f in inspect(part(), [Photo.of(shown, CAMERA, POSE)], Rigid()).features}


@pytest.mark.parametrize("there", [True, False])
@pytest.mark.parametrize(("width_px", "glare"), [(24.0, 3.0), (30.0, 1.2), (36.0, 3.0)])
def test_what_is_in_glare_is_neither_there_nor_gone(
    rng: np.random.Generator, width_px: float, glare: float, there: bool
) -> None:
    """Taken for what the picture shows, white, it was missing: there is no edge, and no surface of its tone."""
    gray = photographed(plate() if there else displaced("block", None), rng)
    seen = seen_in(gray + glare * near_block(gray, width_px))
    assert (seen["block"].state, seen["block"].why) == (State.UNCLEAR, Unclear.WHITE)
    assert not any(f.state in (State.MISSING, State.DISPLACED) for f in seen.values())


def test_what_is_in_a_shadow_wants_more_light(rng: np.random.Generator) -> None:
    gray = photographed(plate(), rng)
    near = near_block(gray, 30.0)
    block = seen_in(gray * (1 - near) + 0.02 * near)["block"]
    assert block.state is not State.IN_PLACE
    assert block.why is not Unclear.WHITE
