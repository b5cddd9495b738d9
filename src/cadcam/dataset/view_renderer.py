"""Renders and labels the views: from a shot to the picture and all of its labels, as arrays."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.camera.camera import Camera
from cadcam.dataset.backdrop import backdrop_picture
from cadcam.dataset.plan import PLAIN, middle_and_radius
from cadcam.dataset.props import Prop
from cadcam.dataset.reach import beyond, reach
from cadcam.dataset.shot import Shot
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.image.sensor.sensor import Sensor
from cadcam.native.layers import Box, mask_region
from cadcam.render.lines.seen import Drawable, SeenEdges, seen_points
from cadcam.render.lines.visible import COINCIDENT_SHARE
from cadcam.render.lines.wireframe import Polylines
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Look, Scene, View

_GEOMETRY = Channel.DEPTH | Channel.NORMAL
NOWHERE = (-1, -1, -1, -1)
ABSENT, HIDDEN, VISIBLE = 0, 1, 2  # COCO's words for key points


@dataclass(frozen=True, slots=True, eq=False)
class ViewInputs:
    """What all views of a data set are made from, beside their shots.

    props: what may hide the part; key_points (K, 3) mm in the part frame; gray: whether pictures are grey; depth_step:
    mm per step of the depth files.
    """

    scene: Scene
    props: tuple[Prop, ...]
    key_points: Array
    sensor: Sensor | None
    gray: bool
    depth_step: float


@dataclass(frozen=True, slots=True, eq=False)
class LabelledView:
    """A view and its labels, all at pixel centres; occluders hide the part in all but `mask` and the `whole_` ones.

    picture: uint8 (H, W) or (H, W, 3). depth (H, W) mm, inf behind everything; normal (H, W, 3) in the camera frame.
    mask: where the part is, hidden or not, and how many pixels that is; visible: where it is seen, how many pixels that
    is, and the first and last column and row of them: x0, y0, x1, y1. whole_count and whole_box: of the part's pixels,
    those up to a picture's size beyond its border too, as BOP counts.
    edges: visible stretches. q (K, 2) px and seen (K,) of the key points: ABSENT, HIDDEN, VISIBLE.
    """

    shot: Shot
    picture: npt.NDArray[np.uint8]
    depth: Picture
    normal: Picture
    mask: Mask
    count: int
    visible: Mask
    visible_count: int
    visible_box: Box
    whole_count: int
    whole_box: Box
    edges: Polylines
    q: Array
    seen: Ids


class ViewRenderer:
    """Renders and labels shots; each worker has one. edges: the scene's, prepared for all views."""

    def __init__(self, inputs: ViewInputs, edges: Drawable) -> None:
        self.inputs = inputs
        self._part = RasterRenderer(inputs.scene, threads=1, backs=False, solid=edges.solid)
        self._props: dict[int, RasterRenderer] = {}
        self._edges = SeenEdges(inputs.scene, edges)
        self._tolerance = COINCIDENT_SHARE * 2 * middle_and_radius(inputs.scene.mesh)[1]

    def view(self, shot: Shot, photo: bytes | None = None) -> LabelledView:
        """Return the labelled view of a shot; `photo`: content of the background's file, where it is one."""
        quick = self._is_plain(shot)
        color = Channel.RGB if quick else Channel.IMAGE
        look = shot.look if quick else replace(shot.look, background=(0.0, 0.0, 0.0))
        part = self._part.render(shot.camera, shot.camera_from_part, channels=_GEOMETRY | color, look=look)
        before = [self._prop(placed.prop, shot.camera, placed.camera_from_occluder, look) for placed in shot.occluders]
        nearest = _in_front([part, *before])
        mask = part.depth < np.inf
        visible = mask & (nearest.depth == part.depth) if before else mask
        count, box = mask_region(mask)
        visible_count, visible_box = mask_region(visible) if before else (count, box)
        whole_count, whole_box = (count, box) if count and _within(box, mask) else self._silhouette(shot, count, box)
        p = shot.camera_from_part @ self.inputs.key_points
        q = shot.camera.project(p)
        return LabelledView(
            shot=shot,
            picture=part.rgb if quick else self._developed(shot, part, before, photo),
            depth=nearest.depth,
            normal=nearest.normal,
            mask=mask,
            count=count,
            visible=visible,
            visible_count=visible_count,
            visible_box=visible_box,
            whole_count=whole_count,
            whole_box=whole_box,
            edges=self._edges.draw(nearest),
            q=q,
            seen=self._seen(nearest, p, q),
        )

    def _is_plain(self, shot: Shot) -> bool:
        """Return whether the renderer's own bytes are the picture: nothing is laid behind or before the part."""
        plain = shot.backdrop.kind == PLAIN and not shot.occluders
        return plain and self.inputs.sensor is None and not self.inputs.gray

    def _prop(self, number: int, camera: Camera, pose: Rigid, look: Look) -> View:
        """Return the rendering of a prop in its place; its renderer is made when it is needed first."""
        if number not in self._props:
            self._props[number] = RasterRenderer(self.inputs.props[number].scene, threads=1, backs=False)
        return self._props[number].render(camera, pose, channels=_GEOMETRY | Channel.IMAGE, look=look)

    def _developed(self, shot: Shot, part: View, before: list[View], photo: bytes | None) -> npt.NDArray[np.uint8]:
        """Return the picture: part and occluders over the background, imaged by the sensor."""
        image = backdrop_picture(shot.backdrop, shot.camera.size, photo)
        for layer in (part, *reversed(before)):  # rendered over black: colours are premultiplied by coverage
            image = image * (1 - layer.coverage[..., None]) + layer.image
        if self.inputs.gray:
            image = to_gray(image)
        if self.inputs.sensor is not None:
            image = self.inputs.sensor.apply(image, rng=np.random.default_rng(shot.sensor_seed))
        return (np.clip(image, 0, 1) * np.float32(255) + np.float32(0.5)).astype(np.uint8)

    def _seen(self, view: View, p: Array, q: Array) -> Ids:
        """Return the visibility of key points: occlusion by the view's depth, and by the part with rays in space."""
        eye, shown = view.camera_from_world.origin, np.flatnonzero(seen_points(view, p, q))
        inside = view.camera.sees(q)
        seen = np.where(inside, HIDDEN, ABSENT).astype(np.int32)
        hidden = self._part.hides(self.inputs.key_points[shown], eye, tolerance=self._tolerance)
        seen[shown[~hidden]] = VISIBLE
        return seen

    def _silhouette(self, shot: Shot, count: int, box: Box) -> tuple[int, Box]:
        """Return count and bounds x0, y0, x1, y1 (inclusive) of the part's pixels, those outside the picture too.

        count, box: of those within.
        """
        p = shot.camera_from_part @ self.inputs.scene.mesh.vertices
        found = [(count, box)]
        for left, top, right, bottom in beyond(
            reach(shot.camera, p, samples=shot.look.supersampling), shot.camera.size
        ):
            camera = shot.camera.crop(left, top, (right - left, bottom - top))
            depth = self._part.render(camera, shot.camera_from_part, channels=Channel.DEPTH).depth
            own, (x0, y0, x1, y1) = mask_region(depth < np.inf)
            found.append((own, (x0 + left, y0 + top, x1 + left, y1 + top)))
        boxes = np.array([of_area for n, of_area in found if n])
        if not len(boxes):
            return 0, NOWHERE
        (x0, y0), (x1, y1) = boxes[:, :2].min(axis=0).tolist(), boxes[:, 2:].max(axis=0).tolist()
        return sum(n for n, _ in found), (x0, y0, x1, y1)


def _in_front(views: list[View]) -> View:
    """Return depth and normals of the nearest surfaces over views of the same camera."""
    first, *others = views
    if not others:
        return first
    depth, normal = first.depth.copy(), first.normal.copy()
    for other in others:
        nearer = other.depth < depth
        depth[nearer], normal[nearer] = other.depth[nearer], other.normal[nearer]
    return View(first.camera, first.camera_from_world, {"depth": depth, "normal": normal})


def _within(box: Box, mask: Mask) -> bool:
    """Return whether a box of pixels does not touch the border of the picture of a mask."""
    return box[0] > 0 and box[1] > 0 and box[2] < mask.shape[1] - 1 and box[3] < mask.shape[0] - 1
