"""What the chosen cameras will show: the scene rendered with its lines and features; the part with its coverage."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.draw import draw_points, draw_polylines
from cadcam.plan.coverage import Painting
from cadcam.plan.layout import Layout
from cadcam.render import open_renderer
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.overlay import LineStyle, overlay
from cadcam.render.standard_view import standard_view
from cadcam.render.view import Channel, Look, Scene

_WIDE = 960  # px: longest side of a picture
SEEN, UNSEEN = (0.0, 0.62, 0.45), (0.84, 0.30, 0.0)
_LINES = LineStyle(color_by="one", color=(0.15, 0.15, 0.15), width=1.0, opacity=0.7)
_SHADED = Look(supersampling=2, background=(0.93, 0.94, 0.95))
_FLAT = Look(head=0.25, fill=0.15, back=0.1, ambient=0.65, supersampling=2)


def world_scene(layout: Layout, pose: Rigid) -> Scene:
    """Return the part in a pose, with all that stands around."""
    part = layout.survey.scene.part.transformed(pose)
    obstacles = layout.survey.scene.obstacles
    return Scene.of(part if obstacles is None else merge([part, obstacles]))


def camera_pictures(layout: Layout, *, pose: int = 0) -> list[Picture]:
    """Return what each chosen camera sees in a pose: shaded, lines, features seen (green) and not (orange)."""
    seen = layout.survey
    scene = world_scene(layout, seen.poses[pose])
    renderer, lines = open_renderer(scene), LineDrawer(scene)
    out = []
    for candidate, what in zip(layout.cameras, layout.visibility, strict=True):
        camera, camera_from_world = _smaller(candidate.camera), candidate.viewpoint.camera_from_world
        view = renderer.render(camera, camera_from_world, channels=Channel.IMAGE, look=_SHADED)
        picture = overlay(view.image, lines.draw(camera, camera_from_world), style=_LINES)
        out.append(_features(picture, layout, camera, camera_from_world @ seen.poses[pose], what.seen[pose]))
    return out


def _features(picture: Picture, layout: Layout, camera: Camera, camera_from_part: Rigid, seen: Array) -> Picture:
    features = layout.survey.scene.features
    for shown, color in ((False, UNSEEN), (True, SEEN)):
        chosen = [f for f, s in zip(features, seen, strict=True) if bool(s) is shown]
        marks = [f.p for f in chosen if f.segments is None]
        if marks:
            q = camera.project(camera_from_part @ np.array(marks))
            picture = draw_points(picture, q[camera.sees(q)], color=color, mark="circle", size=13, width=2.5)
        edges = [np.asarray(s) for f in chosen if f.segments is not None for s in f.segments]
        if edges:
            ends = camera.project(camera_from_part @ np.array(edges))
            picture = draw_polylines(picture, list(ends), color=color, width=3.0, opacity=0.9)
    return picture


def _smaller(camera: Camera) -> Camera:
    times = _WIDE / max(camera.size)
    if times >= 1:
        return camera
    return camera.resize((round(camera.width * times), round(camera.height * times)))


def coverage_pictures(layout: Layout, painting: Painting) -> list[tuple[str, Picture]]:
    """Return a painting of the part, from the side of the cameras and from behind, with what each picture shows."""
    part = layout.survey.scene.part
    renderer, drawn = open_renderer(painting.scene()), LineDrawer(Scene.of(part))
    out = []
    for title, camera, pose in _sides(layout, part):
        view = renderer.render(camera, pose, channels=Channel.IMAGE, look=_FLAT)
        out.append((f"{painting.title}, {title}", overlay(view.image, drawn.draw(camera, pose), style=_LINES)))
    return out


def _sides(layout: Layout, part: Mesh) -> list[tuple[str, Camera, Rigid]]:
    """Return two views: as the cameras stand on average, and from the other side."""
    middle = part.bounds.mean(axis=0)
    world_from_part = layout.survey.poses[0]
    eyes = world_from_part.inv @ np.array([c.eye for c in layout.cameras])
    towards = (eyes - middle) / np.linalg.norm(eyes - middle, axis=1, keepdims=True)
    mean = towards.mean(axis=0)
    flat = np.linalg.norm(mean[:2])
    below = mean[2] < -0.5 * flat
    aside, rise = (np.array([1.0, -1.3]), 0.9) if flat < 0.15 else (mean[:2] / flat, max(abs(mean[2]) / flat, 0.5))
    mean = np.array([*aside, -rise if below else rise])
    camera, _ = standard_view(part, size=(_WIDE, 720))
    radius = float(np.linalg.norm(part.size_mm)) / 2
    out = []
    for title, direction in (("from where the cameras are", mean), ("from the other side", mean * [-1, -1, 1])):
        eye = middle + direction / np.linalg.norm(direction) * 3.2 * radius
        pose = Rigid.look_at(eye, middle)
        m = camera.lens.project(pose @ part.vertices[np.unique(part.faces)])
        low, high = m.min(axis=0), m.max(axis=0)
        focal = float(np.min(np.array(camera.size) / (1.08 * (high - low))))
        cx, cy = (np.array(camera.size) - 1) / 2 - focal * (low + high) / 2
        out.append((title, Camera.from_focal(camera.size, focal, cx=float(cx), cy=float(cy)), pose))
    return out
