"""All formats: recognising a file, reading any, writing any with a report of what is lost."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import TypeVar

import numpy as np

from cadcam.cad.units import MM, unit_name
from cadcam.camera.camera import Camera, checked_size
from cadcam.camera.difference import largest_difference
from cadcam.errors import BadValue, CadcamError, UnreadableFile
from cadcam.files.foreign.losses import prepared, refuse
from cadcam.files.foreign.model import ConversionLoss, Foreign, Format, NamedCamera, WriteOptions
from cadcam.files.foreign.source import ForeignFile
from cadcam.geometry.rigid import Rigid, expect_motion
from cadcam.kinds import expect, expect_flag, expect_known, expect_names, expect_path, expect_positive
from cadcam.whole import write_whole

# name: module and the format in it; in the order in which a file is tested for them
_HOME = {
    "cadcam": ("own", "FORMAT"),
    "metashape": ("metashape", "FORMAT"),
    "visp": ("visp", "FORMAT"),
    "ros": ("ros", "FORMAT"),
    "kalibr": ("kalibr", "FORMAT"),
    "opencv": ("opencv", "FORMAT"),
    "mrcal": ("mrcal", "FORMAT"),
    "halcon": ("halcon", "FORMAT"),
    "blender": ("blender", "FORMAT"),
    "nerfstudio": ("nerfstudio", "FORMAT"),
    "bop": ("bop", "FORMAT"),
    "gltf": ("gltf", "FORMAT"),
    "usd": ("usd", "FORMAT"),
    "colmap": ("colmap", "TEXT"),
    "colmap-bin": ("colmap", "BINARY"),
}
NAMES = tuple(_HOME)
_SUFFIX = {
    ".json": "cadcam",
    ".cameramodel": "mrcal",
    ".dat": "halcon",
    ".cal": "halcon",
    ".py": "blender",
    ".gltf": "gltf",
    ".usda": "usd",
}

_WRONG_PX = 1e-6  # far above rounding, far below anything visible: more is a bug of ours, and nothing is written

T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Written:
    """The result of writing: the files, what the format could not hold, and the error when read back, px.

    read_back_px is relative to the camera after its losses: rounding, or a bug.
    """

    format: str
    paths: tuple[str, ...]
    losses: tuple[ConversionLoss, ...]
    notes: tuple[str, ...]
    read_back_px: float


def format_named(name: str) -> Format:
    """Return a format by its name; raises `UnknownName`."""
    expect_known(name, "camera format", NAMES)
    module, attribute = _HOME[name]
    found: Format = getattr(import_module(f"cadcam.files.foreign.{module}"), attribute)
    return found


def format_of(source: ForeignFile) -> Format:
    """Return the format recognised from a file's content; `UnreadableFile` if none matches."""
    if not source.is_folder and not source.data():
        raise UnreadableFile(source.path, "is empty", "copy it again from its source")
    for name in NAMES:
        form = format_named(name)
        if _guarded(source.path, partial(form.recognises, source)):
            return form
    what = "a folder without a known camera file" if source.is_folder else "no camera file known by its content"
    raise UnreadableFile(source.path, f"is {what}", f"name its format: --from {', '.join(NAMES)} (format_name=)")


def format_for(path: str | os.PathLike[str]) -> Format:
    """Return the format that a new file's suffix alone decides; `BadValue` where several share it."""
    suffix = Path(path).suffix.lower()
    if suffix not in _SUFFIX:
        raise BadValue("format of " + repr(os.fspath(path)), "not said", f"--to {', '.join(NAMES)} (format_name=)")
    return format_named(_SUFFIX[suffix])


def read_cameras(
    path: str | os.PathLike[str],
    *,
    format_name: str | None = None,
    size: tuple[int, int] | None = None,
    unit: str | None = None,
) -> Foreign:
    """Return the cameras of a file or folder of any known format, in our conventions.

    format_name: one of `NAMES`, else recognised from the content. size: the picture's, for formats that have none.
    unit: of the file's lengths where its format has none; mm by default, with a note. Raises `UnreadableFile`.
    """
    expect_path(path)
    if size is not None:
        size = checked_size(size)
    source = ForeignFile(os.fspath(path), size=size, mm=_mm(unit))
    _refuse_missing(source)
    form = format_of(source) if format_name is None else format_named(format_name)
    _refuse_unit(form, unit)
    found = _read(form, source)
    if size is not None and any(named.camera.size != size for named in found.cameras):
        raise BadValue("size", size, f"none, or that in the file: {found.cameras[0].camera.size}")
    posed = any(named.camera_from_world is not None for named in found.cameras)
    if form.unit is None and unit is None and posed:
        note = f"lengths are taken as mm: {form.title} has no unit of its own (say it with --unit, or unit=)"
        return replace(found, notes=(*found.notes, note))
    return found


def write_cameras(
    path: str | os.PathLike[str],
    cameras: Camera | NamedCamera | Foreign,
    *,
    format_name: str | None = None,
    camera_from_world: Rigid | None = None,
    unit: str | None = None,
    pixel_mm: float | None = None,
    allow_loss: Collection[str] = (),
    fit: bool = False,
) -> Written:
    """Write a camera, or all contents of a file, in the named format, else the one that the suffix determines.

    Nothing is dropped silently: `Written.losses` lists it, and what moves pixels (lens, skew, aspect, principal-point)
    is refused with `RefusedLoss` unless it is named in allow_loss ("all": any). fit: a lens that the format cannot hold
    is replaced by the nearest that it can, and its largest error in px is reported. unit: of the lengths written, where
    the format has none of its own (mm). pixel_mm: the pixel pitch, where the format requires a sensor in mm. The files
    are read back before they are written to disk.
    """
    expect_path(path)
    allow_loss = expect_names(allow_loss, "allow_loss")
    expect(cameras, "cameras", Camera, NamedCamera, Foreign)
    expect_motion(camera_from_world, "camera_from_world", optional=True)
    expect_flag(fit, "fit")
    if pixel_mm is not None:
        expect_positive(pixel_mm, "pixel_mm", "a positive pitch in mm")
    form = format_for(path) if format_name is None else format_named(format_name)
    _refuse_unit(form, unit)
    target = WriteOptions(os.fspath(path), _mm(unit), None if pixel_mm is None else float(pixel_mm))  # numpy's, too
    named = _as_named(cameras, camera_from_world)
    chosen, notes = _chosen(named, form)
    with np.errstate(all="ignore"):
        pairs = [prepared(one, form, fit=fit) for one in chosen]
    losses = list(dict.fromkeys(loss for _, found in pairs for loss in found))
    losses += _pose_losses(chosen, form)
    refuse(losses, allow_loss, form.title, can_fit=not fit)
    ready = [one for one, _ in pairs]
    files = form.write(ready, target)
    back = _read(form, ForeignFile(target.name, size=ready[0].camera.size, mm=target.mm, memory=files)).cameras
    px = max(largest_difference(meant.camera, found.camera) for meant, found in zip(ready, back, strict=True))
    if not (px < _WRONG_PX and _poses_agree(ready, back, form)):
        raise RuntimeError(f"{form.title} of {ready[0].camera} reads back {px:.3g} px off, or elsewhere")
    losses += _renamed(ready, back)
    paths = tuple(_path_of(target.name, form, name) for name in files)
    for name, out in zip(files, paths, strict=True):
        write_whole(out, files[name])
    return Written(form.name, paths, tuple(losses), tuple(notes), px)


def _refuse_unit(form: Format, unit: str | None) -> None:
    """Refuse another unit than that of a format which has one."""
    if unit is not None and form.unit is not None and unit_name(unit) != form.unit:
        raise BadValue("unit", unit, f"none: {form.title} is in {form.unit} by its rules")


def _mm(unit: str | None) -> float:
    return MM[unit_name(unit)] if unit is not None else 1.0


def _as_named(cameras: Camera | NamedCamera | Foreign, pose: Rigid | None) -> list[NamedCamera]:
    if isinstance(cameras, Camera):
        return [NamedCamera("camera", cameras, pose)]
    if pose is not None:
        raise BadValue("camera_from_world", "given beside named cameras", "none: they have their own")
    return [cameras] if isinstance(cameras, NamedCamera) else list(cameras.cameras)


def _chosen(named: list[NamedCamera], form: Format) -> tuple[list[NamedCamera], list[str]]:
    """Return what a format for one camera can hold of several: the camera itself where all are the same."""
    if not named:
        raise BadValue("cameras", "none", "at least one")
    if form.holds.several or len(named) == 1:
        return named, []
    if form.holds.pose == "no" and all(one.camera is named[0].camera for one in named):
        return [NamedCamera("camera", named[0].camera)], [
            f"the one camera of {len(named)} poses is written, without them"
        ]
    names = ", ".join(one.name for one in named[:8]) + (", ..." if len(named) > 8 else "")
    alike = "; all have the same K and lens, and differ in their poses" if _alike(named) else ""
    given = f"{len(named)}, and one is what a file of this format ({form.title}) holds"
    raise BadValue("number of cameras", given, f"one: choose it with --camera-name NAME ({names}){alike}")


def _alike(named: list[NamedCamera]) -> bool:
    first = named[0].camera
    return all(largest_difference(one.camera, first) == 0 for one in named if one.camera is not first)


def _pose_losses(named: list[NamedCamera], form: Format) -> list[ConversionLoss]:
    first = named[0].camera_from_world
    if form.holds.pose != "relative" or first is None or np.array_equal(first.matrix, np.eye(4)):
        return []
    return [
        ConversionLoss(
            "pose", "only where the cameras stand among each other is kept: the world becomes the first camera"
        )
    ]


def _path_of(path: str, form: Format, name: str) -> str:
    if form.folder:
        return os.fspath(Path(path) / name)
    return os.fspath(Path(path).parent / name) if name else path


def _poses_agree(meant: Sequence[NamedCamera], found: Sequence[NamedCamera], form: Format) -> bool:
    if form.holds.pose != "yes":
        return True
    pairs = [(a.camera_from_world, b.camera_from_world) for a, b in zip(meant, found, strict=True)]
    return all(a is None or (b is not None and np.allclose(a.matrix, b.matrix, rtol=1e-9, atol=1e-6)) for a, b in pairs)


def _renamed(meant: Sequence[NamedCamera], found: Sequence[NamedCamera]) -> list[ConversionLoss]:
    """Return the loss of names, which matters only for several cameras."""
    pairs = [f"{a.name} is now {b.name}" for a, b in zip(meant, found, strict=True) if a.name != b.name]
    return (
        [ConversionLoss("names", ", ".join(pairs[:6]) + (", ..." if len(pairs) > 6 else ""))]
        if len(meant) > 1 and pairs
        else []
    )


def _read(form: Format, source: ForeignFile) -> Foreign:
    return _guarded(source.path, lambda: form.read(source))


def _guarded(path: str, job: Callable[[], T]) -> T:
    """Run a reader: invalid values become an error that names the file."""
    try:
        with np.errstate(all="ignore"):
            return job()
    except UnreadableFile:
        raise
    except CadcamError as error:
        raise UnreadableFile(path, f"is refused: {error}") from error
    except (OverflowError, RecursionError) as error:
        raise UnreadableFile(path, f"holds an impossible value ({error})", "is it the right file?") from None


def _refuse_missing(source: ForeignFile) -> None:
    try:
        missing = not Path(source.path).exists()
    except (OSError, ValueError) as error:
        raise UnreadableFile(source.path, getattr(error, "strerror", None) or str(error)) from None
    if missing:
        raise UnreadableFile(source.path, "no such file", "check the path")
