"""The scene of a layout: the part and its poses, obstacles, where cameras may be, and what has to be measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from cadcam.arrays import Array, Brief, frozen
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.optics import Optics
from cadcam.camera.sensor_format import SensorFormat
from cadcam.errors import BadValue, UnknownName
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import (
    FrozenMap,
    expect,
    expect_by_name,
    expect_count,
    expect_each,
    expect_names,
    expect_numbers,
    expect_positive,
)
from cadcam.plan.scene.feature import LayoutFeature
from cadcam.plan.uncertainty.finding import Finder
from cadcam.verify.tolerances.tolerance import Quantity, Selection


@dataclass(frozen=True, slots=True, eq=False)
class CameraType:
    """A camera with its lens that can be bought, or one that is calibrated.

    focus_mm: the distance it is focused at; None: that of the point it is aimed at. estimate: its calibration, whose
    covariance then replaces the scene's assumptions about internals; with one, `sensor` is only needed for blur.
    """

    name: str
    sensor: SensorFormat | None = None
    focal_mm: float | None = None
    f_number: float | None = None
    focus_mm: float | None = None
    image_circle_mm: float | None = None
    own: Camera | None = None
    estimate: CameraEstimate | None = None

    def __post_init__(self) -> None:
        expect(self.sensor, "sensor", SensorFormat, optional=True)
        expect(self.own, "own", Camera, optional=True)
        expect(self.estimate, "estimate", CameraEstimate, optional=True)
        if self.own is None and (self.sensor is None or self.focal_mm is None):
            raise BadValue(
                f"camera {self.name!r}", "without sensor or focal_mm", "both, or the file of a calibrated one"
            )
        if self.sensor is not None and self.own is None and self.sensor.pixels is None:
            raise BadValue(f"pixels of camera {self.name!r}", "not known", "pixels: [columns, rows]")
        if self.own is not None and any(self._lens) and None in (self.sensor, self.focal_mm, self.f_number):
            raise BadValue(
                f"lens of calibrated camera {self.name!r}",
                "given in part",
                "sensor, focal_mm and f_number, by which its blur is known, or none of them",
            )
        if self.own is not None and self.sensor is not None and self.sensor.pixels != self.own.size:
            raise BadValue(
                f"pixels of camera {self.name!r}",
                f"{_by(self.sensor.pixels)} of {self.sensor.name}, and {_by(self.own.size)} of its file",
                f"of a whole chip, binned, pixels: {list(self.own.size)}; of a part of it, sensor: its width x height "
                "in mm: blur in px follows from a pixel's size",
            )
        self.optics(self.focus_mm if self.focus_mm is not None else 1e9)  # refuses impossible lenses

    @property
    def _lens(self) -> tuple[object, ...]:
        """Return what is said of the lens, None for what is not."""
        return self.sensor, self.focal_mm, self.f_number, self.focus_mm, self.image_circle_mm

    def optics(self, distance_mm: float) -> Optics | None:
        """Return the optics focused at its own distance, or else at this one; None where the lens is not known."""
        if self.sensor is None or self.focal_mm is None:
            return None
        focus = distance_mm if self.focus_mm is None else self.focus_mm
        return Optics(self.sensor, self.focal_mm, focus, self.f_number, self.image_circle_mm)

    def camera(self, distance_mm: float) -> Camera:
        """Return the camera, focused as `optics` is."""
        if self.own is not None:
            return self.own
        optics = self.optics(distance_mm)
        assert optics is not None  # by __post_init__
        return optics.camera()


def _by(pixels: tuple[int, int] | None) -> str:
    return "unknown" if pixels is None else f"{pixels[0]} x {pixels[1]}"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Mount(Brief):
    """Where cameras can be: eyes (N, 3) mm in the world, each aimed at a point (N, 3), with these camera types.

    fixed: these cameras exist already and are always among the chosen. one_camera: the places are those of one camera
    that a known motion carries there: its calibration error is common to all, its motion error different at each.
    spread: the places were spread over a zone, so that those inside of something are left out instead of refused.
    """

    name: str
    eyes: Array
    aims: Array
    cameras: tuple[str, ...]
    up: tuple[float, float, float] = (0.0, 0.0, 1.0)
    fixed: bool = False
    one_camera: bool = False
    spread: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "eyes", frozen(self.eyes, f"positions of mount {self.name!r}", (None, 3)))
        object.__setattr__(self, "aims", frozen(self.aims, f"aims of mount {self.name!r}", (len(self.eyes), 3)))
        if not len(self.eyes):
            raise BadValue(f"positions of mount {self.name!r}", "none", "at least one")
        expect_numbers(self)
        object.__setattr__(self, "cameras", expect_names(self.cameras, f"cameras of mount {self.name!r}"))
        if not self.cameras or len(set(self.cameras)) != len(self.cameras):
            raise BadValue(
                f"cameras of mount {self.name!r}", ", ".join(self.cameras) or "none", "at least one, each once"
            )
        if not np.linalg.norm(self.up) > 0:
            raise BadValue(f"up of mount {self.name!r}", list(self.up), "a vector that is not zero")


@dataclass(frozen=True, slots=True)
class Sigmas:
    """Standard deviations of what is not known exactly: position per axis, mm; rotation about each axis, rad; px."""

    position_mm: float = 0.0
    rotation: float = 0.0
    focal_px: float = 0.0
    principal_point_px: float = 0.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            expect_positive(value, name, "a number from 0 on", zero=True)

    @property
    def variances(self) -> Array:
        """Return the variances (11,) of the local coordinates of `cadcam.camera.sensitivity`."""
        p, r, f, c = self.position_mm, self.rotation, self.focal_px, self.principal_point_px
        return np.array([p, p, p, r, r, r, 0.0, f, 0.0, c, c]) ** 2


@dataclass(frozen=True, slots=True)
class CalibratedFrom:
    """A separate calibration of each camera, from points spread over its picture and the part's depth.

    points: how many; sigma_px: noise of one pixel coordinate; points_mm: standard deviation of each of their
    coordinates. Pose, focal length and principal point then have the covariance that follows, correlations included.
    """

    points: int = 30
    sigma_px: float = 0.1
    points_mm: float = 0.0

    def __post_init__(self) -> None:
        expect_count(self.points, "points of a calibration", least=8)
        expect_positive(self.sigma_px, "sigma_px of a calibration", "a positive number of px")
        expect_positive(self.points_mm, "points_mm of a calibration", "a number of mm from 0 on", zero=True)


@dataclass(frozen=True, slots=True)
class Seeing:
    """When a feature counts as seen: at most this slant (rad) and blur, this far from the border, at least this large.

    share: of a feature's places (its rim, the stations of its edge) that have to be visible.
    """

    incidence: float = float(np.radians(70.0))
    blur_px: float = 4.0
    border_px: float = 4.0
    least_px: float = 6.0
    share: float = 0.6

    def __post_init__(self) -> None:
        for name in ("blur_px", "border_px", "least_px"):
            expect_positive(getattr(self, name), f"{name} of what is seen", "a number of px from 0 on", zero=True)
        expect_positive(self.incidence, "incidence of what is seen", "an angle above 0")
        if self.incidence > np.radians(90) * (1 + 1e-12):
            said = f"{np.degrees(self.incidence):g} deg"
            raise BadValue("incidence of what is seen", said, "at most 90 deg: beyond, a surface is seen from behind")
        expect_positive(self.share, "share of what is seen")
        if self.share > 1:
            raise BadValue("share of what is seen", self.share, "at most 1: all of a rim or an edge")


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class LayoutScene(Brief):
    """All that a layout is planned from; poses are world_from_part by name, obstacles a mesh in the world, or None.

    calibration: of every camera's pose and internals, as sigmas or as the points it is made from; motion: of a camera
    that is moved, at each place; placement: of the part in its pose, which matters for features on known planes that
    one camera sees. tur: the test uncertainty ratio limit/U that every limit should reach. choose: how many cameras to
    choose beside the fixed ones. datum: edges that the part's pose is fitted to in the same pictures, relative to which
    features that are edges of the part are judged, as by `cadcam verify`; none: places in the world, as all others.
    sources: (role, path, sha256) of files.
    """

    part: Mesh
    poses: Mapping[str, Rigid]
    cameras: Mapping[str, CameraType]
    mounts: tuple[Mount, ...]
    features: tuple[LayoutFeature, ...]
    finder: Finder
    obstacles: Mesh | None = None
    calibration: Sigmas | CalibratedFrom = field(default_factory=Sigmas)
    motion: Sigmas = field(default_factory=Sigmas)
    placement: Sigmas = field(default_factory=Sigmas)
    seeing: Seeing = field(default_factory=Seeing)
    tur: float = 3.0
    choose: int = 4
    datum: tuple[Selection, ...] = ()
    name: str = "layout"
    sources: tuple[tuple[str, str, str], ...] = ()

    def __post_init__(self) -> None:
        expect(self.part, "part", Mesh)
        expect(self.obstacles, "obstacles", Mesh, optional=True)
        expect(self.finder, "finder", Finder)
        expect(self.calibration, "calibration", Sigmas, CalibratedFrom)
        expect(self.seeing, "seeing", Seeing)
        expect(self.motion, "motion", Sigmas)
        expect(self.placement, "placement", Sigmas)
        expect(self.name, "name", str)
        expect_by_name(self.poses, "poses", Rigid)
        expect_by_name(self.cameras, "cameras", CameraType)
        object.__setattr__(self, "mounts", expect_each(self.mounts, "mounts", Mount))
        object.__setattr__(self, "features", expect_each(self.features, "features", LayoutFeature))
        for what in ("poses", "cameras"):
            if not getattr(self, what):
                raise BadValue(f"{what} of the scene", "none", "at least one")
            object.__setattr__(self, what, FrozenMap(getattr(self, what)))
        for what in ("mounts", "features"):
            things = getattr(self, what)
            names = [t.name for t in things]
            if not names:
                raise BadValue(f"{what} of the scene", "none", "at least one")
            if len(set(names)) != len(names):
                raise BadValue(f"{what} of the scene", ", ".join(names), "each name once")
        for mount in self.mounts:
            for kind in mount.cameras:
                if kind not in self.cameras:
                    raise UnknownName(f"camera of mount {mount.name!r}", kind, self.cameras)
        expect_positive(self.tur, "tur", "a positive number: limit/U that every limit should reach")
        expect_count(self.choose, "choose", expected="at least 1 camera")
        object.__setattr__(self, "datum", expect_each(self.datum, "datum", Selection))
        if self.datum:
            self._check_datum()

    @property
    def judged(self) -> tuple[int, ...]:
        """Return the numbers of the features that are judged relative to the datum."""
        return tuple(i for i, f in enumerate(self.features) if self.datum and f.selection is not None)

    def _check_datum(self) -> None:
        for chosen in self.datum:
            chosen.among(self.part.part_names)
        if not self.judged:
            raise BadValue("datum", "given, but no feature is judged from it", "a feature by its part, or no datum")
        if not self.finder.by_gray:
            raise BadValue("noise beside a datum", "without gray and contrast", "both: edges are weighed by them")
        for feature in (self.features[i] for i in self.judged):
            if any(limit.quantity is Quantity.ANGLE for limit in feature.limits):
                raise BadValue(f"angle_deg of {feature.name}", "beside a datum", "an edge_mm to ask it of")
