"""Comparison of edges with direction fields in the C core (field.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Ids, Longs, Mask, Picture
from cadcam.errors import BadValue
from cadcam.native.core import addresses, functions

SECTORS = 8
MARGIN, SPARE, SWEPT = 48, 3, 51  # CC_MARGIN, CC_SPARE, CC_SWEPT
PLACE = np.dtype([("p", np.float32, 3), ("tangent", np.float32, 3), ("weight", np.float32)])
Bytes = npt.NDArray[np.uint8]


class Planes(NamedTuple):
    """A field: planes (SECTORS, H, W) and their mean and variance (SECTORS,) over the picture, in units of 1/255."""

    values: Bytes
    mean: Picture
    variance: Picture


class _Field(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("planes", "mean", "variance")),
        ("width", c.c_int32),
        ("height", c.c_int32),
    )


class _Eye(c.Structure):
    _fields_ = (
        ("field", _Field),
        *((name, c.c_double) for name in ("fx", "skew", "cx", "fy", "cy")),
        ("rotation", c.c_double * 9),
        ("translation", c.c_double * 3),
    )


class _PoseEdges(c.Structure):
    _fields_ = (
        *((name, c.c_void_p) for name in ("eyes", "places", "first", "count")),
        ("n_eyes", c.c_int32),
        ("n_poses", c.c_int64),
    )


class Belief(NamedTuple):
    """Evidence of a sample: nats times (certainty - even), at most `most` per line; probability that lines are seen."""

    even: float
    nats: float
    most: float
    seen: float


class _Belief(c.Structure):
    _fields_ = tuple((name, c.c_double) for name in Belief._fields)


@cache
def _core() -> c.CDLL:
    at, i64, i32, edges = c.c_void_p, c.c_int64, c.c_int32, c.POINTER(_PoseEdges)
    return functions(
        "the search for parts",
        {
            "cc_reduce": (None, [at, i64, i32, i32, i32, at]),
            "cc_straighten": (None, [at, i32, i32, at, *[i32] * 3, at, at]),
            "cc_directions": (None, [at, i32, i32, c.c_float, *[at] * 4]),
            "cc_halve": (None, [at, i32, i32, *[at] * 3]),
            "cc_slide": (None, [edges, i32, at, *[i32] * 6, *[at] * 3]),
            "cc_sweep": (None, [edges, i32, at, i32, i32, *[at] * 3]),
            "cc_evidence": (None, [edges, i32, at, c.c_double, at, at, c.POINTER(_Belief), at, at]),
            "cc_climb": (None, [edges, at, at, i32, c.c_double, at, i32, at]),
            "cc_firsts": (i64, [at, i64, i64, c.c_double, at, at]),
        },
    )


def reduce(gray: Picture, k: int) -> Picture:
    """Return the means (H // k, W // k) over blocks of k x k pixels; a crop of a picture is read without copying."""
    gray = np.asarray(gray, np.float32)
    if gray.strides[1] != gray.itemsize:
        gray = np.ascontiguousarray(gray)
    height, width = gray.shape
    out = np.zeros((height // k, width // k), np.float32)
    _core().cc_reduce(gray.ctypes.data, gray.strides[0] // gray.itemsize, width, height, k, out.ctypes.data)
    return out


def straighten(gray: Picture, nodes: Picture, step: int, size: tuple[int, int]) -> tuple[Picture, Mask]:
    """Return a picture of `size` resampled from another at places given on a grid, and which of its pixels are valid.

    nodes (rows, columns, 2): place of every `step`-th pixel of every `step`-th row, from (0, 0) to beyond the last; nan
    for none. Linear between nodes and between pixels; an invalid pixel is like the border next to it.
    """
    gray, nodes = np.ascontiguousarray(gray, np.float32), np.ascontiguousarray(nodes, np.float32)
    (width, height), (rows, columns) = size, nodes.shape[:2]
    if (columns, rows) != ((width - 1) // step + 2, (height - 1) // step + 2):
        raise BadValue("nodes", f"{columns} x {rows}", f"one every {step} px of {width} x {height} px and beyond")
    out, seen = np.zeros((height, width), np.float32), np.zeros((height, width), bool)
    here = (gray.ctypes.data, gray.shape[1], gray.shape[0], nodes.ctypes.data)
    _core().cc_straighten(*here, step, width, height, *addresses(out, seen))
    return out, seen


def directions(gray: Picture, floor: float) -> Planes:
    """Return the direction field of a picture; `floor`: least noise of the gradient, grey value per pixel."""
    gray = np.ascontiguousarray(gray, np.float32)
    height, width = gray.shape
    made = _planes(height, width)
    scratch = np.zeros(50 * (width + 12), np.float32)
    _core().cc_directions(gray.ctypes.data, width, height, floor, scratch.ctypes.data, *addresses(*made))
    return made


def halve(planes: Planes) -> Planes:
    """Return the field at half the size, with the certainty of lines unchanged."""
    _, height, width = planes.values.shape
    made = _planes(height // 2, width // 2)
    _core().cc_halve(planes.values.ctypes.data, width, height, *addresses(*made))
    return made


def firsts(corners: Array, most: int, apart: float) -> Longs:
    """Return the indices of at most `most` of N poses, by their corners (N, 4, 3), each the first of those near it.

    Two poses are near each other if no corner differs by more than `apart`.
    """
    corners = np.ascontiguousarray(corners, np.float64)
    n = len(corners)
    kept, scratch = np.zeros(min(most, n), np.int64), np.zeros(n, np.uint8)
    found = _core().cc_firsts(corners.ctypes.data, n, len(kept), apart, *addresses(scratch, kept))
    return kept[:found]


class Eye(NamedTuple):
    """A field as one camera sees it: camera matrix K (3, 3), camera_from_world rotation (3, 3), translation (3,) mm."""

    planes: Planes
    K: Array
    rotation: Array
    translation: Array


class PoseEdges:
    """The edges to be scored: for each of N poses and each eye a run of samples (a structured array of PLACE).

    first, count (N, eyes): the runs.
    """

    def __init__(self, eyes: Sequence[Eye], places: npt.NDArray[np.void], first: Longs, count: Ids) -> None:
        self._eyes = (_Eye * len(eyes))(*(_eye(eye) for eye in eyes))
        self._first, self._count = np.ascontiguousarray(first, np.int64), np.ascontiguousarray(count, np.int32)
        self._places = np.ascontiguousarray(places, PLACE)
        self._kept = tuple(eyes)

    def part(self, poses: slice) -> PoseEdges:
        """Return the edges of some of the poses."""
        return PoseEdges(self._kept, self._places, self._first[poses], self._count[poses])

    def slide(
        self, eye: int, poses: Array, *, centre: tuple[int, int], reach: tuple[int, int], keep: int, apart: int
    ) -> tuple[Ids, Picture]:
        """Return the `keep` best shifts (N, keep, 2) px of each pose (N, 12) in one eye, and their scores (N, keep).

        Shifts are searched within `reach` of `centre`, no two within `apart`. Score: the sum above its mean at random
        places, in standard deviations of that; -inf where there are no more.
        """
        poses = np.ascontiguousarray(poses, np.float64)
        shift, score = np.zeros((len(poses), keep, 2), np.int32), np.zeros((len(poses), keep), np.float32)
        scratch = np.zeros((2 * reach[0] + 16) * (2 * reach[1] + 1), np.uint16)
        window = (*centre, *reach, keep, apart)
        _core().cc_slide(self._given(len(poses)), eye, poses.ctypes.data, *window, *addresses(scratch, shift, score))
        return shift, score

    def sweep(self, eye: int, poses: Array, *, keep: int, apart: int) -> tuple[Ids, Picture]:
        """Return where in one eye the edges of poses (N, 12) near its middle fit best, and the scores, as `slide` does.

        (N, keep, 2) px: the place of what was at the principal point, anywhere in the field. Sums are coarser than
        those of `slide`, and at most SWEPT samples of a run, within MARGIN px of the middle, are used.
        """
        poses = np.ascontiguousarray(poses, np.float64)
        _, height, width = self._kept[eye].planes.values.shape
        shift, score = np.zeros((len(poses), keep, 2), np.int32), np.zeros((len(poses), keep), np.float32)
        wide = width + 32
        rows = height + SPARE
        scratch = np.zeros(SECTORS * (rows + 2 * MARGIN) * (wide + 2 * MARGIN) + wide * rows, np.uint8)
        _core().cc_sweep(
            self._given(len(poses)), eye, poses.ctypes.data, keep, apart, *addresses(scratch, shift, score)
        )
        return shift, score

    def climb(self, poses: Array, freedom: Array, blur: Sequence[float], *, held: float = 0.0) -> tuple[Array, Array]:
        """Return poses (N, 12) moved uphill, one step per blur (px) but the last, and their scores (N, eyes, 4).

        The last blur is for the score: sum of weight times certainty, its mean and variance at random places, total
        weight in the picture. held: share of the lines' pull that motions along lines hold against; motions that few
        lines tell, as of a long bar along itself, are then small.
        """
        poses = np.array(poses, np.float64, order="C")
        freedom, widths = np.ascontiguousarray(freedom, np.float64), np.asarray(blur, np.float64)
        scores = np.zeros((len(poses), len(self._kept), 4))
        given = self._given(len(poses))
        _core().cc_climb(
            given, poses.ctypes.data, freedom.ctypes.data, freedom.shape[1], held, widths.ctypes.data, len(widths) - 1,
            scores.ctypes.data,
        )  # fmt: skip
        return poses, scores

    def evidence(self, eye: int, poses: Array, blur: float, line: Ids, share: Array, belief: Belief) -> Array:
        """Return the log-likelihood ratio (N,), nats, of one eye's picture with the lines of poses (N, 12) and without.

        line: number, from 0, of the line that each sample is on; share (N,): weight of a sample's nats. The certainty
        is the maximum along the normal under a Gaussian of `blur` px; see field.h.
        """
        poses, share = np.ascontiguousarray(poses, np.float64), np.ascontiguousarray(share, np.float64)
        line, out = np.ascontiguousarray(line, np.int32), np.zeros(len(poses))
        scratch = np.zeros(int(line.max(initial=0)) + 1)
        _core().cc_evidence(
            self._given(len(poses)), eye, poses.ctypes.data, blur, *addresses(line, share), c.byref(_Belief(*belief)),
            *addresses(scratch, out),
        )  # fmt: skip
        return out

    def _given(self, n: int) -> object:
        eyes = c.cast(self._eyes, c.c_void_p)
        runs = addresses(self._places, self._first, self._count)
        return c.byref(_PoseEdges(eyes, *runs, len(self._kept), n))


def _eye(eye: Eye) -> _Eye:
    _, height, width = eye.planes.values.shape
    field = _Field(*addresses(*eye.planes), width, height)
    K = eye.K
    made = _Eye(field, K[0, 0], K[0, 1], K[0, 2], K[1, 1], K[1, 2])
    made.rotation[:] = np.asarray(eye.rotation).ravel().tolist()
    made.translation[:] = np.asarray(eye.translation).tolist()
    return made


def _planes(height: int, width: int) -> Planes:
    return Planes(
        np.zeros((SECTORS, height, width), np.uint8), np.zeros(SECTORS, np.float32), np.zeros(SECTORS, np.float32)
    )
