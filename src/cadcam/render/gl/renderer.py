"""OpenGL 4.3 without a window: the GPU finds the face seen at each pixel centre; the rest is double precision.

A camera without distortion is drawn through `camera.opengl.projection_matrix`, so skew, aspect and principal point are
exact; outlines then are those of OpenGL's own rasteriser, on its grid of 1/256 px. For any other camera the triangles
are drawn approximately and slightly too wide (`render.gl.pieces`), and each pixel centre is tested at its undistorted
direction against the edges: no vertex of an outline is ever distorted, and outlines are exact to the rounding of single
precision, about 1e-7 of the focal length. The depth, normal and shading of the face found are computed in double
precision at the exact direction of the pixel centre. Where two faces are closer in depth than 1e-7 of the scene's depth
range, or of the depth itself, either may be seen.

Colours are those of the faces, as for all renderers; a `Mesh` carries no textures.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterable, Iterator
from functools import partial

from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid
from cadcam.render.gl.context import GlInfo, open_gl
from cadcam.render.gl.scene import GpuScene
from cadcam.render.memory import Buffers, check_memory
from cadcam.render.view import (
    PLAIN,
    Channel,
    Look,
    Scene,
    View,
    expect_poses,
    expect_view,
    layers_of,
    with_image,
    with_rgb,
)


class GlRenderer:
    """Renders a scene with OpenGL on EGL; implements the `Renderer` protocol, and may be called from any thread.

    `device` is an index or a part of a name (see `render.gl.probe`). All renderers of a process share one context per
    device. `close`, a `with` block, or the renderer's deletion releases its GPU memory. Raises `MissingExtra` without
    moderngl, `MissingOpenGL` where EGL does not answer, `NotEnoughMemory` for a mesh beyond the GPU's largest buffer.
    """

    name = "gl"

    def __init__(self, scene: Scene, *, device: int | str | None = None) -> None:
        if not scene.mesh.n_faces:
            raise DegenerateGeometry("a mesh without faces cannot be rendered")
        self._scene, self._device = scene, device
        self._thread = open_gl(device)
        self._buffers = Buffers()
        self._gpu = self._thread.submit(lambda: GpuScene(self._thread, scene)).result()
        self._end = weakref.finalize(self, self._thread.discarded.append, self._gpu)

    def __reduce__(self) -> tuple[Callable[[Scene], GlRenderer], tuple[Scene]]:
        return partial(type(self), device=self._device), (self._scene,)

    def __repr__(self) -> str:
        return f"GlRenderer({self._scene!r}, on {self.info.renderer})"

    @property
    def scene(self) -> Scene:
        """The scene it was made from."""
        return self._scene

    @property
    def info(self) -> GlInfo:
        """The device it draws on."""
        return self._thread.info

    def close(self) -> None:
        """Release its GPU memory now; it cannot render afterwards. May be called again."""
        self._end()
        self._thread.submit(lambda: None).result()

    def __enter__(self) -> GlRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def render(
        self,
        camera: Camera,
        camera_from_world: Rigid,
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> View:
        """Return the view; see `Renderer.render`."""
        expect_view(camera, [camera_from_world], channels, look)
        if not self._end.alive:
            raise BadValue("renderer", "closed", "one that is still open")
        wanted = layers_of(with_image(channels))
        need = camera.width * camera.height * sum(layer.pixel_bytes for layer in wanted.values())
        check_memory(need, f"a view of {camera.width} x {camera.height} px")
        layers = {name: self._buffers.take(layer.shape(camera), layer.dtype) for name, layer in wanted.items()}
        if not self._thread.submit(lambda: self._gpu.fill(layers, camera, camera_from_world, look)).result():
            for name, layer in layers.items():
                layer[...] = look.background if name == "image" else wanted[name].background
        return View(camera, camera_from_world, with_rgb(layers, channels))

    def render_batch(
        self,
        camera: Camera,
        poses: Iterable[Rigid],
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> Iterator[View]:
        """Yield a view for each camera_from_world; see `Renderer.render_batch`."""
        expect_poses(poses)
        for pose in poses:
            yield self.render(camera, pose, channels=channels, look=look)
