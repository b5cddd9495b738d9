"""Array aliases and the one gate through which arrays enter a value type: checked, copied, read-only."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from typing import Any, NoReturn, TypeAlias

import numpy as np
import numpy.typing as npt

from cadcam.errors import BadValue

Array: TypeAlias = npt.NDArray[np.float64]  # geometry
Picture: TypeAlias = npt.NDArray[np.float32]  # images in [0, 1], depth in mm
Ids: TypeAlias = npt.NDArray[np.int32]  # faces, parts
Longs: TypeAlias = npt.NDArray[np.int64]  # places in arrays, and what is counted with them
Mask: TypeAlias = npt.NDArray[np.bool_]
Index: TypeAlias = npt.NDArray[np.integer[Any]] | Mask  # what selects from an array
Floats: TypeAlias = npt.ArrayLike

LARGEST = 1e30  # of a number in a file: float32 holds it, and the eighth power of it, as products of squares have, fits

_HUGE = 1e100  # of a number in an array: its square and its cube fit float64

_TOLD, _WIDTH = 6, 160  # numbers of an array, or things of a list, and characters that a repr still tells


def frozen(
    values: npt.ArrayLike,
    what: str,
    shape: tuple[int | None, ...],
    dtype: npt.DTypeLike = np.float64,
    *,
    batched: bool = False,
    finite: bool = True,
) -> npt.NDArray[Any]:
    """Return a read-only copy of `values` whose trailing axes have `shape` (None = any length).

    With `batched`, leading axes are free; otherwise the number of axes must be that of `shape`. Raises `BadValue`
    naming `what`, the first offending index and its value; also for numbers whose squares and cubes overflow, and where
    a whole number is asked for and another given, or one that `dtype` does not hold.
    """
    try:
        given = np.asarray(values)
        if given.dtype.kind == "c":  # numpy would drop the imaginary parts
            raise BadValue(what, "complex", f"real numbers of shape {_text(shape, batched)}")
        if np.ma.is_masked(values):  # numpy would give what is under the mask
            raise BadValue(what, "masked in places", "every number: leave out what is masked")
        if given.dtype == dtype:
            array = np.array(given)
        else:
            with np.errstate(over="ignore"):  # what float32 does not hold becomes inf, and is refused as that
                array = np.array(given, dtype=dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise BadValue(what, repr(values)[:80], f"numbers of shape {_text(shape)}") from error
    tail = array.shape[array.ndim - len(shape) :] if array.ndim >= len(shape) else ()
    fits = len(tail) == len(shape) and all(n is None or n == m for n, m in zip(shape, tail, strict=True))
    if not fits or (not batched and array.ndim != len(shape)):
        raise BadValue(what, f"of shape {array.shape}", f"shape {_text(shape, batched)}")
    if finite and array.dtype.kind == "f" and not _usable(array):
        if not np.isfinite(array).all():
            _refuse(what, array, ~np.isfinite(array), "a finite number")
        _refuse(what, array, np.abs(array) > _HUGE, f"a number of at most {_HUGE:g} in size")
    if array.dtype.kind in "iu" and not np.can_cast(given.dtype, array.dtype) and (array != given).any():
        span = np.iinfo(array.dtype)
        _refuse(what, given, array != given, f"a whole number from {span.min} to {span.max}")
    array.setflags(write=False)
    return array


class Locked:
    """What keeps the read-only arrays of a frozen dataclass so in pickles and copies, where numpy drops the flag."""

    __slots__ = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        for name, method in (("__getstate__", _state_of), ("__setstate__", _restore)):  # before dataclass adds its own
            if name not in cls.__dict__:
                setattr(cls, name, method)


def _state_of(self: Any) -> tuple[list[Any], list[bool]]:
    """Return the values of a dataclass' fields, and which of them are read-only arrays."""
    values = [getattr(self, f.name) for f in fields(self)]
    return values, [isinstance(v, np.ndarray) and not v.flags.writeable for v in values]


def _restore(self: Any, state: tuple[list[Any], list[bool]]) -> None:
    for f, value, locked in zip(fields(self), *state, strict=True):
        if locked:
            value.setflags(write=False)
        object.__setattr__(self, f.name, value)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Brief(Locked):
    """What makes a dataclass's repr fit a terminal: small numbers as they are, arrays by shape, lists by length.

    For `@dataclass(repr=False)`; a field with `repr=False` is left out.
    """

    def __repr__(self) -> str:
        told = (f"{f.name}={brief(getattr(self, f.name))}" for f in fields(self) if f.repr)
        return f"{type(self).__name__}({', '.join(told)})"


def brief(value: object) -> str:
    """Return a value's repr, or what it is where that is long: arrays of more than six numbers, lists, other values."""
    if isinstance(value, np.ndarray):
        small = value.size <= _TOLD and value.ndim <= 1
        return np.array2string(value, precision=4, separator=", ") if small else f"{value.shape} {value.dtype}"
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if isinstance(value, (tuple, list)) and (len(value) > _TOLD or len(repr(value)) > _WIDTH):
        return f"{len(value)} of {type(value[0]).__name__}"
    if isinstance(value, Mapping):
        told = ", ".join(f"{key!r}: {brief(one)}" for key, one in value.items())
        few = len(value) <= _TOLD and len(told) <= _WIDTH
        return f"{{{told}}}" if few else f"{len(value)} of {type(next(iter(value.values()))).__name__}"
    told = repr(value)
    if len(told) <= _WIDTH:
        return told
    return f"{told[:_WIDTH]}...'" if isinstance(value, str) else f"{type(value).__name__}(...)"


def significant(value: float, digits: int = 2) -> str:
    """Return a number with so many digits that count, never as a power of ten: 0.00012, 3.1, 110."""
    return np.format_float_positional(value, precision=digits, fractional=False, trim="-")


def component_major(points: tuple[int, ...], *components: int) -> Array:
    """Return zeros (*points, *components) laid out so that one component of all points is a run of memory.

    Arithmetic on components, `J[..., 0, 1] = ...`, then goes at the speed of memory; results keep the layout.
    """
    first, axes = len(components), len(components) + len(points)
    return np.zeros((*components, *points)).transpose(*range(first, axes), *range(first))


def in_parts(function: Callable[[Array], Array], x: Array, *, at_once: int = 8192) -> Array:
    """Return function(x) of points x (..., n) -> (..., m), worked out part by part.

    What comes up on the way stays in the processor's cache, component by component (`component_major`), and a search
    ends in each part when that is done.
    """
    points = x.reshape(-1, x.shape[-1])
    if len(points) <= at_once:
        return function(x)
    parts = []
    for first in range(0, len(points), at_once):
        part = points[first : first + at_once]
        runs = component_major(part.shape[:1], part.shape[1])
        runs[...] = part
        parts.append(function(runs))
    return np.concatenate(parts).reshape(*x.shape[:-1], -1)


def quantile(values: npt.NDArray[np.floating[Any]], share: float) -> float:
    """Return the value (between two, linearly) that this share of some numbers lies below: one selection, no sorting.

    What np.quantile returns of numbers without NaN, ten times as fast on the short arrays of inner loops.
    """
    flat = values.ravel()
    place = share * (len(flat) - 1)
    k = int(place)
    parted = np.partition(flat, k)
    low = float(parted[k])
    return low if place == k else low + (place - k) * (float(parted[k + 1 :].min()) - low)


def _usable(array: npt.NDArray[np.floating[Any]]) -> bool:
    """Return whether all numbers are finite, and none is huge; without another array, for some fill the memory."""
    flat = array.ravel(order="K")
    if float(np.vdot(flat, flat)) < _HUGE:  # almost always, and in a third of the time; never of NaN or inf
        return True
    most = _HUGE if array.dtype.itemsize >= 8 else float(np.finfo(array.dtype).max)
    return not array.size or bool(array.max() <= most and array.min() >= -most)


def _refuse(what: str, values: npt.NDArray[Any], bad: Mask, expected: str) -> NoReturn:
    """Raise `BadValue` for the first bad value, naming its index."""
    index = tuple(int(i) for i in np.argwhere(bad)[0])
    raise BadValue(f"{what}{list(index) if index else ''}", values[index], expected)


def _text(shape: tuple[int | None, ...], batched: bool = False) -> str:
    names = ["..."] * batched + ["N" if n is None else str(n) for n in shape]
    return f"({', '.join(names)})"
