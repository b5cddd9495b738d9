"""The C core's part that looks at photos along lines (profile.h), as functions of arrays."""

from __future__ import annotations

import ctypes as c
from dataclasses import dataclass
from functools import cache

import numpy as np

from cadcam.arrays import Array, Ids, Longs, Picture
from cadcam.errors import BadValue, NotEnoughMemory
from cadcam.native.core import addresses, doubles, functions

STEP_SUMS, STEP_ALL, STEP_TERMS = 39, 36, 9  # CC_STEP_SUMS, CC_STEP_ALL, CC_STEP_TERMS
BAND_BINS, BAND_KNOWN = 32, 3  # CC_BAND_BINS, CC_BAND_KNOWN
LENS, PULLED, MOST_STEPS = 12, 9, 16  # CC_LENS; motions of cc_pull; CC_MOST_STEPS
_ALONE = np.array([[-np.inf, 0.0], [np.inf, 0.0]])  # no twins


class _Picture(c.Structure):
    _fields_ = (("pixels", c.c_void_p), ("width", c.c_int32), ("height", c.c_int32))


@cache
def _core() -> c.CDLL:
    pointer, i64, i32, real, picture = c.c_void_p, c.c_int64, c.c_int32, c.c_double, c.POINTER(_Picture)
    return functions(
        "the fit to edges",
        {
            "cc_step_sums": (None, [picture, i64, *[pointer] * 5, *[real] * 4, pointer]),
            "cc_steps": (None, [i64, *[pointer] * 3]),
            "cc_step_residuals": (None, [picture, i64, *[pointer] * 5, *[real] * 3, pointer, i32, real, pointer]),
            "cc_band_gains": (i32, [i64, i32, real, real, *[pointer] * 5, i32, pointer, pointer]),
            "cc_candidates": (None, [picture, i64, pointer, pointer, real, i32, real, i32, pointer, pointer]),
            "cc_values_at": (None, [picture, i32, i64, pointer, pointer]),
            "cc_clearance": (i32, [i64, *[pointer] * 4, i64, *[pointer] * 3, *[real] * 3, *[pointer] * 4]),
            "cc_edge_rows": (None, [i64, *[pointer] * 6]),
            "cc_camera_rows": (None, [i64, pointer, pointer, real, *[pointer] * 7]),
            "cc_along_runs": (None, [i64, i32, pointer, pointer, i64, pointer]),
            "cc_pull": (None, [i64, i32, i32, *[pointer] * 5, *[real] * 3, i32, pointer]),
            "cc_met": (
                None,
                [i64, i32, pointer, pointer, i64, pointer, i64, pointer, *[real] * 3, pointer, pointer],
            ),
        },
    )


@dataclass(frozen=True, slots=True, eq=False)
class StepCells:
    """N cells on lines, in each of which a step of brightness across the line is fitted to the pixels.

    q, normal (N, 2): the middle of the stretch of line, px, and the unit normal there. below, above (N,): how far the
    cell reaches against and along the normal, px; half_length: how far along the line, both ways. blur: s of the step,
    px. twins (N, 2, 2): other lines that step in the cell, one below and one above, at d = twins[..., 0] +
    twins[..., 1] t for places t along the line, infinite where there is none; default none anywhere.
    """

    q: Array
    normal: Array
    below: Array
    above: Array
    half_length: float
    blur: float
    twins: Array | None = None

    def __len__(self) -> int:
        return len(self.q)

    def select(self, which: Longs, blur: float) -> StepCells:
        """Return the chosen cells, for steps of this blur."""
        twins = None if self.twins is None else self.twins[which]
        q, normal, below, above = (a[which] for a in (self.q, self.normal, self.below, self.above))
        return StepCells(q, normal, below, above, self.half_length, blur, twins)

    def doubles(self) -> list[Array]:
        """Return the arrays as the C core takes them: places, normals, reaches, twins."""
        twins = np.tile(_ALONE, (len(self), 1, 1)) if self.twins is None else self.twins
        return doubles(self.q, self.normal, self.below, self.above, twins)


def step_sums(gray: Picture, cells: StepCells, *, dark: float, bright: float) -> Array:
    """Return what the pixels of each cell add up to (n, STEP_SUMS): what `steps` takes (profile.h)."""
    gray, arrays = np.ascontiguousarray(gray, np.float32), cells.doubles()
    out = np.zeros((len(cells), STEP_SUMS))
    size, places = (cells.half_length, cells.blur), addresses(*arrays)
    _core().cc_step_sums(_picture(gray), len(out), *places, *size, dark, bright, out.ctypes.data)
    return out


def steps(sums: Array, held: Array) -> Array:
    """Return (n, 9) of each cell: c, g, slopes below and above, noise, Qcc, Qgg, pixels, share clipped (profile.h)."""
    sums, held = arrays = doubles(sums, held)
    out = np.zeros((len(sums), STEP_TERMS))
    _core().cc_steps(len(out), *addresses(*arrays, out))
    return out


def step_residuals(
    gray: Picture, cells: StepCells, sums: Array, *, bright: float, bins: int, width: float
) -> tuple[Array, Array, Array]:
    """Return what steps leave over of each cell's pixels: sums and numbers (n, bins), a pixel's variance (n,).

    Bins of `width` px lie around the line (profile.h). sums: those of the cells.
    """
    gray, arrays = np.ascontiguousarray(gray, np.float32), [*cells.doubles(), *doubles(sums)]
    out = np.zeros((len(cells), 2 * bins + 1))
    size, (*places, of) = (cells.half_length, cells.blur), addresses(*arrays)
    _core().cc_step_residuals(_picture(gray), len(out), *places, *size, bright, of, bins, width, out.ctypes.data)
    return out[:, :bins], out[:, bins : 2 * bins], out[:, -1]


def band_gains(
    rest: Array, number: Array, variance: Array, known: Array, room: Array, tried: Array, *, width: float, blur: float
) -> Array:
    """Return what steps at places tried (t,) beside lines explain (n, t) of what is left over (n, bins) (profile.h)."""
    rest, number, variance, known, room, tried = arrays = doubles(rest, number, variance, known, room, tried)
    if not (rest.shape[1] <= BAND_BINS and known.shape[1] == BAND_KNOWN):
        raise BadValue("bins and known steps of a stretch", (rest.shape, known.shape), f"{BAND_BINS}, {BAND_KNOWN}")
    gain = np.zeros((len(rest), len(tried)))
    *given, places, out = addresses(*arrays, gain)
    if not _core().cc_band_gains(*rest.shape, width, blur, *given, len(tried), places, out):
        raise NotEnoughMemory(f"there is not enough memory for {len(tried)} steps beside lines")
    return gain


def candidates(
    gray: Picture, q: Array, normal: Array, *, half_length: float, reach: int, least: float, most: int
) -> tuple[Array, Array]:
    """Return offset and slope (n, most) of the strongest slopes along the normals, nan where there are no more."""
    gray, arrays = np.ascontiguousarray(gray, np.float32), doubles(q, normal)
    offset, slope = np.zeros((len(arrays[0]), most)), np.zeros((len(arrays[0]), most))
    places = addresses(*arrays)
    _core().cc_candidates(
        _picture(gray), len(offset), *places, half_length, reach, least, most, *addresses(offset, slope)
    )
    return offset, slope


def values_at(picture: Picture, q: Array) -> Array:
    """Return values (..., C) of a picture (H, W, C) at q (..., 2) px, linear between pixels; nan outside of it."""
    picture, (places,) = np.ascontiguousarray(picture, np.float32), doubles(q)
    out = np.zeros((*places.shape[:-1], picture.shape[2]))
    _core().cc_values_at(_picture(picture), picture.shape[2], places.size // 2, *addresses(places, out))
    return out


def clearance(
    q: Array,
    normal: Array,
    run: Ids,
    arc: Array,
    segments: Array,
    segment_run: Ids,
    segment_arc: Array,
    *,
    half_length: float,
    near: float,
    most: float,
) -> tuple[Array, Array, Array, Array]:
    """Return how far (n,) px along -normal and +normal each sample is from the next other line, at most `most`.

    And the lines there that are twins (n, 2, 2), with how far (n, 2) px no line beyond them is (profile.h).
    """
    q, normal, arc, segments, segment_arc = doubles(q, normal, arc, segments, segment_arc)
    run, segment_run = np.ascontiguousarray(run, np.int32), np.ascontiguousarray(segment_run, np.int32)
    below, above = np.zeros(len(q)), np.zeros(len(q))
    twins, beyond = np.zeros((len(q), 2, 2)), np.zeros((len(q), 2))
    places, lines = addresses(q, normal, run, arc), addresses(segments, segment_run, segment_arc)
    out = addresses(below, above, twins, beyond)
    if not _core().cc_clearance(len(q), *places, len(segments), *lines, half_length, near, most, *out):
        raise NotEnoughMemory(f"there is not enough memory for the room beside lines of {len(segments)} segments")
    return below, above, twins, beyond


def edge_rows(jacobian: Array, rotation: Array, p: Array, tangent: Array) -> tuple[Array, Array]:
    """Return unit normals (n, 2) and rows (n, 6): how samples of lines move along them by a twist of the part.

    jacobian (n, 2, 3): dq/d(point in the camera's frame). rotation (3, 3): camera from part; p, tangent (n, 3).
    """
    arrays = doubles(jacobian, rotation, p, tangent)
    normal, row = np.zeros((len(p), 2)), np.zeros((len(p), 6))
    _core().cc_edge_rows(len(p), *addresses(*arrays, normal, row))
    return normal, row


def camera_rows(
    K: Array,
    rotation: Array,
    translation: Array,
    p: Array,
    tangent: Array,
    *,
    lens: Array | None = None,
    radius: float = np.inf,
) -> tuple[Array, Array, Array]:
    """Return pixels (n, 2), unit normals (n, 2) and rows (n, 6), as `edge_rows`; nan behind the camera.

    lens: twelve coefficients by Brown and Conrady in OpenCV's order, none for a pinhole; nan too from `radius` on.
    """
    arrays, told = doubles(K, rotation, translation, p, tangent), doubles(*([] if lens is None else [lens]))
    if lens is not None and told[0].shape != (LENS,):
        raise BadValue("coefficients of a lens", lens, f"{LENS} numbers")
    q, normal, row = np.zeros((len(p), 2)), np.zeros((len(p), 2)), np.zeros((len(p), 6))
    at, coefficients = addresses(*arrays, q, normal, row), addresses(*told) if told else [None]
    _core().cc_camera_rows(len(p), at[0], *coefficients, radius, *at[1:])
    return q, normal, row


def along_runs(values: Array, run: Ids, neighbours: int) -> Array:
    """Return the means (n, ...) of values and of up to so many neighbours on each side that are on the same run (n,).

    What is not finite does not count; 0 where nothing does.
    """
    (values,), run = doubles(values), np.ascontiguousarray(run, np.int32)
    out = np.zeros(values.shape)
    wide = out.size // max(len(out), 1)
    _core().cc_along_runs(len(out), wide, *addresses(values, run), neighbours, out.ctypes.data)
    return out


def pulled(
    rows: Array,
    offset: Array,
    strength: Array,
    *,
    soft: float,
    nothing: float,
    held: float,
    pulls: int,
    stiff: tuple[Array, Array] | None = None,
) -> Array:
    """Return the step (k,) by which lines with rows (n, k) are pulled onto steps `offset` (n, m) px off (profile.h).

    stiff: weights (k, k) that hold before (k,) + step near zero, and `before`.
    """
    rows, offset, strength = arrays = doubles(rows, offset, strength)
    if not rows.shape[1] <= PULLED:
        raise BadValue("motions of lines that are pulled", rows.shape[1], f"at most {PULLED}")
    prior = doubles(*(stiff or ()))
    x = np.zeros(rows.shape[1])
    weights = addresses(*prior) if prior else [None, None]
    _core().cc_pull(*offset.shape, len(x), *addresses(*arrays), *weights, soft, nothing, held, pulls, x.ctypes.data)
    return x


def met(offset: Array, slope: Array, first: Longs, moved: Array, *, on: float, faint: float, around: float) -> Array:
    """Return the share (tries, lines) of each line's samples that meet a step of one sign, moved (tries, n) px.

    offset, slope (n, m): the steps of each sample, nan for none; those weaker than `faint` times another within
    `around` px do not count. first (lines,): the first sample of each line. A step within `on` px is met.
    """
    tries = len(moved)
    offset, slope, moved = doubles(offset, slope, moved.T)
    if not offset.shape[1] <= MOST_STEPS:
        raise BadValue("steps of a sample that may be met", offset.shape[1], f"at most {MOST_STEPS}")
    first = np.ascontiguousarray(first, np.int64)
    scratch, share = np.zeros(4 * tries), np.zeros((tries, len(first)))
    steps, lines, limits = addresses(offset, slope), (len(first), first.ctypes.data), (on, faint, around)
    _core().cc_met(*offset.shape, *steps, *lines, tries, moved.ctypes.data, *limits, *addresses(scratch, share))
    return share


def _picture(gray: Picture) -> object:
    """Return a reference to the picture; `gray` must outlive the call."""
    return c.byref(_Picture(gray.ctypes.data, gray.shape[1], gray.shape[0]))
