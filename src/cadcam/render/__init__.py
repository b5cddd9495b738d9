"""Images from CAD: shaded views, visible wireframes, and both over a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cadcam.errors import MissingCore, MissingExtra, MissingOpenGL, NotEnoughMemory, UnknownName

if TYPE_CHECKING:
    from cadcam.render.view import Renderer, Scene

RENDERERS = ("raster", "gl", "ray")


def open_renderer(scene: Scene, name: str = "auto") -> Renderer:
    """Return a renderer of the scene: "raster" (the embedded rasteriser), "gl" (OpenGL), "ray" (Embree), or "auto".

    All draw through the exact lens. "auto" is "gl" where a GPU answers, else "raster", or "ray" where the compiled core
    is not installed; OpenGL in software is never preferred. Raises `MissingCore`, `MissingExtra` or `MissingOpenGL` if
    what is asked for by name is not there.
    """
    if name not in ("auto", *RENDERERS):
        raise UnknownName("renderer", name, ("auto", *RENDERERS))
    if name == "gl" or (name == "auto" and _gpu_answers()):
        from cadcam.render.gl import GlRenderer

        try:
            return GlRenderer(scene)
        except (MissingExtra, MissingOpenGL, NotEnoughMemory):
            if name == "gl":
                raise
    if name != "ray":
        from cadcam.render.raster import RasterRenderer

        try:
            return RasterRenderer(scene)
        except MissingCore:
            if name == "raster":
                raise
    from cadcam.render.ray import RayRenderer

    return RayRenderer(scene)


def _gpu_answers() -> bool:
    """Return whether OpenGL is here and not merely software."""
    from cadcam.render import gl_context

    if not gl_context.gpu_likely():
        return False
    info = gl_context.probe()
    return info.available and not info.software
