"""Equivalent forms of a camera: lenses that are special cases of one another, with the matching camera matrix."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import (
    BrownConrady,
    DoubleSphere,
    ExtendedUnified,
    Ideal,
    OddRadial,
    TiltedBrownConrady,
)


def equivalents(camera: Camera) -> Iterator[Camera]:
    """Yield the camera and all its other forms known to this package: equal for all points up to rounding.

    The simplest lens comes last.
    """
    yield camera
    lens = camera.lens
    if isinstance(lens, Ideal):
        return
    if _does_nothing(camera):
        yield replace(camera, lens=Ideal())
    elif isinstance(lens, TiltedBrownConrady) and not (lens.tau_x or lens.tau_y):
        yield from equivalents(replace(camera, lens=BrownConrady(*list(lens.parameters.values())[:12])))
    elif isinstance(lens, OddRadial):
        yield from equivalents(_scaled(camera, lens))
    elif isinstance(lens, DoubleSphere) and not lens.xi:
        yield replace(camera, lens=ExtendedUnified(lens.alpha, 1.0))


def _does_nothing(camera: Camera) -> bool:
    if isinstance(camera.lens, ExtendedUnified):
        return not camera.lens.alpha
    return camera.lens.name != "fisheye" and not any(camera.lens.parameters.values())


def _scaled(camera: Camera, lens: OddRadial) -> Camera:
    """Return the odd polynomial as Brown-Conrady: u (1 + a1 + a3 r^2 + ...) = (1 + a1) u (1 + k1 r^2 + ...)."""
    scale = 1 + lens.a1
    K = camera.K @ np.diag([scale, scale, 1.0])
    return replace(camera, K=K, lens=BrownConrady(k1=lens.a3 / scale, k2=lens.a5 / scale, k3=lens.a7 / scale))
