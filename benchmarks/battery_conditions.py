"""The conditions of benchmarks/locate_battery.py: the special settings of each; the rest is drawn at random."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from battery_pictures import Surface
from battery_wrong import (
    Model,
    Told,
    blurred,
    focal,
    lengthened,
    mirrored,
    one_bay_off,
    other_holes,
    other_lens,
    other_size,
    saturated,
    stretched,
    upside_down,
)
from cadcam.arrays import Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.read import read_model
from cadcam.cad.write import write_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Fisheye
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.charge import Noise
from cadcam.image.sensor.light import Blur, Motion, Vignetting
from cadcam.image.sensor.sensor import Sensor
from cadcam.image.sensor.video import EdgeEnhancement, Gain, Gamma

SENSOR = Sensor(noise=Noise(12_000, 20))
STEEL, DARK = (0.5, 0.5, 0.5), (0.07, 0.07, 0.07)
OWN = "bracket", "ship block", "bench", "flange", "step block"  # the parts of benchmarks/battery_cases.py
NIST = tuple(f"nist_ctc_0{i}" for i in range(1, 6))
PLAIN, GROUND = Surface(STEEL, 0.06), Surface((0.3, 0.3, 0.3), 0.15)


@dataclass(frozen=True)
class Condition:
    """What is special: all else is drawn plainly. hidden: share of the part behind a box; cut: outside the picture."""

    camera: Callable[[np.random.Generator], Camera] = lambda rng: Camera.from_focal((800, 600), rng.uniform(800, 1500))
    size: tuple[float, float] = (0.45, 0.75)  # of the part's diagonal over the picture's shorter side
    part: Surface = PLAIN
    ground: Surface = GROUND
    lamps: int = 3
    ambient: float = 0.45
    hidden: float = 0.0
    cable: bool = False
    clutter: int = 3
    cut: float = 0.0
    sensor: Sensor = SENSOR
    color: bool = False
    suffix: str = ".png"
    model: Callable[[Mesh, Path], Mesh] = lambda mesh, folder: mesh
    renderer: str = "own"
    search: str = ""  # "range": without a start in a declared range; "sphere": from anywhere
    absent: str = ""  # what is before the camera instead: "part", "mirrored", "upside down"
    parts: tuple[str, ...] = ()  # of these, not of all
    cad: Model | None = None  # makes the model that is given of the one that is photographed, corner by corner
    kin: Model | None = None  # or one of its family, which stands where it does
    told: Told | None = None  # makes the camera that is told of the one that took the picture
    spoilt: Callable[[Picture], Picture] = lambda taken: taken
    start: Callable[[Rigid, np.random.Generator], Rigid] | None = None  # makes starts of the true pose
    turned: bool = False  # starts are half a turn off, about one of the model's axes
    twin: bool = False  # a second part of the same kind stands beside it


def _written(unit: str, suffix: str) -> Callable[[Mesh, Path], Mesh]:
    """Return what writes a model in a unit and reads it again."""
    mm = {"m": 1000.0, "in": 25.4}[unit]

    def round_trip(mesh: Mesh, folder: Path) -> Mesh:
        path = folder / f"model_{unit}{suffix}"
        write_model(path, mesh.scaled(1 / mm))
        return read_model(path, unit=unit)

    return round_trip


def _doubled(mesh: Mesh, folder: Path) -> Mesh:
    """Return the model as a file holds it that has the part twice in one place, as careless exports do."""
    path = folder / "model_doubled.obj"
    write_model(path, merge([mesh, mesh]))
    return read_model(path, unit="mm")


def _focal(width: int, field_deg: float) -> float:
    """Return the focal length (px) of a camera whose picture, so wide (px), spans that field."""
    return float(width / 2 / np.tan(np.radians(field_deg) / 2))


def _wide(rng: np.random.Generator) -> Camera:
    return Camera.from_focal((960, 720), _focal(960, rng.uniform(60, 80)))


CONDITIONS: dict[str, Condition] = {
    "plain": Condition(),
    "wide, 90 deg": Condition(camera=lambda rng: Camera.from_focal((960, 720), _focal(960, 90.0))),
    "long lens, 6 deg": Condition(camera=lambda rng: Camera.from_focal((800, 600), _focal(800, 6.0))),
    "4 Mpx": Condition(camera=lambda rng: Camera.from_focal((2400, 1700), _focal(2400, 35.0))),
    "640 x 480": Condition(camera=lambda rng: Camera.from_focal((640, 480), _focal(640, 45.0))),
    "principal point off": Condition(
        camera=lambda rng: Camera.from_focal(
            (800, 600), _focal(800, 40.0), cx=400 + rng.uniform(120, 200), cy=300 - rng.uniform(80, 140)
        )
    ),
    "aspect and skew": Condition(
        camera=lambda rng: Camera.from_focal((800, 600), _focal(800, 40.0), fy=820.0, skew=rng.uniform(30, 60))
    ),
    "strong Brown-Conrady": Condition(
        camera=lambda rng: Camera.from_focal(
            (800, 600), _focal(800, 65.0), lens=BrownConrady(-0.32, 0.13, 2e-3, -1.5e-3, -0.02)
        )
    ),
    "fisheye": Condition(camera=lambda rng: Camera.from_focal((900, 900), 300.0, lens=Fisheye(0.03, -0.01, 2e-3, 0.0))),
    "print and grain": Condition(
        part=Surface(STEEL, 0.25, 6.0, 0.55), ground=Surface((0.35, 0.35, 0.35), 0.4, 8.0, 0.5)
    ),
    "glossy": Condition(part=Surface(STEEL, 0.05, gloss=0.8)),
    "metal": Condition(part=Surface((0.6, 0.6, 0.6), 0.04, metal=0.75, gloss=0.3)),
    "dark on dark": Condition(part=Surface(DARK, 0.1), ground=Surface((0.09, 0.09, 0.09), 0.15), clutter=4),
    "low contrast": Condition(sensor=replace(SENSOR, gain=Gain(0.16, 0.45))),
    "one hard lamp": Condition(lamps=1, ambient=0.12),
    "even light": Condition(lamps=0, ambient=1.0),
    "in colour": Condition(part=Surface((0.6, 0.2, 0.12), 0.08), ground=Surface((0.2, 0.28, 0.35), 0.25), color=True),
    "a third hidden by a box": Condition(hidden=0.33),
    "cables": Condition(cable=True),
    "clutter": Condition(clutter=14, ground=Surface((0.3, 0.3, 0.3), 0.3, 8.0, 0.6)),
    "a third outside": Condition(cut=0.33),
    "JPEG 60": Condition(suffix=".jpg"),
    "motion blur, 5 px": Condition(sensor=replace(SENSOR, motion=Motion((4.0, 3.0)))),
    "out of focus, 3 px": Condition(sensor=replace(SENSOR, blur=Blur(0.0, 3.0))),
    "vignetting": Condition(sensor=replace(SENSOR, vignetting=Vignetting(a2=-0.75))),
    "gamma 1/2.2": Condition(sensor=replace(SENSOR, gamma=Gamma(1 / 2.2))),
    "noise 6 %": Condition(sensor=replace(SENSOR, noise=Noise(600, 24))),
    "sharpened": Condition(sensor=replace(SENSOR, edge_enhancement=EdgeEnhancement(0.6))),
    "12-bit TIFF": Condition(suffix=".12.tif"),
    "16-bit TIFF": Condition(suffix=".16.tif"),
    "model in metres": Condition(model=_written("m", ".obj")),
    "model in inches": Condition(model=_written("in", ".stl")),
    "part there twice": Condition(model=_doubled),
    "by pyrender": Condition(renderer="pyrender", part=Surface(STEEL, 0.15, gloss=0.6)),
    "no start, 60 deg": Condition(search="range"),
    "no start, anywhere": Condition(search="sphere"),
    "no start, in clutter": Condition(search="range", clutter=14),
    "no start, a third hidden": Condition(search="range", hidden=0.33),
    "absent": Condition(absent="part", clutter=6),
    "absent, no start": Condition(absent="part", clutter=6, search="range"),
    "mirrored": Condition(absent="mirrored", spoilt=mirrored),
    "mirrored, no start": Condition(absent="mirrored", spoilt=mirrored, search="range"),
    "upside down": Condition(absent="upside down", spoilt=upside_down),
    "half outside": Condition(cut=0.5),
    "blurred by 4 px": Condition(spoilt=blurred(4.0)),
    "saturated": Condition(spoilt=saturated),
    "CAD 3 to 10 % stretched": Condition(cad=stretched(0.03, 0.10)),
    "CAD 10 to 20 % stretched": Condition(cad=stretched(0.10, 0.20)),
    "CAD 3 to 10 % longer": Condition(cad=lengthened(0.03, 0.10)),
    "CAD stretched, no start": Condition(cad=stretched(0.05, 0.15), search="range"),
    "CAD with other holes": Condition(kin=other_holes, parts=("flange",)),
    "focal length 5 to 20 % off": Condition(told=focal(0.05, 0.20)),
    "focal length off, wide": Condition(camera=_wide, told=focal(0.05, 0.20)),
    "focal length off, no start": Condition(told=focal(0.05, 0.20), search="range"),
    "other lens": Condition(told=other_lens),
    "lens not told": Condition(
        camera=lambda rng: Camera.from_focal((800, 600), _focal(800, 65.0), lens=BrownConrady(-0.25, 0.08)),
        told=other_lens,
    ),
    "other picture size": Condition(told=other_size),
    "one bay off": Condition(parts=("rack",), start=one_bay_off),
    "bays, no start": Condition(parts=("rack",), search="range"),
    "start turned over": Condition(turned=True, parts=(*OWN, "rack", *NIST)),
    "two of a kind": Condition(twin=True, size=(0.3, 0.45)),
    "two of a kind, no start": Condition(twin=True, size=(0.3, 0.45), search="range"),
}
