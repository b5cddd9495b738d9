"""Every error a caller can cause: what was wrong, where, the value found, and the way out.

The command line prints the message of a `CadcamError` without a traceback and exits with 2; anything else that
escapes is a bug of ours.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from os import PathLike
from typing import Any

_LISTED = 40  # names that a message still tells one by one


class CadcamError(Exception):
    """Something the caller can put right; the message says how."""

    def __reduce__(self) -> tuple[Any, ...]:
        """Return what pickle needs to hand the error, as it is, to another process."""
        return _again, (type(self), self.args, self.__dict__)


def listed(texts: Sequence[str], most: int, *, by: str = ", ") -> str:
    """Return at most so many texts joined by ", " or "; ", and how many more there are, for messages."""
    more = f"{by.rstrip(', ')} and {len(texts) - most} more" if len(texts) > most else ""
    return by.join(texts[:most]) + more


def _again(kind: type[CadcamError], words: tuple[Any, ...], known: dict[str, Any]) -> CadcamError:
    error = kind.__new__(kind, *words)
    error.__dict__.update(known)
    return error


class BadValue(CadcamError):
    """An argument is out of its range, has the wrong shape, or is not finite."""

    def __init__(self, what: str, value: object, expected: str) -> None:
        super().__init__(f"{what} is {value}; expected {expected}")
        self.what: str = what
        self.value: object = value
        self.expected: str = expected


class UnusablePhoto(BadValue):
    """There is no photo to look at, or one without contrast, of black and white pixels, or that is another again."""


class UnreadableFile(CadcamError):
    """A file is missing, truncated, empty or not what its name says."""

    def __init__(self, path: str | PathLike[str], reason: str, remedy: str = "") -> None:
        super().__init__(f"{path}: {reason}" + (f"; {remedy}" if remedy else ""))
        self.path: str | PathLike[str] = path
        self.reason: str = reason
        self.remedy: str = remedy


class UnwritableFile(CadcamError):
    """A file cannot be written where it was asked for."""

    def __init__(self, path: str | PathLike[str], reason: str, remedy: str = "") -> None:
        super().__init__(f"{path}: cannot be written: {reason}" + (f"; {remedy}" if remedy else ""))
        self.path: str | PathLike[str] = path
        self.reason: str = reason
        self.remedy: str = remedy


class UnknownName(CadcamError):
    """A name (unit, renderer, parameter, format ...) is not one of those known; the nearest is suggested."""

    def __init__(self, kind: str, name: str, known: Iterable[str]) -> None:
        names, name = sorted(known), str(name)
        name = name if len(name) <= 80 else f"{name[:77]}..."
        near = [n for n in names if n.casefold() == name.casefold()] or get_close_matches(name, names, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        super().__init__(f"unknown {kind} {name!r}{hint} (known: {listed(names, _LISTED) or 'none'})")
        self.kind: str = kind
        self.name: str = name
        self.known: tuple[str, ...] = tuple(names)


class TooFewPoints(CadcamError):
    """Fewer observations than unknowns; of: what is too few, where it is not points; why: where the others went."""

    def __init__(self, task: str, have: int, need: int, *, of: str = "points", why: str = "") -> None:
        message = f"{task} needs at least {need} {of if need > 1 else of.removesuffix('s')}; {have} given"
        super().__init__(message + (f": {why}" if why else ""))
        self.task: str = task
        self.have: int = have
        self.need: int = need
        self.of: str = of
        self.why: str = why


class DegenerateGeometry(CadcamError):
    """The points cannot determine what was asked, whatever their accuracy; the message carries the numbers."""


class DegenerateMotions(DegenerateGeometry):
    """A robot's motions leave open where its camera sits: the directions stand in the message, and here.

    slides: unit directions in the flange's axes; turns: twists (three of translation in mm, three of rotation in rad).
    """

    def __init__(
        self, message: str, slides: tuple[tuple[float, ...], ...], turns: tuple[tuple[float, ...], ...]
    ) -> None:
        super().__init__(message)
        self.slides: tuple[tuple[float, ...], ...] = slides
        self.turns: tuple[tuple[float, ...], ...] = turns


class MirroredPoints(DegenerateGeometry):
    """The points only fit a camera that sees them from behind: a left-handed frame or swapped image axes."""


class InconsistentPoses(CadcamError):
    """A robot's poses and what its camera saw cannot both be right: order, direction, unit or single poses."""


class NotConverged(CadcamError):
    """An iteration stopped before its minimum; the message says where it stood."""


class InconsistentViews(CadcamError):
    """What several cameras saw does not fit together, and fits well once one input is read another way: named."""


class SizeMismatch(CadcamError):
    """A picture's size is not the camera's; the usual remedy is another camera file, or to convert this one."""

    def __init__(self, what: str, size: tuple[int, int], expected: tuple[int, int], remedy: str = "") -> None:
        said = f"{what} is {size[0]} x {size[1]} px but the camera is {expected[0]} x {expected[1]} px"
        super().__init__(f"{said}; {remedy or _for_size(size, expected)}")
        self.size: tuple[int, int] = size
        self.expected: tuple[int, int] = expected


def _for_size(size: tuple[int, int], expected: tuple[int, int]) -> str:
    """Return what to do about a picture of another size than expected."""
    if size == expected[::-1]:
        return "the photo is turned by 90 degrees: turn it back, or correct its EXIF orientation"
    (w, h), (width, height) = size, expected
    whole, ways = f"{w}x{h}", []
    by = round(width / w), round(height / h)
    if min(by) >= 1 and max(by) >= 2 and size == (width // by[0], height // by[1]):
        binned = f"{by[0]}" if by[0] == by[1] else f"{by[0]}x{by[1]}"
        ways.append(f"--binning {binned} if its pixels were taken together")
    if min(abs(w * height / width - h), abs(h * width / height - w)) < 1:  # but for rounding
        ways.append(f"--resize {whole} if it was scaled")
    if w <= width and h <= height:
        ways.append(f"--crop X,Y,{whole} if it was cut out")
    other = "give the camera that took it"
    return f"{other}, or convert this one: cadcam convert CAMERA NEW {', or '.join(ways)}" if ways else other


class NoOrder(CadcamError):
    """Marks in a picture fit their plan in no order better than chance does; the message says how near the best came.

    explained: how many marks the best order has; chance: how many orders as good are to be expected by chance.
    """

    def __init__(self, message: str, explained: int, chance: float) -> None:
        super().__init__(message)
        self.explained: int = explained
        self.chance: float = chance


class NothingInView(CadcamError):
    """The model lies wholly behind the camera or outside its picture."""


class UnseenFeatures(CadcamError):
    """Features that have to be measured are seen by no candidate camera; names: which."""

    def __init__(self, message: str, names: tuple[str, ...]) -> None:
        super().__init__(message)
        self.names: tuple[str, ...] = names


class NoBoard(CadcamError):
    """A picture does not show the calibration board that was asked for.

    seen: (columns, rows) of the grid that it shows instead, None where it shows none.
    """

    def __init__(self, board: str, reason: str, seen: tuple[int, int] | None = None) -> None:
        super().__init__(f"no {board} found: {reason}")
        self.board: str = board
        self.reason: str = reason
        self.seen: tuple[int, int] | None = seen


class TooFewMarks(CadcamError):
    """A picture shows fewer marks than were asked for."""

    def __init__(self, mark: str, found: int, expected: int) -> None:
        seen = "none was" if found == 0 else f"only {found} {'was' if found == 1 else 'were'}"
        super().__init__(f"{seen} found of {expected} marks {mark}; give their radius, another method or a lower score")
        self.mark: str = mark
        self.found: int = found
        self.expected: int = expected


class MissingOpenGL(CadcamError):
    """OpenGL does not answer: no EGL library, no device, too old, or a driver that fails."""

    REMEDY = (
        "install a graphics driver with EGL (Debian and Ubuntu: apt install libegl1 libgl1), or name its libraries in "
        "CADCAM_LIBEGL and CADCAM_LIBGL"
    )

    def __init__(self, why: str) -> None:
        super().__init__(f"the renderer 'gl' is not available: {why}; use the renderer 'auto', or {self.REMEDY}")
        self.why: str = why


class MissingExtra(CadcamError):
    """A feature needs an optional package that is not installed: that of an extra, or by itself."""

    def __init__(self, feature: str, extra: str, package: str) -> None:
        super().__init__(f'{feature} needs an optional package: pip install "cadcam[{extra}]", or {package} by itself')
        self.feature: str = feature
        self.extra: str = extra
        self.package: str = package


class MissingCore(CadcamError):
    """The compiled core is not there, which all work on pictures and parts needs but the ray and OpenGL renderers."""

    def __init__(
        self, why: str, what: str = "the raster renderer", instead: str = "use the renderer 'ray', or reinstall"
    ) -> None:
        super().__init__(
            f"{what} is not available: {why}; {instead} cadcam where a C compiler (CC, cc, gcc, clang) or a network to "
            "fetch one (the ziglang wheel) is at hand"
        )
        self.why: str = why


class NotEnoughMemory(CadcamError):
    """Something would not fit into memory; said before it is tried."""


class WorkerDied(CadcamError):
    """A process that works for this one died again and again over the same piece of work."""


class UnreachableCluster(CadcamError):
    """A cluster does not answer at its address, or has nobody to work."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(
            f"no work can be done at {address!r}: {reason}; give the address that the cluster's scheduler prints, "
            "such as tcp://10.0.0.1:8786"
        )
        self.address: str = address
        self.reason: str = reason


class UnusableStore(CadcamError):
    """A store of product state cannot be opened, read or written; a password in its address is not repeated."""

    def __init__(self, where: str, reason: str, remedy: str = "") -> None:
        super().__init__(f"store {where}: {reason}" + (f"; {remedy}" if remedy else ""))
        self.where: str = where
        self.reason: str = reason
        self.remedy: str = remedy
