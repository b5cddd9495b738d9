"""The GPU buffers that a view is drawn into, kept from view to view: pictures come in thousands of one size."""

from __future__ import annotations

from typing import Any

from cadcam.camera.camera import Camera
from cadcam.render.gl.bend import BendTable
from cadcam.render.gl.tiles import Tile, plane_table

_KEPT_PIXELS = 1 << 23  # of tables of directions: 128 MiB


class Target:
    """Face numbers and depth of a tile, and the buffer that its layers are fetched from; grows as needed."""

    def __init__(self, gl: Any) -> None:
        self._gl = gl
        self._size = (0, 0)
        self._textures: list[Any] = []
        self._frame: Any = None
        self._output: Any = None

    def begin(self, size: tuple[int, int]) -> None:
        """Clear and prepare for drawing a tile of this size."""
        if size[0] > self._size[0] or size[1] > self._size[1]:
            self._make((max(size[0], self._size[0]), max(size[1], self._size[1])))
        self._frame.use()
        self._frame.viewport = (0, 0, *size)
        self._gl.enable_only(self._gl.DEPTH_TEST)
        self._gl.depth_func = "<"
        self._frame.clear(depth=1.0)  # this leaves face numbers undefined; they are not read there

    def use(self) -> None:
        """Bind the face numbers (unit 1) and depths (unit 2) for shaders."""
        for unit, texture in enumerate(self._textures, start=1):
            texture.use(unit)

    def output(self, size: int) -> Any:
        """Return a buffer of at least `size` bytes."""
        if self._output is None or self._output.size < size:
            if self._output is not None:
                self._output.release()
            self._output = self._gl.buffer(reserve=size, dynamic=True)
        return self._output

    def release(self) -> None:
        """Release everything."""
        for thing in (self._frame, *self._textures, self._output):
            if thing is not None:
                thing.release()
        self._frame, self._textures, self._output, self._size = None, [], None, (0, 0)

    def _make(self, size: tuple[int, int]) -> None:
        self.release()
        ids, depths = self._gl.texture(size, 1, dtype="i4"), self._gl.depth_texture(size)
        for texture in (ids, depths):
            texture.filter = (self._gl.NEAREST, self._gl.NEAREST)
        depths.compare_func = ""
        self._textures, self._size = [ids, depths], size
        self._frame = self._gl.framebuffer([ids], depths)


class Tables:
    """The directions of each pixel of a distorting camera, and the pixels of directions; those of the last are kept."""

    def __init__(self, gl: Any) -> None:
        self._gl = gl
        self._of: tuple[Any, ...] = ()
        self._kept: dict[tuple[Tile, int], Any] = {}
        self._pixels = 0
        self._bend: tuple[BendTable, Any] | None = None

    def nodes(self, bend: BendTable) -> Any:
        """Return the texture of a table of pixels by direction."""
        if self._bend is None or self._bend[0] is not bend:
            self._release_bend()
            texture = self._gl.texture(bend.nodes.shape[1::-1], 3, bend.nodes, dtype="f4")
            texture.filter = (self._gl.NEAREST, self._gl.NEAREST)
            self._bend = bend, texture
        return self._bend[1]

    def get(self, camera: Camera, tile: Tile, n: int) -> Any:
        """Return the texture of a tile with n x n samples per pixel."""
        of = (camera.size, camera.K.tobytes(), camera.lens)
        if of != self._of:
            self.release()
            self._of = of
        if (tile, n) not in self._kept:
            self._kept[tile, n] = self._make(tile.camera(camera, n))
        return self._kept[tile, n]

    def release(self) -> None:
        """Release everything."""
        for texture in self._kept.values():
            texture.release()
        self._kept, self._of, self._pixels = {}, (), 0
        self._release_bend()

    def _release_bend(self) -> None:
        if self._bend is not None:
            self._bend[1].release()
            self._bend = None

    def _make(self, camera: Camera) -> Any:
        of, pixels = self._of, camera.width * camera.height
        if self._pixels + pixels > _KEPT_PIXELS:
            self.release()
            self._of = of
        self._pixels += pixels
        texture = self._gl.texture(camera.size, 4, plane_table(camera), dtype="f4")
        texture.filter = (self._gl.NEAREST, self._gl.NEAREST)
        return texture
