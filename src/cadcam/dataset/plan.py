"""The plan of a data set: every random choice and its range, as one value.

A span (low, high) is a number drawn uniformly between the two for each view; low = high leaves it fixed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue
from cadcam.geometry.rigid import Rigid
from cadcam.image.sensor.sensor import Sensor
from cadcam.kinds import expect, expect_each, expect_known, expect_names, expect_numbers
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

Span: TypeAlias = tuple[float, float]

PLAIN, NOISE = "plain", "noise"
BOX, CYLINDER = "box", "cylinder"
_CLOSEST = 2.0  # fill: beyond it most views show only a piece of a face


@dataclass(frozen=True, slots=True)
class Lights:
    """Strengths of a view's lights: `head` at the camera, two `distant` ones from any direction, `ambient`."""

    head: tuple[float, float] = (0.1, 0.5)
    distant: tuple[float, float] = (0.1, 0.5)
    ambient: tuple[float, float] = (0.1, 0.3)

    def __post_init__(self) -> None:
        expect_numbers(self)
        for name in ("head", "distant", "ambient"):
            check_span(f"strength of the {name} light", getattr(self, name), 0.0, 10.0)


@dataclass(frozen=True, slots=True)
class Occluders:
    """The occluders between camera and part: how many, of which shapes, how large (share of the part's diameter).

    shapes: BOX and CYLINDER. meshes: CAD parts, at their true size. They are not labelled: they only hide.
    """

    count: tuple[int, int] = (0, 0)
    shapes: tuple[str, ...] = (BOX, CYLINDER)
    size: tuple[float, float] = (0.1, 0.3)
    meshes: tuple[Mesh, ...] = ()

    def __post_init__(self) -> None:
        expect_numbers(self)
        low, high = self.count
        if not 0 <= low <= high <= 50:
            raise BadValue("occluders", self.count, "(fewest, most), from 0 to 50")
        check_span("occluder_size", self.size, 1e-3, 10.0)
        object.__setattr__(self, "shapes", expect_names(self.shapes, "occluder_shapes"))
        object.__setattr__(self, "meshes", expect_each(self.meshes, "meshes", Mesh))
        for shape in self.shapes:
            expect_known(shape, "occluder shape", (BOX, CYLINDER))
        if high and not (self.shapes or self.meshes):
            raise BadValue("occluder_shapes", "empty", f"{BOX}, {CYLINDER} or CAD files")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class DatasetPlan(Brief):
    """The choices of a data set.

    camera: its internals; focal_jitter is a share of the focal length (sigma), center_jitter_px moves the principal
    point (sigma). Poses of the camera: `poses`, camera_from_part in order and again from the first, or drawn: from
    `around`, at a distance (its own, or such that the part's diameter is `fill` of the picture's shorter side), the
    part's middle off the picture's by up to `off_center` of that side. backgrounds: PLAIN, NOISE or photos, of which
    each view takes one. samples: n x n rays per pixel for the picture. key_points (K, 3) mm in the part frame, with
    their names. Raises `BadValue`.
    """

    views: int
    camera: Camera
    seed: int = 0
    focal_jitter: float = 0.0
    center_jitter_px: float = 0.0
    poses: tuple[Rigid, ...] = ()
    around: ViewRange = WHOLE_SPHERE
    fill: tuple[float, float] = (0.4, 0.9)
    off_center: float = 0.1
    lights: Lights = field(default_factory=Lights)
    backgrounds: tuple[str | Path, ...] = (PLAIN,)
    occluders: Occluders = field(default_factory=Occluders)
    sensor: Sensor | None = None
    samples: int = 2
    gray: bool = False
    key_points: Array | None = None
    key_point_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        expect(self.views, "views", int, np.integer)
        expect(self.camera, "camera", Camera)
        for name, kind in (("around", ViewRange), ("lights", Lights), ("occluders", Occluders)):
            expect(getattr(self, name), name, kind)
        if self.around.on is not None:
            raise BadValue("on of the views", "a plane", "none: views are drawn about the part, which lies nowhere")
        expect(self.sensor, "sensor", Sensor, optional=True)
        object.__setattr__(self, "poses", expect_each(self.poses, "poses", Rigid))
        object.__setattr__(self, "backgrounds", expect_each(self.backgrounds, "backgrounds", str, Path))
        object.__setattr__(self, "key_point_names", expect_names(self.key_point_names, "key_point_names"))
        if self.key_points is not None:
            object.__setattr__(self, "key_points", frozen(self.key_points, "key_points", (None, 3)))
        if (count := 0 if self.key_points is None else len(self.key_points)) != len(self.key_point_names):
            raise BadValue("key_point_names", f"{len(self.key_point_names)} names", f"one for each of {count} points")
        expect_numbers(self)
        if not 1 <= self.views <= 10_000_000:
            raise BadValue("number of views", self.views, "a whole number from 1 to 10 million")
        if not 0 <= self.seed < 2**63:
            raise BadValue("seed", self.seed, "a whole number of at least 0")
        if not 0 <= self.focal_jitter <= 0.2:
            raise BadValue("focal_jitter_percent", 100 * self.focal_jitter, "0 to 20")
        if not 0 <= self.center_jitter_px < math.inf:
            raise BadValue("center_jitter_px", self.center_jitter_px, "a number of px, at least 0")
        if self.fill[1] > _CLOSEST:
            right = f"the part's diameter by the picture's shorter side, to {_CLOSEST:g}; closer by distance_mm"
            raise BadValue("fill", self.fill, right)
        check_span("fill", self.fill, 0.01, _CLOSEST)
        if not 0 <= self.off_center <= 1:
            raise BadValue("off_center", self.off_center, "a share of the picture's shorter side, 0 to 1")
        if not self.backgrounds:
            raise BadValue("background", "empty", f"{PLAIN}, {NOISE} or a folder of photos")
        for word in self.backgrounds:
            if isinstance(word, str) and word not in (PLAIN, NOISE):
                raise BadValue("background", repr(word), f"{PLAIN}, {NOISE}, or a photo as a path: Path({word!r})")
        if self.sensor is not None and self.sensor.pixel_aspect is not None:
            right = "none, which would leave the labels beside their pictures: a camera's fx and fy hold it"
            raise BadValue("pixel_aspect of the sensor", "given", right)
        if not 1 <= self.samples <= 4:
            raise BadValue("samples", self.samples, "1 to 4: n x n rays a pixel")

    def distances(self, diameter: float) -> Span:
        """Return the least and greatest distance (mm) of a part's middle that may be drawn."""
        if self.around.distance_mm is not None:
            return self.around.distance_mm
        focal = min(self.camera.fx, self.camera.fy) * diameter / min(self.camera.size)
        return focal / self.fill[1], focal / self.fill[0]


def check_span(what: str, span: Sequence[float], low: float, high: float) -> None:
    """Raise `BadValue` unless low <= span[0] <= span[1] <= high."""
    if len(span) != 2 or not low <= span[0] <= span[1] <= high:
        raise BadValue(what, tuple(span), f"(least, greatest), from {low:g} to {high:g}")


def middle_and_radius(mesh: Mesh) -> tuple[Array, float]:
    """Return the middle (3,) of a mesh's box and half of its diagonal, mm."""
    low, high = mesh.bounds
    return (low + high) / 2, float(np.linalg.norm(high - low)) / 2
