"""The gate for arguments that are no arrays: one error that says what was given, what is asked for, and the way there.

Types are for editors and type checkers; a script meets its mistakes when it runs. Public functions pass what they are
given through here first, so that a mesh in place of a part is not found out by the inner loop that it breaks.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sized
from dataclasses import fields
from functools import cache
from typing import TYPE_CHECKING, Any, SupportsFloat, TypeVar, cast

from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_Value = TypeVar("_Value")
_Key = TypeVar("_Key")

# an annotation of a flag, of one number or of several: "bool", "float", "int | None", "tuple[float, float]"
_NUMBERS = re.compile(
    r"(?:(?P<one>bool|float|int)|tuple\[(?P<several>(?:float|int)(?:, (?:float|int))*)\])(?P<none> \| None)?"
)

# (given, wanted): how to come from the one to the other; a path is a "str", any array, list or tuple a "list"
_WAYS: Mapping[tuple[str, str], str] = {
    ("BoardCalibration", "Camera"): "its .estimate.camera, or .estimate.view(0) with its covariance",
    ("BoardCalibration", "CameraEstimate"): "its .estimate.view(0)",
    ("BoardPicture", "Observations"): "cadcam.board_views(pictures, camera), or its .observations",
    ("Camera", "Viewpoint"): "cadcam.Viewpoint.exact(name, camera, camera_from_world, sigma_px=...)",
    ("BoardCalibration", "JointFit"): "its .fit",
    ("CameraEstimate", "Camera"): "its .camera",
    ("CameraEstimate", "Rigid"): "its .camera_from_world",
    ("CameraEstimate", "Viewpoint"): "cadcam.Viewpoint.fixed(name, estimate)",
    ("CameraFile", "Camera"): "its .camera, or .calibrated with its covariance",
    ("CameraFile", "CameraEstimate"): "its .estimate",
    ("CameraFile", "Rigid"): "its .camera_from_world",
    ("CameraFile", "Viewpoint"): "cadcam.Viewpoint.fixed(name, its .estimate)",
    ("HandEyeEstimate", "Rigid"): "its .flange_from_camera or .base_from_camera",
    ("JointEstimate", "Camera"): "its .camera, or .view(0) with its covariance",
    ("JointEstimate", "JointFit"): "what cadcam.fit_jointly returns",
    ("Layout", "CandidateSurvey"): "its .survey",
    ("JointEstimate", "CameraEstimate"): "its .view(0)",
    ("Location", "PoseEstimate"): "its .pose",
    ("Location", "Rigid"): "its .pose.world_from_part",
    ("Mesh", "Part"): "cadcam.Part.of(mesh)",
    ("Mesh", "Scene"): "cadcam.Scene.of(mesh)",
    ("Observations", "Observations"): "a list of them: [points]",
    ("Part", "Mesh"): "its .scene.mesh",
    ("Part", "Scene"): "its .scene",
    ("Photo", "Viewpoint"): "its .viewpoint",
    ("PoseEstimate", "Rigid"): "its .world_from_part",
    ("RigBoards", "RigEstimate"): "its .estimate",
    ("RigEstimate", "Camera"): "one of its .cameras",
    ("Scene", "Mesh"): "its .mesh",
    ("Scene", "Part"): "cadcam.Part(scene)",
    ("Verification", "Record"): "cadcam.record_of(found, cadcam.VerificationOrigin(part))",
    ("Verification", "Location"): "its .located",
    ("View", "Wireframe"): "cadcam.visible_wireframe(scene, camera, camera_from_world)",
    ("Viewpoint", "Camera"): "its .camera",
    ("Camera", "RigCamera"): "cadcam.RigCamera(views, known=camera)",
    ("float", "Reach"): "such as cadcam.Reach(shift_px=60)",
    ("int", "Reach"): "such as cadcam.Reach(shift_px=60)",
    ("dict", "EdgeOptions"): "cadcam.EdgeOptions(search_px=...)",
    ("list", "Mapping"): "by name: {'left': ..., 'right': ...}",
    ("list", "Camera"): "cadcam.Camera(size, K, lens) or cadcam.Camera.from_opencv(size, K, coefficients)",
    ("list", "Lens"): "such as cadcam.BrownConrady(k1, k2, p1, p2); OpenCV's by cadcam.Camera.from_opencv",
    ("list", "Observations"): "cadcam.Observations(p_world, q)",
    ("list", "Photo"): "cadcam.Photo.of(picture, camera)",
    ("list", "Record"): "one by one: store.add(*records)",
    ("list", "Rigid"): "cadcam.Rigid.from_matrix(matrix) in mm; of several motions cadcam.Rigid.stack(motions)",
    ("list", "View"): "what a renderer's .render returns",
    ("int", "Generator"): "numpy.random.default_rng(seed)",
    ("str", "BoardPicture"): "cadcam.find_board(path, pattern)",
    ("str", "Camera"): "cadcam.read_camera(path).camera",
    ("str", "Lens"): "such as cadcam.BrownConrady()",
    ("str", "LayoutScene"): "cadcam.read_layout_scene(path)",
    ("str", "Light"): "cadcam.named_light(name)",
    ("str", "SensorFormat"): "cadcam.sensor_format(name)",
    ("str", "VerificationOrigin"): "cadcam.VerificationOrigin(part)",
    ("str", "datetime"): "datetime.fromisoformat(text), with its zone",
    ("str", "Look"): "cadcam.named_look(name)",
    ("str", "Mesh"): "cadcam.read_model(path)",
    ("str", "Observations"): "cadcam.read_points(path)",
    ("str", "Part"): "cadcam.Part.of(cadcam.read_model(path))",
    ("str", "Pattern"): "cadcam.parse_pattern(text)",
    ("str", "Mark"): "cadcam.parse_mark(text)",
    ("str", "Photo"): "cadcam.Photo.of(cadcam.read_camera_picture(path), camera)",
    ("str", "Rigid"): "cadcam.read_pose(path)",
    ("str", "Scene"): "cadcam.Scene.of(cadcam.read_model(path))",
    ("str", "Tolerances"): "cadcam.read_tolerances(path)",
    ("OnPlane", "ViewRange"): "cadcam.ViewRange(on=...)",
    ("str", "ViewRange"): "such as cadcam.ViewRange.above()",
    ("type", "Lens"): "an instance, such as cadcam.BrownConrady()",
}


class FrozenMap(Mapping[_Key, _Value]):
    """A read-only copy of a mapping that, unlike `MappingProxyType`, travels to other processes and has a hash."""

    __slots__ = ("_of",)

    def __init__(self, of: Mapping[_Key, _Value] | Iterable[tuple[_Key, _Value]] = ()) -> None:
        self._of = dict(of)

    def __getitem__(self, key: _Key) -> _Value:
        return self._of[key]

    def __iter__(self) -> Iterator[_Key]:
        return iter(self._of)

    def __len__(self) -> int:
        return len(self._of)

    def __hash__(self) -> int:
        return hash(frozenset(self._of.items()))

    def __repr__(self) -> str:
        return repr(self._of)


def expect(value: object, what: str, *kinds: type, optional: bool = False) -> None:
    """Raise `BadValue` naming `what` unless value is of one of these classes; None passes where it is optional."""
    if isinstance(value, kinds) or (optional and value is None):
        return
    raise BadValue(what, said(value), _expected(value, kinds))


def expect_callable(value: object, what: str, *, optional: bool = False) -> None:
    """Raise `BadValue` naming `what` unless value can be called; None passes where it is optional."""
    if not (callable(value) or (optional and value is None)):
        raise BadValue(what, said(value), "a function")


def expect_number(value: object, what: str, expected: str = "a number") -> None:
    """Raise `BadValue` naming `what` unless value is one real number: Python's or numpy's; NaN and inf pass.

    An integer beyond the range of float64 is refused, and a Decimal or a Fraction: no arithmetic on them and floats
    would be possible.
    """
    if isinstance(value, float):
        return
    if not isinstance(value, int):  # at once: to ask for a protocol takes fifty times as long
        real = isinstance(value, SupportsFloat) and not isinstance(value, (str, complex))
        if not real or getattr(value, "shape", None) != ():
            way = ": float() of it" if real and not hasattr(value, "shape") else ""
            raise BadValue(what, said(value), expected + way)
    try:
        float(value)  # type: ignore[arg-type]  # it is a number, or an array () of anything
    except OverflowError as error:
        raise BadValue(what, "an integer of more than 308 digits", expected) from error
    except (TypeError, ValueError) as error:
        raise BadValue(what, said(value), expected) from error


def expect_positive(value: object, what: str, expected: str = "a positive number", *, zero: bool = False) -> None:
    """Raise `BadValue` naming `what` and what is expected unless value is one finite number above 0.

    zero: 0 passes, too.
    """
    expect_number(value, what, expected)
    number = float(value)  # type: ignore[arg-type]  # it is a number
    if not (math.isfinite(number) and (number > 0 or (zero and number == 0))):
        raise BadValue(what, value, expected)


def expect_count(value: object, what: str, *, least: int = 1, most: int | None = None, expected: str = "") -> None:
    """Raise `BadValue` naming `what` unless value is one whole number, of any type, from `least` to `most`."""
    expected = expected or f"a whole number {f'of at least {least}' if most is None else f'from {least} to {most}'}"
    expect_number(value, what, expected)
    number = float(value)  # type: ignore[arg-type]  # it is a number
    if not (number.is_integer() and least <= number <= (math.inf if most is None else most)):
        raise BadValue(what, value, expected)


def expect_flag(value: object, what: str) -> None:
    """Raise `BadValue` naming `what` unless value is True or False, of Python or numpy, or 1 or 0."""
    single = isinstance(value, int) or getattr(value, "shape", None) == ()
    if not (single and value in (0, 1)):
        raise BadValue(what, said(value), "True or False")


def expect_numbers(value: DataclassInstance) -> None:
    """Raise `BadValue` naming the first field of a dataclass that is annotated as numbers and does not hold them.

    Of fields `bool`, `float`, `int` (a whole number) and `tuple[float, float]` and the like, and of those `| None`; the
    others are not looked at. It tells kinds, not sizes: NaN and inf pass.
    """
    for name, one, several, optional in _annotated(type(value)):
        given = getattr(value, name)
        if given is None and optional:
            continue
        if one:
            _expect_number_of(given, name, one)
            continue
        if isinstance(given, str) or not hasattr(given, "__getitem__") or _length(given) != len(several):
            raise BadValue(name, said(given), f"{len(several)} numbers")
        for i, kind in enumerate(several):
            _expect_number_of(given[i], f"{name}[{i}]", kind)


@cache
def _annotated(kind: type[DataclassInstance]) -> tuple[tuple[str, str, tuple[str, ...], bool], ...]:
    """Return of each field annotated as numbers its name, its kind or those of a tuple, and whether None is one."""
    told = ((f.name, _NUMBERS.fullmatch(str(f.type))) for f in fields(kind))
    return tuple(
        (name, t["one"] or "", tuple(filter(None, (t["several"] or "").split(", "))), bool(t["none"]))
        for name, t in told
        if t
    )


def _expect_number_of(value: object, what: str, kind: str) -> None:
    if kind == "bool":
        expect_flag(value, what)
        return
    expect_number(value, what)
    if kind == "int" and not float(value).is_integer():  # type: ignore[arg-type]  # it is a number
        raise BadValue(what, value, "a whole number")


def _length(value: object) -> int:
    """Return the length of what has one; -1 for mappings, arrays () and what has none."""
    if not isinstance(value, Sized) or isinstance(value, Mapping) or getattr(value, "shape", None) == ():
        return -1
    return len(value)


def expect_names(values: Iterable[str], what: str) -> tuple[str, ...]:
    """Return names as a tuple; raise `BadValue` for one text in place of several, whose letters are no names."""
    if isinstance(values, str):
        raise BadValue(what, said(values), f"a list of names: [{values!r}]")
    return expect_each(values, what, str)


def expect_several(values: object, what: str, *kinds: type) -> None:
    """Raise `BadValue` naming `what` for one value in place of several, or what is no list, iterator or the like.

    What comes out of it is not looked at, so that it may be made as it is asked for.
    """
    single = isinstance(values, (*kinds, str, Mapping)) or getattr(values, "shape", None) == ()
    if single or not isinstance(values, Iterable):
        wanted = _names(kinds)
        one = isinstance(values, kinds)
        raise BadValue(what, said(values), f"a list of them: [{what}]" if one else f"a list, each {wanted}")


def expect_each(values: Iterable[_Value], what: str, *kinds: type) -> tuple[_Value, ...]:
    """Return the values as a tuple; raise `BadValue` naming the first that is of none of these classes.

    One value in place of several is refused, too.
    """
    expect_several(values, what, *kinds)
    several = tuple(values)
    for i, value in enumerate(several):
        expect(value, f"{what}[{i}]", *kinds)
    return several


def expect_by_name(values: object, what: str, *kinds: type) -> None:
    """Raise `BadValue` naming the first entry of a mapping whose key is no text, or whose value is of no such class."""
    expect(values, what, Mapping)
    for name, value in cast("Mapping[object, object]", values).items():
        expect(name, f"a name in {what}", str)
        expect(value, f"{what}[{name!r}]", *kinds)


def expect_known(name: object, kind: str, known: Collection[str]) -> None:
    """Raise `UnknownName`, suggesting the nearest, unless name is one of those known; no text is a `BadValue`."""
    expect(name, kind, str)
    if name not in known:
        raise UnknownName(kind, str(name), known)


def expect_path(path: object, what: str = "path") -> None:
    """Raise `BadValue` naming `what` unless it is the name of a file or folder: a str or a pathlib.Path."""
    if not isinstance(path, (str, os.PathLike)):
        raise BadValue(what, said(path), "the name of a file, a str or a pathlib.Path")
    if "\0" in str(path):
        raise BadValue(what, said(path), "a name without NUL, which no system takes")


def said(value: Any) -> str:
    """Return what a value is, in words: its class, of arrays the shape, of lists the length, of small things itself."""
    if value is None or isinstance(value, (bool, int, float, complex)):
        return repr(value)
    if isinstance(value, (str, os.PathLike)):
        return f"the text {str(value)[:60]!r}" if isinstance(value, str) else f"the path {str(value)[:60]!r}"
    if isinstance(value, type):
        return f"the class {value.__name__}"
    name = type(value).__name__
    if hasattr(value, "shape"):
        return f"an array of shape {tuple(value.shape)}"
    if isinstance(value, (list, tuple, dict, set)):
        return f"a {name} of {len(value)}"
    return _with_article(name)


def _expected(value: object, kinds: tuple[type, ...]) -> str:
    given = type(value).__name__
    if isinstance(value, (str, os.PathLike)):
        given = "str"
    elif isinstance(value, type):
        given = "type"
    elif isinstance(value, (list, tuple)) or hasattr(value, "shape"):
        given = "list"
    way = next((_WAYS[given, k.__name__] for k in kinds if (given, k.__name__) in _WAYS), "")
    return _names(kinds) + (f": {way}" if way else "")


def _names(kinds: tuple[type, ...]) -> str:
    return " or ".join(_with_article(k.__name__) for k in kinds)


def _with_article(name: str) -> str:
    return f"an {name}" if name[:1].upper() in "AEIO" else f"a {name}"
