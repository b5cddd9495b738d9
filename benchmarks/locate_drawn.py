"""Scenes whose camera, light, surfaces and cable are drawn at random, of parts that no constant was chosen on.

`drawn` is what benchmarks/locate_scene.py takes for a part that it has no setting for: the parts of
benchmarks/locate_battery.py, an angle plate, and any CAD file. A seed says everything, so that scenes which nobody has
looked at are one number away.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from battery_cases import PARTS
from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import circle, extruded, filled, moved, prism, turned
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady

SIZES = ((1024, 768), (960, 720), (768, 1024), (1100, 700))
Lamps = tuple[tuple[tuple[float, float, float], float, float], ...]
Cable = tuple[tuple[float, float, float], ...]


@dataclass(frozen=True)
class Drawn:
    """What a seed says of a scene; distance in mm, lamps as in `locate_traced.LAMPS`, a cable as points of the part."""

    model: Callable[[], Mesh]
    traced: Callable[[], Mesh]
    cable: Cable
    camera: Camera
    distance: tuple[float, float]
    elevation_deg: tuple[float, float]
    lamps: Lamps
    albedo: tuple[float, float]
    roughness: float


def angle_plate(*, sides: int = 96) -> Mesh:
    """Return two plates at a right angle with a gusset off the middle, three holes and a slot, from z = 0 up."""
    foot_holes = [circle((22, 20), 6.5, sides), circle((92, 20), 6.5, sides)]
    ground = np.array([(0, 0), (110, 0), (110, 60), (0, 60)], float)
    foot = extruded([filled(ground, foot_holes)], 0, 9, name="foot", color=None)
    wall_holes = [circle((36, 44), 11, sides), np.array([(64, 30), (96, 30), (96, 42), (64, 42)], float)]
    outline = np.array([(0, 9), (110, 9), (110, 52), (82, 74), (0, 74)], float)
    upright = extruded([filled(outline, wall_holes)], 0, 8, name="wall", color=None)
    wall = moved(turned(upright, "xz"), (0, 60, 0))
    gusset = turned(prism(np.array([(14, 9), (52, 9), (52, 46)], float), 48, 55, name="gusset", color=None), "yz")
    return merge([foot, wall, gusset])


def drawn(part: str, seed: int, data: Path | None) -> Drawn:
    """Return the scene of a part by its name, or by its CAD file, that a seed draws."""
    model, traced = _meshes(part, data)
    mesh, rng = model(), np.random.default_rng([seed, 77])
    reach, low, high = float(np.linalg.norm(mesh.size_mm) / 2), *mesh.bounds
    size = SIZES[rng.integers(len(SIZES))]
    focal = max(size) / 2 / np.tan(np.radians(rng.uniform(28.0, 62.0) / 2))
    aside = rng.uniform(-0.03, 0.03, 2) * size
    corner = np.hypot(*size) / 2 / focal
    k1 = rng.uniform(-0.14, 0.05) / corner**2  # so many parts of the radius in the corner
    camera = Camera.from_focal(
        size,
        focal,
        fy=focal * rng.uniform(0.997, 1.003),
        cx=size[0] / 2 + aside[0],
        cy=size[1] / 2 + aside[1],
        lens=BrownConrady(k1, -0.3 * k1, *rng.uniform(-1e-3, 1e-3, 2)),
    )
    near = 2 * reach * focal / min(size)
    lamps: Lamps = tuple((_place(rng), float(rng.uniform(0.3, 1.6)), float(rng.uniform(3, 10))) for _ in range(2))
    return Drawn(
        model,
        traced,
        _cable(low, high, reach, rng),
        camera,
        (near / 0.75, near / 0.45),
        (22.0, 62.0),
        (*lamps, ((0, 0, 12), 9.0, float(rng.uniform(0.1, 0.4)))),
        (float(rng.uniform(0.2, 0.7)), float(rng.uniform(0.12, 0.6))),
        float(rng.uniform(0.15, 0.5)),
    )


def _meshes(part: str, data: Path | None) -> tuple[Callable[[], Mesh], Callable[[], Mesh]]:
    """Return what makes the model, and what makes the rounder body that is photographed."""
    if part == "angle plate":
        return angle_plate, partial(angle_plate, sides=384)
    if part in PARTS:
        return PARTS[part], PARTS[part]
    path = Path(part) if data is None else data / "cad_nist_ctc" / f"{part}_asme1_ap203.stp"
    return partial(read_model, path), partial(read_model, path, chordal_tolerance_mm=0.02)


def _place(rng: np.random.Generator) -> tuple[float, float, float]:
    """Return where a lamp stands, in reaches of the part."""
    angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 6.0)
    return float(far * np.cos(angle)), float(far * np.sin(angle)), float(rng.uniform(4.0, 8.0))


def _cable(low: Array, high: Array, reach: float, rng: np.random.Generator) -> Cable:
    """Return points of a cable from one side of the part over it to the other."""
    angle, aside = rng.uniform(0, np.pi), rng.uniform(-0.3, 0.3) * reach
    along, across = np.array([np.cos(angle), np.sin(angle)]), np.array([-np.sin(angle), np.cos(angle)])
    top = high[2] - low[2] + 0.12 * reach
    heights = (0.05 * reach, 0.55 * top, 1.3 * top, 0.7 * top, 0.05 * reach)
    middle = (low + high)[:2] / 2 + aside * across
    places = [middle + far * reach * along for far in (-2.4, -1.2, rng.uniform(-0.2, 0.2), 1.2, 2.4)]
    return tuple((float(x), float(y), float(low[2] + h)) for (x, y), h in zip(places, heights, strict=True))
