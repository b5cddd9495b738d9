"""What cameras see of a part from within its ball, where none of its aspects is seen: a hold from inside, a long beam.

What is in view there depends on where the camera stands, not on a direction alone, and most of the part is not in view.
So the lines that each camera sees from one known pose stand for what it sees from poses near by.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.views.aspects import Aspect
from cadcam.locate.views.pieces import Pieces, leads_on
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Polylines

_SHORTEST_PX = 1e-6  # a piece that is shorter in the picture points at the camera: it tells nothing there


@dataclass(frozen=True, slots=True, eq=False)
class Outlook:
    """The lines in view of cameras (E,) as their only aspects, by camera, and the middle and size of those lines.

    seeing: the cameras' numbers, among those asked for. eyes, axes (E, 3): where they stand, mm, and look. centre (3,),
    radius: of the lines of the one that sees most, rms, mm. boxes (E, 2, 2): least and greatest x, y of what each sees,
    px. All in the part frame.
    """

    seeing: tuple[int, ...]
    eyes: Array
    axes: Array
    centre: Array
    radius: float
    made: Mapping[tuple[int, int], Aspect]
    boxes: Array

    @classmethod
    def of(cls, drawer: LineDrawer, views: Sequence[tuple[Camera, Rigid]], margin_px: float) -> Outlook | None:
        """Return the outlook of cameras at poses (camera_from_part), which see so much beyond their pictures.

        Only of those that see a line; None where none does.
        """
        options = LineOptions(margin_px=margin_px)
        drawn = [_pieces_of(drawer.draw(*view, options=options).visible) for view in views]
        seeing = [k for k, pieces in enumerate(drawn) if len(pieces.line)]
        if not seeing:
            return None
        poses = [views[k][1] for k in seeing]
        centre, radius = _ball_of(max(drawn, key=lambda pieces: float(pieces.length.sum())))
        made = {(n, 0): _aspect(drawn[k], *views[k], centre, radius) for n, k in enumerate(seeing)}
        boxes = [_box(drawn[k], *views[k]) for k in seeing]
        eyes, axes = np.stack([pose.origin for pose in poses]), np.stack([pose.rotation[2] for pose in poses])
        return cls(tuple(seeing), eyes, axes, centre, radius, made, np.array(boxes))

    def nearest(self, eyes: Array, axes: Array, /) -> tuple[Ids, Ids]:
        """Return the index (N,) of the camera that stands and looks most like each of others, and zeros (N,).

        eyes (N, 3) mm, axes (N, 3): of those, in the part frame.
        """
        away = np.linalg.norm(eyes[:, None] - self.eyes, axis=2) / self.radius
        turned = np.linalg.norm(axes[:, None] - self.axes, axis=2)
        return np.argmin(away + turned, axis=1).astype(np.int32), np.zeros(len(eyes), np.int32)

    def make(self, keys: Iterable[tuple[int, int]]) -> None:
        """Do nothing: all are made."""

    def span(self, camera: Camera, camera_from_part: Rigid) -> tuple[Array, Array]:
        """Return the corners (px) of the bounding box of what the camera most like this one sees."""
        number, _ = self.nearest(camera_from_part.origin[None], camera_from_part.rotation[2:])
        low, high = self.boxes[number[0]]
        return low, high


def _pieces_of(lines: Polylines) -> Pieces:
    first = np.flatnonzero(leads_on(lines.start, len(lines.q)))
    pieces = Pieces.between(lines.q, lines.p, first, lines.line_of_point[first])
    return pieces.select(np.flatnonzero(pieces.length > _SHORTEST_PX))


def _ball_of(pieces: Pieces) -> tuple[Array, float]:
    """Return the middle (3,) mm of the pieces, each as long as it is in the picture, and their rms distance from it."""
    ends, weights = np.concatenate([pieces.a, pieces.b]), np.tile(pieces.length, 2)
    centre = np.average(ends, axis=0, weights=weights)
    return centre, float(np.sqrt(np.average(np.sum((ends - centre) ** 2, axis=1), weights=weights)))


def _box(pieces: Pieces, camera: Camera, camera_from_part: Rigid) -> tuple[Array, Array]:
    q = camera.project(camera_from_part @ np.concatenate([pieces.a, pieces.b]))
    return q.min(axis=0), q.max(axis=0)


def _aspect(pieces: Pieces, camera: Camera, camera_from_part: Rigid, centre: Array, radius: float) -> Aspect:
    shown = pieces.shown(camera_from_part, centre, radius)
    sight = camera_from_part.origin - centre
    distance = float(np.linalg.norm(sight))
    return Aspect(sight / distance, distance, *shown[:3], shown.length * distance / (camera.fx * 2 * radius))
