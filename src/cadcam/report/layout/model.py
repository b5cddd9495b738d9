"""The part with the cameras around it, to be turned: painted by coverage, and as each camera will see it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import merge
from cadcam.image.svg import hex_color
from cadcam.plan.coverage import Painting, coarser
from cadcam.plan.layout import Layout
from cadcam.plan.sight.candidate import Candidate
from cadcam.render.view import Scene
from cadcam.report.layout.plan import HUES, field_corners
from cadcam.report.solid.figure import WHOLE, LineStyle, Look, Mark, Paint, SolidFigure

_PIECES = 60_000  # of the painted surface: 2 MB in a page
_PLAIN, _AROUND = "#d8d8d4", "#b4b9c0"  # the part where nothing is said of its surface; what stands around it


def model_figure(layout: Layout, paintings: Sequence[Painting]) -> str:
    """Return as HTML the part in its first pose, painted, with what stands around it and the fields of the cameras."""
    scene = layout.survey.scene
    pose, around = layout.survey.poses[0], scene.obstacles
    paintings = [coarser(painting, scene.part, _PIECES) for painting in paintings]
    painted = paintings[0].mesh if paintings else scene.part
    placed = [painted.transformed(pose), *([] if around is None else [around])]
    mesh = merge(placed)
    lines = [pose @ scene.part.vertices[Scene.of(scene.part).edges.vertices]]
    lines += [_field_lines(camera) for camera in layout.cameras]
    style = np.repeat(np.arange(len(lines)), [len(of) for of in lines])
    hues = [HUES[i % len(HUES)] for i in range(len(layout.cameras))]
    return SolidFigure(
        mesh,
        mesh.part_names,
        *_paints(paintings, painted.n_faces, mesh.n_faces),
        np.concatenate(lines),
        [LineStyle(), *(LineStyle(hue, 1.5) for hue in hues)],
        style,
        [WHOLE, *(_look(camera, number) for number, camera in enumerate(layout.cameras, 1))],
        [Mark(c.eye, f"{i}: {c.name}", hue) for i, (c, hue) in enumerate(zip(layout.cameras, hues, strict=True), 1)],
    ).html("the part and the cameras around it")


def _paints(paintings: Sequence[Painting], of_part: int, faces: int) -> tuple[list[str], list[Paint]]:
    """Return the colours of all paintings, after that of what stands around, and the paint of each."""
    colors, paints = [_AROUND], []
    for painting in paintings:
        color = np.zeros(faces, np.int64)
        color[:of_part] = len(colors) + painting.level
        paints.append(Paint(painting.title, color, [*[""] * len(colors), *painting.words]))
        colors += [hex_color(c.tolist()) for c in painting.colors]
    if paints:
        return colors, paints
    return [_AROUND, _PLAIN], [Paint("plain", (np.arange(faces) < of_part).astype(np.int64))]


def _field_lines(camera: Candidate) -> Array:
    """Return the lines (8, 2, 3) of a camera's field of view, from its eye to the distance of its aim."""
    far = field_corners(camera)
    rays = np.stack([np.broadcast_to(camera.eye, far.shape), far], axis=1)
    return np.concatenate([rays, np.stack([far, np.roll(far, -1, axis=0)], axis=1)])


def _look(camera: Candidate, number: int) -> Look:
    """Return what a camera sees, as large as at the distance of its aim."""
    distance = float(np.linalg.norm(camera.aim - camera.eye))
    tall = camera.camera.height * distance / camera.camera.fy
    return Look(f"from camera {number}", camera.viewpoint.camera_from_world, tall, cut=True)
