"""Candidate cameras: every place of every mount with every camera type allowed there, as viewpoints."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Brief
from cadcam.camera.camera import Camera
from cadcam.camera.error_source import ErrorSource
from cadcam.camera.optics import Optics
from cadcam.camera.sensitivity import project_with_sensitivity
from cadcam.camera.viewpoint import KnownMotion, Viewpoint
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, LayoutScene, Mount, Sigmas

_FOUND = list(range(6))  # local coordinates estimated by a calibration of the pose alone: position and angles
_FOUND_WITH_INTERNALS = [*range(6), 7, 9, 10]  # with focal length and principal point
_THINNEST = 1e-4  # of its distance: least depth of the points of a calibration
_ALONG = 1e-6  # sine of the angle to "up" below which a view counts as vertical


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Candidate(Brief):
    """A camera that could be mounted: its viewpoint, with all the errors it will have, and its optics.

    aim (3,) mm: the point that it looks at. fixed: it exists already. shared: the name of the mount if its cameras are
    one camera that is moved; else "". spread: its place is one of many spread over a zone.
    """

    name: str
    mount: str
    type: CameraType
    viewpoint: Viewpoint
    aim: Array
    optics: Optics | None
    fixed: bool = False
    shared: str = ""
    spread: bool = False

    @property
    def eye(self) -> Array:
        """Return where it stands (3,), mm."""
        return self.viewpoint.camera_from_world.origin

    @property
    def camera(self) -> Camera:
        """Return its camera."""
        return self.viewpoint.camera


def candidates(scene: LayoutScene) -> tuple[Candidate, ...]:
    """Return all candidates of a scene, in the order of its mounts, numbered within each mount.

    Raises `BadValue` where two have one name, by which they are kept and asked for.
    """
    out: list[Candidate] = []
    placing = Placing(scene)
    for mount in scene.mounts:
        several = len(mount.cameras) > 1
        for i, (eye, aim) in enumerate(zip(mount.eyes, mount.aims, strict=True), 1):
            for kind in mount.cameras:
                name = f"{mount.name} {i}" if len(mount.eyes) > 1 else mount.name
                name += f" ({kind})" if several else ""
                out.append(placing.candidate(name, mount, scene.cameras[kind], eye, aim))
    for name, times in Counter(c.name for c in out).items():
        if times > 1:
            raise BadValue("name of a candidate", f"{name!r}, {times} times", "mounts whose numbered places differ")
    return tuple(out)


def share_errors(some: Iterable[Candidate]) -> bool:
    """Return whether some cameras err together: one that is moved does, and one whose calibration is used twice."""
    times = Counter(id(source.owner) for c in some for source, _ in c.viewpoint.errors)
    return any(n > 1 for n in times.values())


def count_candidates(scene: LayoutScene) -> int:
    """Return how many candidates a scene has."""
    return sum(len(mount.eyes) * len(mount.cameras) for mount in scene.mounts)


class Placing:
    """Places cameras in a scene, with all the errors they will have.

    It remembers where each camera that is moved was placed first: there it is calibrated, and at all other places the
    same calibration errs in the same way. Internals that a camera file states err in the same way wherever it is used.
    """

    def __init__(self, scene: LayoutScene) -> None:
        self._scene = scene
        self._calibrated: dict[tuple[str, str], tuple[ErrorSource, Rigid]] = {}  # by mount and type

    def candidate(self, name: str, mount: Mount, kind: CameraType, eye: Array, aim: Array) -> Candidate:
        """Return a camera at `eye` (3,) mm that looks at `aim` (3,). Raises `DegenerateGeometry` if these are one."""
        distance = float(np.linalg.norm(np.asarray(aim) - np.asarray(eye)))
        if not distance > 0:
            raise DegenerateGeometry(f"candidate {name!r} aims at itself: position and aim are both {eye.tolist()}")
        pose, camera = aimed(eye, aim, mount.up), kind.camera(distance)
        sigma, errors = self._scene.finder.sigma_px or 1.0, self._errors(mount, kind, camera, pose)
        if kind.estimate is not None:
            errors += Viewpoint.placed(name, kind.estimate, pose, sigma_px=sigma).errors  # its internals alone
        return Candidate(
            name=name,
            mount=mount.name,
            type=kind,
            viewpoint=Viewpoint(name, camera, pose, sigma, errors),
            aim=aim,
            optics=kind.optics(distance),
            fixed=mount.fixed,
            shared=mount.name if mount.one_camera else "",
            spread=mount.spread,
        )

    def _errors(
        self, mount: Mount, kind: CameraType, camera: Camera, pose: Rigid
    ) -> tuple[tuple[ErrorSource, Array], ...]:
        """Return the errors of a camera at a pose but for internals that its file states, with the effect of each."""
        scene, key = self._scene, (mount.name, kind.name)
        if not mount.one_camera:
            source = _calibration(scene, kind, camera, pose)
            return ((source, np.eye(len(source.covariance))),)
        if key not in self._calibrated:
            self._calibrated[key] = _calibration(scene, kind, camera, pose), pose
        return _moved(*self._calibrated[key], pose, scene.motion)


def aimed(eye: Array, aim: Array, up: tuple[float, float, float]) -> Rigid:
    """Return camera_from_world of a camera that looks at a point with `up` upwards; if it looks along it, y or x is."""
    forward = np.asarray(aim) - np.asarray(eye)
    for direction in (up, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)):
        if np.linalg.norm(np.cross(forward, direction)) > _ALONG * np.linalg.norm(forward) * np.linalg.norm(direction):
            return Rigid.look_at(eye, aim, up=direction)
    raise DegenerateGeometry(f"no direction is up for a camera at {eye} that looks at {aim}")


def _calibration(scene: LayoutScene, kind: CameraType, camera: Camera, pose: Rigid) -> ErrorSource:
    """Return what a calibration leaves uncertain, as the scene assumes; of internals only where no file states them."""
    n = 11 + len(camera.lens.parameters)
    covariance = np.zeros((n, n))
    if isinstance(scene.calibration, CalibratedFrom):
        covariance[:11, :11] = calibrated(scene, scene.calibration, camera, pose, internals=kind.estimate is None)
    else:
        covariance[:11, :11] = np.diag(scene.calibration.variances)
    if kind.estimate is not None:
        covariance[6:] = covariance[:, 6:] = 0.0
    return ErrorSource("calibration", covariance, object())


def calibrated(scene: LayoutScene, assumed: CalibratedFrom, camera: Camera, pose: Rigid, *, internals: bool) -> Array:
    """Return the covariance (11, 11) of a calibration's local coordinates, from points over the picture and the depth.

    internals: whether focal length and principal point are estimated too, or only the pose.
    """
    points = _spread_in_view(camera, assumed.points, *_depths(scene, pose))
    _, J = project_with_sensitivity(camera, pose, pose.inv @ points)
    sigma = np.hypot(assumed.sigma_px, assumed.points_mm * np.linalg.norm(J[..., :3], axis=(1, 2)) / np.sqrt(2))
    free = _FOUND_WITH_INTERNALS if internals else _FOUND
    whitened = (J[..., free] / sigma[:, None, None]).reshape(-1, len(free))
    scale = np.linalg.norm(whitened, axis=0)  # of millimetres, radians and pixels
    inverse = np.linalg.pinv(whitened / scale)
    covariance = np.zeros((11, 11))
    covariance[np.ix_(free, free)] = inverse @ inverse.T / np.outer(scale, scale)
    return covariance


def _depths(scene: LayoutScene, pose: Rigid) -> tuple[float, float]:
    """Return the least and the largest depth of the part, mm; any, if the camera looks away from it.

    They differ by `_THINNEST` at least: from points in one plane across the view, focal length and distance are not
    known but together, and a pseudo-inverse would call them known exactly.
    """
    world = next(iter(scene.poses.values()))
    depth = (pose @ (world @ scene.part.box_corners))[:, 2]
    far = float(depth.max())
    if far <= 0:
        return 1000.0, 2000.0
    near = max(float(depth.min()), 0.05 * far)
    middle, half = (near + far) / 2, max((far - near) / 2, _THINNEST / 2 * far)
    return middle - half, middle + half


def _spread_in_view(camera: Camera, n: int, near: float, far: float) -> Array:
    """Return at most n points (m, 3), camera frame, spread evenly over the picture and between two depths (mm).

    Roberts' sequence in three dimensions: multiples of the powers of 1/g, g the root of g^4 = g + 1. Pixels without a
    ray are left out.
    """
    steps = np.arange(n)[:, None] + 0.5
    share = (steps * np.array([0.8191725134, 0.6710436067, 0.5497004779])) % 1
    rays = camera.unproject(share[:, :2] * np.array(camera.size) - 0.5)
    z = near + share[:, 2] * (far - near)
    points = rays / rays[:, 2:] * z[:, None]
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _moved(source: ErrorSource, home: Rigid, pose: Rigid, sigmas: Sigmas) -> tuple[tuple[ErrorSource, Array], ...]:
    """Return the errors of a camera that was calibrated at `home` and moved from there (`Viewpoint.moved`)."""
    motion = KnownMotion(pose.inv @ home).known_to(sigmas.position_mm, sigmas.rotation, about=home.origin)
    of_home, of_motion = motion.effects(home.origin, len(source.covariance))
    return (source, of_home), (ErrorSource("motion", motion.covariance, motion), of_motion)
