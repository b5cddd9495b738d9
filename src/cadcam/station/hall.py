"""A simulated hall: gantries whose beams bend and whose carts twist, a plate, a surveyor, cameras looking down.

Everything that a station has to cope with, with the truth known. The world: x and y on the floor, z up, mm. A camera
hangs 6 m above the floor and is tilted by its mounting; its view deviates smoothly and repeatably with the position of
the cart (deflection, twist: `Gantry.deviation`), and randomly from visit to visit (backlash, vibration).
Source: "Industrial Vision" (1997), sections 6.4.2 to 6.4.3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Floats, frozen
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.camera.plane_camera import PlaneCamera
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry import rotation as so3
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.charge import Noise
from cadcam.image.sensor.sensor import Sensor
from cadcam.image.sensor.video import Gamma, Quantization
from cadcam.kinds import expect_positive
from cadcam.station.plate import Plate, turn

ROBOTS = {"1": (19000.0, 27500.0, 12800.0, 22300.0), "6": (4500.0, 13000.0, 12800.0, 22300.0)}
ROBOTS |= {"7": (19000.0, 27500.0, 1600.0, 11100.0), "12": (4500.0, 13000.0, 1600.0, 11100.0)}
SENSOR = Sensor(name="hall", noise=Noise(10_000.0, 60.0), gamma=Gamma(1 / 2.2), quantization=Quantization(8))
"""The camera of the hall by default: 40 dB at white, and a gamma of 1 / 2.2."""
_WAVES = 4
_TWIST_RAD = 3e-4  # largest rotation of a random gantry's view
_DOWN = np.diag([-1.0, 1.0, -1.0])  # camera axes in the world: x to -x, y to +y, z down, as in Prog 4


@dataclass(frozen=True, slots=True, eq=False)
class Visit:
    """The random part of the pose while the camera stands at a place: shift (2,) mm of its view on the floor."""

    shift: Array = field(default_factory=lambda: np.zeros(2))


@dataclass(frozen=True, slots=True, eq=False)
class Gantry:
    """A gantry over an area (x from, x to, y from, y to) mm, whose view deviates by up to `deflection_mm`.

    waves (W, 8): components of the cart's twist, for shift x, shift y and rotation: two frequencies over the area, a
    phase, and the shares. bend (2,): shares of the beams' sag in x and y. mounting: tilt about x, y, z, rad.
    """

    name: str
    area: tuple[float, float, float, float]
    deflection_mm: float
    twist_rad: float
    waves: Array
    bend: Array
    mounting: Array
    height_mm: float = 6000.0

    def deviation(self, position: Floats) -> Array:
        """Return the shift of the view on the floor, (..., 2) mm, by deflection and twist at positions (..., 2).

        Straight below the camera; `Hall.deviation` is that of the view itself, exactly.
        """
        return np.asarray(self.deflection_mm * self._shape(position)[..., :2])

    def camera_from_world(self, position: Floats, visit: Visit | None = None) -> Rigid:
        """Return the true pose of the camera when the controller says `position` (2,)."""
        at = frozen(position, "position", (2,))
        shift = self.deviation(at) + (Visit() if visit is None else visit).shift
        tilt = shift / self.height_mm  # a view that moves by d at a height h: a camera rotated by d / h
        yaw = self.twist_rad * float(self._shape(at)[..., 2])
        swing = so3.exp(np.array([-tilt[1], tilt[0], 0.0])) @ so3.exp(np.array([0.0, 0.0, yaw]))
        world_from_camera = swing.T @ _DOWN @ so3.exp(self.mounting)
        eye = np.array([*at, self.height_mm])
        return Rigid(world_from_camera.T, -world_from_camera.T @ eye)

    def grid(self, columns: int, rows: int, *, jitter_mm: float, rng: np.random.Generator) -> Array:
        """Return calibration positions (columns rows, 2), nearly evenly spread over the area."""
        x0, x1, y0, y1 = self.area
        x, y = np.meshgrid(np.linspace(x0, x1, columns), np.linspace(y0, y1, rows), indexing="ij")
        even = np.column_stack([x.ravel(), y.ravel()])
        return np.asarray(np.round(even + rng.uniform(-jitter_mm, jitter_mm, even.shape), 1))

    def _shape(self, position: Floats) -> Array:
        """Return (..., 3): shift x, shift y, rotation, relative to the largest."""
        x0, x1, y0, y1 = self.area
        p = np.asarray(position, dtype=np.float64)
        s, t = (p[..., 0] - x0) / (x1 - x0), (p[..., 1] - y0) / (y1 - y0)
        phase = 2 * np.pi * (s[..., None] * self.waves[:, 0] + t[..., None] * self.waves[:, 1]) + self.waves[:, 2]
        twist = np.sin(phase) @ self.waves[:, 3:6]
        # A load that moves on a beam with two supports bends it by (t (1 - t))^2 of the largest, here at most 1.
        sag = 16 * np.stack([(t * (1 - t)) ** 2, (s * (1 - s)) ** 2, 0 * s], axis=-1)
        return np.asarray(twist + sag * np.append(self.bend, 0.0))


def random_gantry(
    name: str,
    *,
    area: tuple[float, float, float, float],
    deflection_mm: float,
    rng: np.random.Generator,
) -> Gantry:
    """Return a random gantry whose view's deviations differ by `deflection_mm` between its two worst places.

    Raises `BadValue` for a deflection below 0.
    """
    if not deflection_mm >= 0:
        raise BadValue("deflection_mm of a gantry", deflection_mm, "0 or more")
    frequency = rng.uniform(-1.5, 1.5, (_WAVES, 2))
    shares = rng.normal(size=(_WAVES, 3)) * np.array([0.35, 0.35, 0.5])
    waves = np.column_stack([frequency, rng.uniform(0, 2 * np.pi, _WAVES), shares])
    tilt = np.array([*rng.uniform(-0.05, 0.05, 2), rng.uniform(-0.02, 0.02)])
    bend = rng.choice([-1.0, 1.0], 2) * rng.uniform(0.5, 1.0, 2)
    unscaled = Gantry(name, area, 1.0, _TWIST_RAD, waves, bend, tilt)
    x0, x1, y0, y1 = area
    x, y = np.meshgrid(np.linspace(x0, x1, 15), np.linspace(y0, y1, 15))
    deviation = unscaled.deviation(np.stack([x, y], axis=-1)).reshape(-1, 2)
    worst = float(np.linalg.norm(deviation[:, None] - deviation[None], axis=2).max())
    return replace(unscaled, deflection_mm=deflection_mm / worst)


@dataclass(frozen=True, slots=True, eq=False)
class Hall:
    """Gantries, the camera that each of them carries, the plate as drawn and as made, and the noise of everything.

    survey_mm: noise of one surveyed coordinate; backlash_mm: width of the play of each axis, within which a visit ends;
    vibration_mm: standard deviation of the view while a picture is taken; noise_px: of one pixel coordinate of a mark
    where no picture is rendered; sensor: simulates the camera where one is.
    """

    gantries: dict[str, Gantry]
    camera: Camera
    plate: Plate
    made: Array
    survey_mm: float
    backlash_mm: float
    vibration_mm: float
    noise_px: float
    sensor: Sensor = SENSOR

    def __post_init__(self) -> None:
        for name in ("survey_mm", "backlash_mm", "vibration_mm", "noise_px"):
            value = getattr(self, name)
            expect_positive(value, f"{name} of the hall", "a number from 0 on", zero=True)

    def gantry(self, name: str) -> Gantry:
        """Return a gantry by its name. Raises `UnknownName`."""
        if name not in self.gantries:
            raise UnknownName("gantry", name, self.gantries)
        return self.gantries[name]

    @property
    def repeatability_mm(self) -> float:
        """Return the standard deviation of the view from visit to visit, per axis."""
        return float(np.hypot(self.backlash_mm / np.sqrt(12), self.vibration_mm))

    def visit(self, rng: np.random.Generator) -> Visit:
        """Return a visit: a random place within the play, and vibration."""
        play = rng.uniform(-0.5, 0.5, 2) * self.backlash_mm
        return Visit(play + self.vibration_mm * rng.normal(size=2))

    def view_centre(self, name: str, position: Floats) -> Array:
        """Return the floor point (2,) at the centre of the picture if the mechanics were perfect."""
        g, at = self.gantry(name), frozen(position, "position", (2,))
        direction = _DOWN @ so3.exp(g.mounting) @ np.array([0.0, 0.0, 1.0])
        return np.asarray(at + direction[:2] / -direction[2] * g.height_mm)

    def deviation(self, name: str, position: Floats, visit: Visit | None = None) -> Array:
        """Return the true minus the nominal place of the view's centre on the floor, (2,) mm."""
        there = self.gantry(name).camera_from_world(position, visit)
        middle = np.array([[(self.camera.width - 1) / 2, (self.camera.height - 1) / 2]])
        seen = PlaneCamera.of(replace(self.camera, lens=Ideal()), there).unproject(self.camera.undistorted(middle))[0]
        return np.asarray(seen - self.view_centre(name, position))

    def project(self, name: str, position: Floats, p: Floats, visit: Visit) -> Array:
        """Return the exact pixels (N, 2) of floor points (N, 2)."""
        places = frozen(p, "floor points", (None, 2))
        floor = np.column_stack([places, np.zeros(len(places))])
        return self.camera.project(self.gantry(name).camera_from_world(position, visit) @ floor)

    def seen(self, name: str, position: Floats, p: Floats, visit: Visit, rng: np.random.Generator) -> Array:
        """Return the pixels (N, 2) at which floor points are found, with noise."""
        exact = self.project(name, position, p, visit)
        return np.asarray(exact + self.noise_px * rng.normal(size=exact.shape))

    def lay_plate(self, name: str, position: Floats, rng: np.random.Generator) -> tuple[float, Array]:
        """Return angle and shift (2,) of a plate laid down about the centre of the view, as imprecisely as by hand."""
        angle = rng.uniform(-0.04, 0.04)
        middle = self.plate.marks.mean(axis=0)
        return angle, self.view_centre(name, position) + rng.uniform(-30, 30, 2) - turn(angle) @ middle

    def survey(self, angle: float, shift: Array, rng: np.random.Generator) -> tuple[Array, Array]:
        """Return the marks' true places (K, 2), and the reflectors' (M, 2) as surveyed."""
        true = self.made @ turn(angle).T + shift
        K = len(self.plate.marks)
        return true[:K], true[K:] + self.survey_mm * rng.normal(size=(len(true) - K, 2))


def make_hall(
    rng: np.random.Generator,
    *,
    robots: Sequence[str] = tuple(ROBOTS),
    deflection_mm: float = 20.0,
    survey_mm: float = 0.1,
    plate_mm: float = 0.1,
    backlash_mm: float = 0.5,
    vibration_mm: float = 0.1,
    noise_px: float = 0.03,
    camera: Camera | None = None,
    sensor: Sensor = SENSOR,
) -> Hall:
    """Return a hall like B4: 768 x 576 pixels of about 1.3 x 1.2 mm, four robots on 8.5 x 9.5 m each.

    deflection_mm: difference of the views' deviations between a gantry's two worst places. plate_mm: standard deviation
    of the plate's points as made. survey_mm, backlash_mm, vibration_mm, noise_px, sensor: as for `Hall`. Raises
    `UnknownName`, and `BadValue` for no robot, noise below 0, or a sensor that would change the pictures' size.
    """
    if not robots:
        raise BadValue("robots of the hall", "none", f"at least one of {', '.join(ROBOTS)}")
    for name in robots:
        if name not in ROBOTS:
            raise UnknownName("robot", name, ROBOTS)
    if sensor.pixel_aspect is not None:
        raise BadValue("pixel_aspect of the hall's sensor", "given", "none: the camera's fx and fy hold it already")
    plate = Plate.b4(sigma_mm=plate_mm)
    made = plate.points + plate_mm * rng.normal(size=plate.points.shape)
    gantries = {name: random_gantry(name, area=ROBOTS[name], deflection_mm=deflection_mm, rng=rng) for name in robots}
    lens = camera or Camera.from_focal((768, 576), 4650.0, fy=5070.0)
    return Hall(gantries, lens, plate, made, survey_mm, backlash_mm, vibration_mm, noise_px, sensor)
