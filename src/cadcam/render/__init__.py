"""Images from CAD: shaded views, visible wireframes, and both over a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cadcam.errors import MissingExtra, MissingOpenGL, NotEnoughMemory, UnknownName

if TYPE_CHECKING:
    from cadcam.render.view import Renderer, Scene

RENDERERS = ("gl", "ray")


def open_renderer(scene: Scene, name: str = "auto") -> Renderer:
    """Return a renderer of the scene: "gl" (OpenGL), "ray" (Embree), or "auto"; all draw through the exact lens.

    "auto" is "gl" where a GPU answers, else "ray": OpenGL without a GPU is slower. Raises `MissingExtra` or
    `MissingOpenGL` if "gl" is asked for by name and not there.
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
    from cadcam.render.ray import RayRenderer

    return RayRenderer(scene)


def _gpu_answers() -> bool:
    """Return whether OpenGL is here and not merely software."""
    from cadcam.render import gl_context

    if not gl_context.gpu_likely():
        return False
    info = gl_context.probe()
    return info.available and not info.software
