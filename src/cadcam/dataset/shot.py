"""One view of the plan, drawn: all that a worker needs to make it, a function of (seed, number of the view) alone.

Each topic has its own random stream, so that another light or one more occluder does not change the poses.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.camera import Camera
from cadcam.dataset.plan import PLAIN, DatasetPlan, Span, middle_and_radius
from cadcam.dataset.props import Prop
from cadcam.errors import BadValue
from cadcam.geometry import rotation
from cadcam.geometry.rigid import Rigid
from cadcam.locate.views.view_range import ViewRange
from cadcam.render.view import Look, Scene

_TRIES = 20  # attempts to place an occluder without touching another
_CLEAR = 1.05  # least distance of two bounding spheres over the sum of their radii
_DIRECTIONS = 512  # tried for how far the part's box reaches
_TOPICS = ("pose", "camera", "light", "background", "occluders", "sensor")


@dataclass(frozen=True, slots=True)
class Backdrop:
    """The background: a grey `level`, noise around it, or a photo cropped at `place` (shares of the free range)."""

    kind: str | Path
    level: float
    place: tuple[float, float]
    seed: int


@dataclass(frozen=True, slots=True, eq=False)
class PlacedOccluder:
    """An occluder in its place: its index among the props, camera_from_occluder."""

    prop: int
    camera_from_occluder: Rigid


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """A view to make. Occluders are ordered nearest first; none touches another or the part."""

    index: int
    camera: Camera
    camera_from_part: Rigid
    look: Look
    backdrop: Backdrop
    occluders: tuple[PlacedOccluder, ...]
    sensor_seed: int


class ShotSampler:
    """Draws the random shots of a plan; what does not depend on the view is computed once."""

    def __init__(self, plan: DatasetPlan, scene: Scene, props: tuple[Prop, ...]) -> None:
        self.plan: DatasetPlan = plan
        self.props: tuple[Prop, ...] = props
        self.middle: Array
        self.radius: float
        self.middle, self.radius = middle_and_radius(scene.mesh)
        self._half_box = scene.mesh.size_mm / 2
        self._jitters = plan.focal_jitter > 0 or plan.center_jitter_px > 0

    def shot(self, index: int) -> Shot:
        """Return view `index`, the same at any time and on any machine."""
        seeds = dict(zip(_TOPICS, np.random.SeedSequence([self.plan.seed, index]).spawn(len(_TOPICS)), strict=True))

        def stream(topic: str) -> np.random.Generator:
            return np.random.default_rng(seeds[topic])

        camera = self._camera(stream("camera")) if self._jitters else self.plan.camera
        pose, backdrop = self._pose(index, camera, stream("pose")), self._backdrop(stream("background"))
        look = self._look(stream("light"), backdrop.level if backdrop.kind == PLAIN else 0.0)
        occluders = self._occluders(pose, stream("occluders")) if self.props else ()
        return Shot(index, camera, pose, look, backdrop, occluders, int(stream("sensor").integers(2**63)))

    def farthest(self) -> float:
        """Return a depth (mm) that no surface of any view exceeds.

        An occluder, apart from the part and before a place of it, ends within the part's distance; of a part beside the
        camera's axis that may be deeper than the part.
        """
        if not self.plan.poses:
            return self.plan.distances(2 * self.radius)[1] + self.radius
        places = np.array([pose @ self.middle for pose in self.plan.poses])
        depths = np.linalg.norm(places, axis=1) if self.props else places[:, 2]
        return float(depths.max()) + self.radius

    def refuse_inside(self) -> None:
        """Raise `BadValue` where the camera may be drawn inside the part's box, from where it sees insides of faces.

        Poses of the plan's own may be there, in a tank that is looked at from within.
        """
        if self.plan.poses:
            return
        near, far = self.plan.distances(2 * self.radius)
        least = _deepest(self._half_box, self.plan.around)
        if near > least:
            return
        said = f"which puts the camera {near:.4g} mm from the middle of a part whose box reaches {least:.4g} mm"
        if self.plan.around.distance_mm is not None:
            stated = f"({near:g}, {far:g}), {said} towards where it is seen from"
            raise BadValue("distance_mm", stated, f"more than {least:.4g} mm, or poses of your own")
        fill = self.plan.fill
        stated = f"({fill[0]:g}, {fill[1]:g}), {said} towards where it is seen from"
        most = fill[1] * near / least
        raise BadValue("fill", stated, f"less than {most:.2g} with so wide an angle of view, or poses of your own")

    def _camera(self, rng: np.random.Generator) -> Camera:
        camera, plan = self.plan.camera, self.plan
        zoom = 1 + plan.focal_jitter * float(np.clip(rng.standard_normal(), -3, 3))
        shift = plan.center_jitter_px * rng.standard_normal(2)
        K = camera.K.copy()
        K[:2, :2] *= zoom
        K[:2, 2] += shift
        return replace(camera, K=K)

    def _pose(self, index: int, camera: Camera, rng: np.random.Generator) -> Rigid:
        plan = self.plan
        if plan.poses:
            return plan.poses[index % len(plan.poses)]
        away = _in_cap(plan.around.axis, math.radians(plan.around.half_angle_deg), rng)
        roll = math.radians(plan.around.roll_deg) * rng.uniform(-1, 1)
        distance = self._distance(rng)
        eye = self.middle + distance * away
        upright = Rigid.look_at(eye, self.middle, up=_not_along(plan.around.up, away))
        turned = rotation.exp([0.0, 0.0, roll]) @ upright.rotation
        aimed = _aim(camera, plan.off_center * min(camera.size) * rng.uniform(-1, 1, 2)) @ turned
        return Rigid(aimed, -aimed @ eye)

    def _distance(self, rng: np.random.Generator) -> float:
        """Return a random distance: uniform, or such that the part's size in the picture is uniform."""
        low, high = self.plan.distances(2 * self.radius)
        share = rng.uniform()
        if self.plan.around.distance_mm is not None:
            return low + (high - low) * share
        return 1 / (1 / high + (1 / low - 1 / high) * share)

    def _look(self, rng: np.random.Generator, background: float) -> Look:
        lights = self.plan.lights
        head, ambient = (_drawn(span, rng) for span in (lights.head, lights.ambient))
        fill, back = (_drawn(lights.distant, rng) for _ in range(2))
        fill_from, back_from = (_unit(rng) for _ in range(2))
        fill_from[2] = -abs(fill_from[2])  # one of the two comes from the camera's side
        return Look(
            head=head,
            fill=fill,
            back=back,
            ambient=ambient,
            fill_from=(float(fill_from[0]), float(fill_from[1]), float(fill_from[2])),
            back_from=(float(back_from[0]), float(back_from[1]), float(back_from[2])),
            background=(background,) * 3,
            supersampling=self.plan.samples,
        )

    def _backdrop(self, rng: np.random.Generator) -> Backdrop:
        kind = self.plan.backgrounds[int(rng.integers(len(self.plan.backgrounds)))]
        level, x, y = rng.uniform(0.05, 0.95), rng.uniform(), rng.uniform()
        return Backdrop(kind, float(level), (float(x), float(y)), int(rng.integers(2**63)))

    def _occluders(self, camera_from_part: Rigid, rng: np.random.Generator) -> tuple[PlacedOccluder, ...]:
        """Return occluders in front of places of the part, nearest first; one that finds no room is left out."""
        low, high = self.plan.occluders.count
        part = camera_from_part @ self.middle
        taken = [(part, self.radius)]
        placed: list[tuple[float, PlacedOccluder]] = []
        for _ in range(int(rng.integers(low, high + 1))):
            number = int(rng.integers(len(self.props)))
            prop = self.props[number]
            centre = _free_place(part, self.radius, prop.radius, taken, rng)
            turned = rotation.from_quaternion(rng.standard_normal(4))
            if centre is None:
                continue
            taken.append((centre, prop.radius))
            # Ordered by the eye's power with respect to the bounding spheres: the lesser is never behind (disjoint).
            power = float(centre @ centre) - prop.radius**2
            placed.append((power, PlacedOccluder(number, Rigid(turned, centre - turned @ prop.middle))))
        return tuple(one for _, one in sorted(placed, key=lambda item: item[0]))


def _free_place(
    part: Array, part_radius: float, radius: float, taken: list[tuple[Array, float]], rng: np.random.Generator
) -> Array | None:
    """Return a centre for an occluder, between the camera and some place of the part; None if there is no room."""
    for _ in range(_TRIES):
        aim = part + 0.7 * part_radius * rng.uniform() ** (1 / 3) * _unit(rng)
        centre = aim * rng.uniform(0.35, 1.0)
        apart = all(np.linalg.norm(centre - other) > _CLEAR * (radius + size) for other, size in taken)
        if apart and centre[2] > 1.5 * radius and np.linalg.norm(centre) < np.linalg.norm(part):
            return np.asarray(centre)
    return None


def _aim(camera: Camera, off_px: Array) -> Array:
    """Return the least rotation (3, 3) by which what is on the camera's axis is seen `off_px` beside the middle.

    The camera turns and does not move: direction and distance of the part stay as drawn, wherever the principal point
    is. Where the lens images nothing there, it is the middle, or as it was.
    """
    middle = (np.array(camera.size) - 1) / 2
    rays = camera.unproject(np.stack([middle + off_px, middle, camera.principal_point]))
    x, y, z = rays[np.isfinite(rays).all(axis=1)][0].tolist()
    beside = math.hypot(x, y)
    return rotation.exp(np.array([-y, x, 0.0]) * (math.atan2(beside, z) / beside if beside else 0.0))


def _deepest(half_box: Array, around: ViewRange) -> float:
    """Return how far a box with these half sides (3,) reaches from its middle in the directions of a range of views."""
    corners = half_box * np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    long = corners / max(float(np.linalg.norm(half_box)), 1e-300)
    within = long[long @ around.axis >= math.cos(math.radians(around.half_angle_deg))]
    rng = np.random.default_rng(0)  # a box has no such simple farthest point in a narrow cap
    drawn = np.array([_in_cap(around.axis, math.radians(around.half_angle_deg), rng) for _ in range(_DIRECTIONS)])
    away = np.abs(np.concatenate([within, drawn]))
    return float((half_box / np.maximum(away, 1e-300)).min(axis=1).max())


def _drawn(span: Span, rng: np.random.Generator) -> float:
    return float(rng.uniform(*span))


def _unit(rng: np.random.Generator) -> Array:
    """Return a uniformly random direction."""
    v = rng.standard_normal(3)
    return np.asarray(v / np.linalg.norm(v))


def _in_cap(axis: Array, half_angle: float, rng: np.random.Generator) -> Array:
    """Return a random direction at most half_angle from the axis, uniform over the sphere."""
    cosine = rng.uniform(math.cos(half_angle), 1.0)
    turn = rng.uniform(0.0, 2 * math.pi)
    x = rotation.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    x /= np.linalg.norm(x)
    y = rotation.cross(axis, x)
    sine = math.sqrt(max(1 - cosine * cosine, 0.0))
    return np.asarray(cosine * axis + sine * (math.cos(turn) * x + math.sin(turn) * y))


def _not_along(up: Array, away: Array) -> Array:
    """Return `up`, or, where one looks along it, another axis of the part."""
    return up if np.linalg.norm(rotation.cross(up, away)) > 1e-6 else np.eye(3)[int(np.argmin(np.abs(away)))]
