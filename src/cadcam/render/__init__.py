"""Images from CAD: shaded views, visible wireframes, and both over a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cadcam.errors import UnknownName

if TYPE_CHECKING:
    from cadcam.render.view import Renderer, Scene

RENDERERS = ("ray",)


def open_renderer(scene: Scene, name: str = "auto") -> Renderer:
    """Return a renderer of the scene: "ray" (Embree, through the exact lens), or "auto", the fastest exact one here."""
    if name not in ("auto", *RENDERERS):
        raise UnknownName("renderer", name, ("auto", *RENDERERS))
    from cadcam.render.ray import RayRenderer

    return RayRenderer(scene)
