"""Random cameras of every lens, and poses: what the tests of the foreign formats run over."""

from __future__ import annotations

import numpy as np

from cadcam.camera.camera import Camera
from cadcam.camera.lens import (
    BrownConrady,
    Division,
    DoubleSphere,
    ExtendedUnified,
    FieldOfView,
    Fisheye,
    Ideal,
    InverseBrownConrady,
    Lens,
    OddRadial,
    TiltedBrownConrady,
)
from cadcam.files.foreign.losses import fits
from cadcam.files.foreign.model import Holds
from cadcam.geometry.rigid import Rigid


def random_lenses(rng: np.random.Generator) -> list[Lens]:
    """Lenses that image the whole picture of `random_camera`, with and without each family's later terms."""

    def some(*sizes: float) -> list[float]:
        return [float(rng.uniform(-s, s)) for s in sizes]

    radial = float(rng.uniform(-0.2, -0.05))
    return [
        Ideal(),
        BrownConrady(radial),
        BrownConrady(radial, *some(0.02, 2e-3, 2e-3)),
        BrownConrady(radial, *some(0.02, 2e-3, 2e-3, 0.01)),
        BrownConrady(radial, *some(0.02, 2e-3, 2e-3, 0.01, 0.02, 0.02, 0.01)),
        BrownConrady(radial, *some(0.02, 2e-3, 2e-3, 0.01, 0.02, 0.02, 0.01, 1e-3, 1e-3, 1e-3, 1e-3)),
        TiltedBrownConrady(radial, *some(0.02, 2e-3, 2e-3, 0.01, 0, 0, 0, 0, 0, 0, 0, 0.1, 0.1)),
        InverseBrownConrady(-radial, *some(0.02, 2e-3, 2e-3, 0.01)),
        OddRadial(*some(0.02), radial, *some(0.02, 0.01)),
        Division(radial),
        Fisheye(*some(0.02, 0.01, 0.001, 0.0005)),
        FieldOfView(float(rng.uniform(0.3, 1.0))),
        ExtendedUnified(float(rng.uniform(0.2, 0.7)), float(rng.uniform(0.8, 1.3))),
        DoubleSphere(float(rng.uniform(-0.3, 0.2)), float(rng.uniform(0.3, 0.6))),
    ]


def random_camera(rng: np.random.Generator, lens: Lens, *, holds: Holds | None = None) -> Camera:
    """A camera with this lens, restricted to what a format can hold if it is given."""
    width, height = (int(n) for n in rng.integers(300, 3000, 2))
    focal = float(rng.uniform(1.1, 1.8)) * max(width, height)
    free = holds is None or holds.principal_point
    return Camera.from_focal(
        (width, height),
        focal,
        fy=focal * float(rng.uniform(0.95, 1.05)),
        cx=width * float(rng.uniform(0.4, 0.6)) if free else None,
        cy=height * float(rng.uniform(0.4, 0.6)) if free else None,
        skew=float(rng.uniform(-3, 3)) if holds is None or holds.skew == "yes" else 0.0,
        lens=lens,
    )


def lenses_held(rng: np.random.Generator, holds: Holds) -> list[Lens]:
    """The random lenses that a format has a place for."""
    return [lens for lens in random_lenses(rng) if fits(lens, holds)]


def random_pose(rng: np.random.Generator) -> Rigid:
    """A pose 0.1 to 3 m away, turned any way."""
    return Rigid.exp(np.concatenate([rng.uniform(-3000, 3000, 3), rng.normal(size=3)]))
