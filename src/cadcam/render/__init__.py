"""Images from CAD: shaded views, visible wireframes, and both over a photo."""

from __future__ import annotations

from typing import TYPE_CHECKING

from cadcam.errors import MissingCore

if TYPE_CHECKING:
    from cadcam.render.view import Renderer, Scene

RENDERERS = ("raster", "gl", "ray")


def auto_choice() -> tuple[str, str]:
    """Return the renderer that "auto" selects on this machine, and why."""
    from cadcam.native.core import variant

    try:
        return "raster", f"the compiled core is there ({variant()})"
    except MissingCore as error:
        return "ray", f"the compiled core is not: {error.why}"


def open_renderer(scene: Scene, name: str = "auto", *, threads: int | None = None) -> Renderer:
    """Return a renderer of the scene: "raster" (the embedded rasteriser), "gl" (OpenGL), "ray" (rays), or "auto".

    All draw through the exact lens. "auto" is "raster", or "ray" where the compiled core is not installed; OpenGL must
    be requested by name: on an H100 it drew half as fast as "raster" on the 16 cores beside it. `threads`: the number
    of the rasteriser's threads, by default one per core. Raises `MissingCore`, `MissingExtra` or `MissingOpenGL` if a
    renderer requested by name is not available.
    """
    from cadcam.kinds import expect, expect_count, expect_known
    from cadcam.render.view import Scene

    expect(scene, "scene", Scene)
    expect_known(name, "renderer", ("auto", *RENDERERS))
    if threads is not None:
        expect_count(threads, "threads")
    if name == "auto":
        name, _ = auto_choice()
    if name == "gl":
        from cadcam.render.gl.renderer import GlRenderer

        return GlRenderer(scene)
    if name == "raster":
        from cadcam.render.raster import RasterRenderer

        return RasterRenderer(scene, threads=threads)
    from cadcam.render.ray import RayRenderer

    return RayRenderer(scene)
