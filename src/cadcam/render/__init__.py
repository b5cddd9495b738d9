"""Images from CAD: shaded views, visible wireframes, and both over a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cadcam.errors import MissingCore, UnknownName

if TYPE_CHECKING:
    from cadcam.render.view import Renderer, Scene

RENDERERS = ("raster", "ray")


def open_renderer(scene: Scene, name: str = "auto") -> Renderer:
    """Return a renderer of the scene: "raster" (the embedded rasteriser), "ray" (Embree), or "auto".

    Both draw through the exact lens. "auto" is "raster", or "ray" where the compiled core is not installed.
    """
    if name not in ("auto", *RENDERERS):
        raise UnknownName("renderer", name, ("auto", *RENDERERS))
    if name != "ray":
        from cadcam.render.raster import RasterRenderer

        try:
            return RasterRenderer(scene)
        except MissingCore:
            if name == "raster":
                raise
    from cadcam.render.ray import RayRenderer

    return RayRenderer(scene)
