"""A block that moves in front of a camera, and stand-ins for what locates it that know the truth."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import FREE, Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason
from cadcam.locate.track.frames import Frame
from cadcam.locate.views.view_range import ViewRange
from cadcam.render.view import Scene

CAMERA = Camera.from_focal((64, 48), 60.0)
STEP = Rigid.exp([4.0, 0.5, -3.0, 0.02, -0.03, 0.01])
FIRST = Rigid.exp([-20.0, 5.0, 400.0, 0.4, 0.2, -0.3])


def block() -> Part:
    """Return a block of 60 x 40 x 20 mm."""
    v = np.array([[x, y, z] for x in (0, 60) for y in (0, 40) for z in (0, 20)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return Part(Scene.of(Mesh.single(v, np.array(faces))))


def truth(n: int) -> list[Rigid]:
    """Return where the block is in n frames: it moves evenly."""
    poses = [FIRST]
    for _ in range(n - 1):
        poses.append(poses[-1] @ STEP)
    return poses


def frames(n: int) -> list[Frame]:
    """Return n frames whose pictures all differ (the stand-ins do not look at them)."""
    return [Frame.of(i, Photo.of(np.full((48, 64), i / 255, np.float32), CAMERA)) for i in range(n)]


def measured(pose: Rigid) -> PoseEstimate:
    """Return a pose with what the stand-ins say of its covariance."""
    return PoseEstimate(pose, np.eye(6) * 1e-4)


def location(pose: Rigid, quality: float = 0.9, alternatives: tuple[Location, ...] = ()) -> Location:
    """Return a location without matches."""
    matches = Location.nowhere(pose, "").matches
    return Location(measured(pose), matches, quality, Reason("as good as it gets"), alternatives)


@dataclass
class Sighting:
    """Stands for `refine_pose` and `locate_part`: finds the true pose from a start near enough, and keeps the calls."""

    poses: list[Rigid]
    hidden: set[int] = field(default_factory=set)
    near_mm: float = 1.0
    around_mm: float = 30.0
    calls: list[tuple[str, int]] = field(default_factory=list)
    views: list[ViewRange | None] = field(default_factory=list)

    def refine(
        self, part: Part, photos: tuple[Photo, ...], start: Rigid, *, freedom: Freedom = FREE, **_: object
    ) -> Location:
        return self._seen("refine", photos, start, self.near_mm)

    def locate(
        self,
        part: Part,
        photos: tuple[Photo, ...],
        start: Rigid | None = None,
        *,
        freedom: Freedom = FREE,
        views: ViewRange | None = None,
    ) -> Location:
        self.views += [views] if start is None else []
        return self._seen("locate" if start is not None else "search", photos, start, self.around_mm)

    def _seen(self, how: str, photos: tuple[Photo, ...], start: Rigid | None, reach: float) -> Location:
        index = round(float(photos[0].gray[0, 0]) * 255)
        self.calls.append((how, index))
        off = 0.0 if start is None else float(np.linalg.norm(start.translation - self.poses[index].translation))
        if index in self.hidden or off > reach:
            return location(start if start is not None else Rigid(), quality=0.1)
        return location(self.poses[index])
