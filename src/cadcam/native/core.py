"""The only module that meets the C core: loads it with ctypes, checks what goes in, owns what comes out.

The interface is src/cadcam/native/raster.h. ctypes releases the interpreter's lock during calls, so Python's threads
are the core's threads: each renders bands of the picture until none is left.
"""

from __future__ import annotations

import ctypes as c
import sys
import threading
import weakref
from collections.abc import Callable, Mapping, Sequence
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Mask, Picture
from cadcam.errors import BadValue, MissingCore, NotEnoughMemory

_SUFFIX = {"win32": ".dll", "darwin": ".dylib"}.get(sys.platform, ".so")
LIBRARY = Path(__file__).with_name("_raster" + _SUFFIX)
Signatures = Mapping[str, tuple[object, Sequence[object]]]  # by name: types of result (None: none) and arguments
LONGEST = 65535  # px along a side, counted in samples: the lens table stores them in 16 bits


class Request(c.Structure):
    """A request for one picture: cc_view in raster.h, field by field."""

    _fields_ = (
        ("plane", c.c_double * 12),
        ("ray", c.c_double * 9),
        ("rotation", c.c_double * 9),
        ("fill_from", c.c_double * 3),
        ("back_from", c.c_double * 3),
        ("ambient", c.c_float),
        ("head", c.c_float),
        ("fill", c.c_float),
        ("back", c.c_float),
        ("background", c.c_float * 3),
        ("width", c.c_int32),
        ("height", c.c_int32),
        ("samples", c.c_int32),
        ("bands", c.c_int32),
        ("fronts", c.c_int32),
        ("lens", c.c_void_p),
        ("centres", c.c_void_p),
        *((name, c.c_void_p) for name in ("image", "coverage", "depth", "normal", "part", "face", "rgb")),
    )


@cache
def library() -> c.CDLL:
    """Return the loaded core; raises `MissingCore` saying why there is none."""
    if not LIBRARY.exists():
        raise MissingCore("it was not built when cadcam was installed (no C compiler was found)")
    try:
        core = c.CDLL(str(LIBRARY))
    except OSError as error:
        raise MissingCore(f"{LIBRARY.name} cannot be loaded: {error}") from error
    pointer, i64, i32 = c.c_void_p, c.c_int64, c.c_int32
    signatures: Signatures = {
        "cc_scene_new": (pointer, [pointer, pointer, i64, pointer, pointer, pointer, i64]),
        "cc_scene_free": (None, [pointer]),
        "cc_scene_hides": (None, [pointer, pointer, c.c_double, i64, pointer, pointer]),
        "cc_lens_new": (pointer, [pointer, i32, i32]),
        "cc_lens_free": (None, [pointer]),
        "cc_worker_new": (pointer, []),
        "cc_worker_free": (None, [pointer]),
        "cc_frame_new": (pointer, [pointer, c.POINTER(Request)]),
        "cc_frame_look": (None, [pointer]),
        "cc_frame_work": (i32, [pointer, pointer]),
        "cc_frame_free": (None, [pointer]),
        "cc_variant": (c.c_char_p, []),
        "cc_choose_variant": (i32, [i32]),
    }
    return _typed(core, signatures)


def functions(what: str, signatures: Signatures) -> c.CDLL:
    """Return the loaded core with these signatures declared; `MissingCore` names `what` is missing without it."""
    try:
        return _typed(library(), signatures)
    except MissingCore as error:
        raise MissingCore(error.why, what, "reinstall") from None


def variant() -> str:
    """Return the instruction set in use: "x86-64-v3" or "baseline"."""
    return str(library().cc_variant().decode())


def choose_variant(level: int) -> str:
    """Use instruction set 0 (baseline) or 1 (x86-64-v3), or the best with -1; return the one in use."""
    library().cc_choose_variant(level)
    return variant()


class Handle:
    """An object of the core, freed with the last reference to it."""

    def __init__(self, made: int | None, free: Callable[[int], None], what: str) -> None:
        if not made:
            raise NotEnoughMemory(f"there is not enough memory for {what}")
        self.address = made
        weakref.finalize(self, free, made)  # that of the library which made it: another's may not know its arguments


class NativeScene(Handle):
    """Triangles copied into the core and grouped into clusters of neighbours.

    vertices (V, 3) mm float64, faces (F, 3) int32, part (F,) int32, paint (F,) int32: index into colors (C, 3) float32.
    """

    def __init__(self, vertices: Array, faces: Ids, part: Ids, paint: Ids, colors: Picture) -> None:
        vertices, faces = np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32)
        part, paint = np.ascontiguousarray(part, np.int32), np.ascontiguousarray(paint, np.int32)
        colors = np.ascontiguousarray(colors, np.float32)
        if not np.isfinite(vertices).all():
            at = int(np.argwhere(~np.isfinite(vertices))[0, 0])
            raise BadValue(f"vertex {at}", vertices[at].tolist(), "finite coordinates")
        _check_indices("face's vertex", faces, len(vertices))
        _check_indices("face's colour", paint, len(colors))
        if not faces.shape == (len(part), 3) == (len(paint), 3):
            raise BadValue("faces", f"of shape {faces.shape}", f"shape ({len(part)}, 3), one row a part and a colour")
        shape, look = addresses(vertices, faces), addresses(part, paint, colors)
        made = library().cc_scene_new(*shape, len(faces), *look, len(colors))
        super().__init__(made, library().cc_scene_free, f"a scene of {len(faces)} triangles")

    def hides(self, points: Array, eye: Array, tolerance: float) -> Mask:
        """Return which points (N, 3) mm faces hide from the eye (3,), faces in a plane within `tolerance` excepted."""
        points, eye = np.ascontiguousarray(points, np.float64), np.ascontiguousarray(eye, np.float64)
        out = np.zeros(len(points), bool)
        library().cc_scene_hides(self.address, *addresses(eye), tolerance, len(points), *addresses(points, out))
        return out


class NativeLens(Handle):
    """The point of the undistorted plane (x/z, y/z) that each pixel centre sees: (H, W, 2) float64, NaN for none."""

    def __init__(self, points: Array) -> None:
        points = np.ascontiguousarray(points, np.float64)
        height, width = points.shape[:2]
        self.size: tuple[int, int] = (width, height)
        made = library().cc_lens_new(points.ctypes.data, width, height)
        super().__init__(made, library().cc_lens_free, f"a lens table of {width} x {height} px")


class Worker(Handle):
    """The scratch memory of one thread."""

    def __init__(self) -> None:
        super().__init__(library().cc_worker_new(), library().cc_worker_free, "a thread's scratch")


class RasterFrame(Handle):
    """A picture being rendered: call `look` from any number of threads, then `work`, each with its own worker."""

    def __init__(self, scene: NativeScene, request: Request) -> None:
        self._kept = (scene, request)  # the core holds pointers to them
        made = library().cc_frame_new(scene.address, c.byref(request))
        super().__init__(made, library().cc_frame_free, f"a picture of {request.width} x {request.height} px")

    def look(self) -> None:
        """Find the triangles that may be visible, until no share of them is left."""
        library().cc_frame_look(self.address)

    def work(self, worker: Worker) -> None:
        """Render bands until none is left."""
        if library().cc_frame_work(self.address, worker.address):
            raise NotEnoughMemory("there is not enough memory for a band of the picture; use a smaller picture")


class Workers:
    """Workers lent to whichever threads ask: as many are created as work at the same time."""

    def __init__(self) -> None:
        self._idle: list[Worker] = []
        self._lock = threading.Lock()

    def run(self, frame: RasterFrame) -> None:
        """Work on a frame with an idle worker."""
        with self._lock:
            worker = self._idle.pop() if self._idle else Worker()
        try:
            frame.work(worker)
        finally:
            with self._lock:
                self._idle.append(worker)


def addresses(*arrays: npt.NDArray[np.generic]) -> list[int]:
    """Return the arrays' addresses for the core; the caller must keep the arrays alive."""
    return [array.ctypes.data for array in arrays]


def doubles(*arrays: Array) -> list[Array]:
    """Return arrays in the core's format for numbers: float64, row-major."""
    return [np.ascontiguousarray(array, np.float64) for array in arrays]


def _typed(core: c.CDLL, signatures: Signatures) -> c.CDLL:
    for name, (result, arguments) in signatures.items():
        function = getattr(core, name)
        function.restype, function.argtypes = result, arguments
    return core


def _check_indices(what: str, indices: npt.NDArray[np.int32], below: int) -> None:
    if indices.size and (int(indices.min()) < 0 or int(indices.max()) >= below):
        raise BadValue(what, f"from {indices.min()} to {indices.max()}", f"numbers from 0 to {below - 1}")
