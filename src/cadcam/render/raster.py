"""The embedded rasteriser: every channel at the exact pixel centres, through the exact lens, on all cores.

The core (`cadcam.native`) draws in the plane of the pixels, or, for a distorting camera, in the undistorted plane at
the point of each pixel: no vertex is ever distorted. Coverage is decided in double precision; depth is that of the
face's plane, rounded to float twice (1.2e-7 relative). Where faces tie in depth to float precision, the lower face
number wins.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future
from functools import partial
from queue import SimpleQueue
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Mask
from cadcam.cad.topology import is_solid
from cadcam.camera.camera import Camera
from cadcam.cores import Threads, usable_cores
from cadcam.errors import BadValue, DegenerateGeometry
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect_count
from cadcam.native.core import LONGEST, NativeLens, NativeScene, RasterFrame, Request, Workers
from cadcam.render.lens_tables import TABLES
from cadcam.render.memory import Buffers, check_memory
from cadcam.render.shade import unit
from cadcam.render.strips import Grids
from cadcam.render.view import PLAIN, Channel, Look, Scene, View, expect_poses, expect_view, layers_of

_BAND = 1 << 17  # samples drawn at a time, of 8 bytes: they fit in the second-level cache
_MANY = 1 << 18  # faces from which threads cull them together, and finer bands are worth their duplicate work
_SHADED = Channel.IMAGE | Channel.RGB


class _Picture(NamedTuple):
    """A picture being drawn."""

    grids: Grids
    pose: Rigid
    look: Look
    layers: Mapping[str, npt.NDArray[Any]]


class RasterRenderer:
    """Renders a scene with the embedded rasteriser; implements the `Renderer` protocol.

    `threads` is the number of threads, by default one per core. Pictures do not depend on it. `backs=False` leaves out
    back faces, where the mesh is solid and the camera outside its box: those in front hide them, so that only samples
    on a silhouette, to within float's rounding of depth, can differ; `solid`: the result of `is_solid` for the mesh, if
    already known. Raises `MissingCore` where the compiled core is not installed.
    """

    name = "raster"

    def __init__(
        self, scene: Scene, *, threads: int | None = None, backs: bool = True, solid: bool | None = None
    ) -> None:
        if threads is not None:
            expect_count(threads, "threads")
        mesh = scene.mesh
        if not mesh.n_faces:
            raise DegenerateGeometry("a mesh without faces cannot be rendered")
        self._scene = scene
        self._native = NativeScene(mesh.vertices, mesh.faces, mesh.part, scene.paint, scene.colors)
        self._solid = None if backs or not (is_solid(mesh) if solid is None else solid) else mesh.bounds
        self._threads = threads or usable_cores()
        self._pool = Threads(self._threads)
        self._workers = Workers()
        self._buffers = Buffers()
        self._lenses: dict[tuple[Any, ...], NativeLens] = {}

    def __reduce__(self) -> tuple[Callable[[Scene], RasterRenderer], tuple[Scene]]:
        solid = self._solid is not None
        return partial(type(self), threads=self._threads, backs=not solid, solid=solid), (self._scene,)

    def __repr__(self) -> str:
        return f"RasterRenderer({self._scene!r}, {self._threads} threads)"

    @property
    def scene(self) -> Scene:
        """The scene it was made from."""
        return self._scene

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
        self._prepare(camera, channels, look, 1)
        return self._view(camera, camera_from_world, channels, look, threads=self._threads)

    def render_batch(
        self,
        camera: Camera,
        poses: Iterable[Rigid],
        *,
        channels: Channel = Channel.ALL,
        look: Look = PLAIN,
    ) -> Iterator[View]:
        """Yield a view for each camera_from_world; one thread per picture, a few pictures ahead."""
        expect_view(camera, (), channels, look)
        expect_poses(poses)
        self._prepare(camera, channels, look, self._threads + 1)
        under_way: deque[Future[View]] = deque()
        for pose in poses:
            expect_motion(pose, "camera_from_world")
            under_way.append(self._pool.submit(self._view, camera, pose, channels, look, threads=1))
            if len(under_way) > self._threads:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()

    def hides(self, points: Array, eye: Array, *, tolerance: float) -> Mask:
        """Return which points (N, 3) mm a face hides from the eye (3,), exactly, as `occlusion.OccludingFaces`.

        A face hides a point that lies more than `tolerance` mm off its plane, where it meets the segment to the eye.
        """
        return self._native.hides(points, eye, tolerance)

    def _prepare(self, camera: Camera, channels: Channel, look: Look, pictures: int) -> None:
        """Check sizes and memory, then make the lens' tables, before any thread starts."""
        n = look.supersampling if channels & _SHADED else 1
        if max(camera.size) * n > LONGEST:
            raise BadValue("picture size times supersampling", f"{camera.size} x {n}", f"at most {LONGEST} px a side")
        grids = Grids.of(camera, channels, look)
        layers = sum(layer.pixel_bytes for layer in layers_of(channels).values())
        what = f"a view of {camera.width} x {camera.height} px" + (f" with {n} x {n} samples a pixel" if n > 1 else "")
        check_memory(camera.width * camera.height * layers * pictures + grids.table_bytes(self._threads), what)
        if grids.whole:
            self._tables(grids)

    def _view(self, camera: Camera, pose: Rigid, channels: Channel, look: Look, *, threads: int) -> View:
        layers = {
            name: self._buffers.take(layer.shape(camera), layer.dtype) for name, layer in layers_of(channels).items()
        }
        picture = _Picture(Grids.of(camera, channels, look), pose, look, layers)
        if picture.grids.whole:
            self._draw(picture, slice(0, camera.height), self._tables(picture.grids), threads)
        else:
            self._draw_strips(picture, threads)
        return View(camera, pose, layers)

    def _draw_strips(self, picture: _Picture, threads: int) -> None:
        """Draw strip by strip, each with tables of its own: a thread makes them, draws through them, lets them go."""
        at_once = picture.grids.at_once(threads)
        left: SimpleQueue[slice | None] = SimpleQueue()
        for rows in (*picture.grids.strips(), *[None] * at_once):  # None: an end for each thread
            left.put(rows)

        def some() -> None:
            for rows in iter(left.get, None):
                self._draw(picture, rows, picture.grids.tables(rows), 1)

        self._together(some, at_once)

    def _draw(self, picture: _Picture, rows: slice, tables: Mapping[int, NativeLens], threads: int) -> None:
        """Draw some rows of a picture through the tables of these rows."""
        frame = RasterFrame(self._native, self._request(picture, rows, tables, threads))
        self._together(frame.look, threads if self._scene.mesh.n_faces > _MANY else 1)
        self._together(lambda: self._workers.run(frame), threads)

    def _together(self, task: Callable[[], None], threads: int) -> None:
        """Run a task of many parts on some threads: each takes parts until none is left."""
        helpers = [self._pool.submit(task) for _ in range(threads - 1)]
        task()
        for helper in helpers:
            if not helper.cancel():  # one that has not started has nothing left to do
                helper.result()

    def _request(self, picture: _Picture, rows: slice, tables: Mapping[int, NativeLens], threads: int) -> Request:
        camera, n, look = picture.grids.camera, picture.grids.finest, picture.look
        R, t = picture.pose.rotation, picture.pose.translation
        K = np.eye(3) if tables else camera.K
        request = Request(width=camera.width, height=rows.stop - rows.start, samples=n)
        shares = 1 if threads == 1 else threads * (4 if self._scene.mesh.n_faces > _MANY else 2)
        request.fronts = self._solid is not None and _outside(self._solid, picture.pose.origin)
        request.bands = max(request.width * request.height * n * n // _BAND, shares)
        request.plane[:] = (K @ np.column_stack([R, t])).ravel().tolist()
        request.ray[:] = (R.T @ np.linalg.inv(K)).ravel().tolist()
        request.rotation[:] = R.ravel().tolist()
        request.ambient, request.head, request.fill, request.back = look.ambient, look.head, look.fill, look.back
        request.fill_from[:] = (R.T @ unit(look.fill_from)).tolist()
        request.back_from[:] = (R.T @ unit(look.back_from)).tolist()
        request.background[:] = list(look.background)
        if tables:
            request.lens = tables[n].address
            request.centres = tables[1].address if 1 in tables else None
        for name, layer in picture.layers.items():
            setattr(request, name, layer[rows].ctypes.data)
        return request

    def _tables(self, grids: Grids) -> dict[int, NativeLens]:
        """Return the tables of a whole picture, by samples along a pixel; none without distortion."""
        return {} if grids.plain else {n: self._lens(grids.camera, n) for n in grids.samples}

    def _lens(self, camera: Camera, n: int) -> NativeLens:
        """Return the table of a camera for n x n samples per pixel; this renderer keeps those of the last camera."""
        of_camera = (camera.size, camera.K.tobytes(), camera.lens)
        key = (*of_camera, n)
        if key not in self._lenses:
            self._lenses = {k: v for k, v in self._lenses.items() if k[:-1] == of_camera}
            self._lenses[key] = TABLES.table(camera, n)
        return self._lenses[key]


def _outside(box: Array, point: Array) -> bool:
    return bool(((point < box[0]) | (point > box[1])).any())
