"""Semantic PMI of a STEP file: which tolerances its drawing states, and of which faces.

AP242 (ISO 10303-242; the entities are those of ISO 10303-47) as the CAx-IF's "Recommended practices for the
representation and presentation of PMI (AP242)", version 4.0, asks for. Graphic PMI, lines to look at, is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from os import PathLike
from pathlib import Path
from typing import Any, TypeVar

from cadcam.cad.formats.step_unit import declared_unit, length_unit_mm
from cadcam.cad.pmi.exchange import Entity, Enumerated, Exchange, Parameters, Ref
from cadcam.cad.pmi.faces import Curve, StepFace, curve_of, face_of
from cadcam.cad.pmi.fits import fit_limits_mm
from cadcam.cad.pmi.placements import Placements
from cadcam.cad.pmi.stated import Pmi, Stated, StatedDatum, StatedSize, StatedTolerance
from cadcam.errors import CadcamError, UnreadableFile
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect_path

_ABOUT = (b"_TOLERANCE", b"DIMENSIONAL_", b"ANGULAR_")  # what the file has if it has any
_CHARACTERISTICS = tuple(
    f"{name}_TOLERANCE"
    for name in (
        "ANGULARITY", "CIRCULAR_RUNOUT", "COAXIALITY", "CONCENTRICITY", "CYLINDRICITY", "FLATNESS", "LINE_PROFILE",
        "PARALLELISM", "PERPENDICULARITY", "POSITION", "ROUNDNESS", "STRAIGHTNESS", "SURFACE_PROFILE", "SYMMETRY",
        "TOTAL_RUNOUT",
    )
)  # fmt: skip
_SIZES = ("DIMENSIONAL_SIZE", "DIMENSIONAL_SIZE_WITH_DATUM_FEATURE", "DIMENSIONAL_SIZE_WITH_PATH")
_DISTANCES = ("DIMENSIONAL_LOCATION", "DIRECTED_DIMENSIONAL_LOCATION", "DIMENSIONAL_LOCATION_WITH_PATH")
_ANGLES = ("ANGULAR_SIZE", "ANGULAR_LOCATION")
_DEEPEST = 8  # groups of groups of faces
_FURTHER = 1 << 40  # between the numbers of faces of one occurrence of a component and those of the next
_MALFORMED = (CadcamError, ArithmeticError, AttributeError, LookupError, TypeError, ValueError)
_S = TypeVar("_S", bound=Stated)


def read_pmi(path: str | PathLike[str]) -> Pmi:
    """Return the tolerances that a STEP file states of its faces, in mm; none where it has no semantic PMI.

    What is stated of a component of an assembly is stated of each of its occurrences, at its place there. From the
    second occurrence on, of this component or another one, the letters of its datums have its number: A.2, B.2.
    A statement that cannot be understood is told among `others`, with why, and does not hide the rest. Raises
    `UnreadableFile` where the file cannot be read.
    """
    expect_path(path)
    try:
        data = Path(path).read_bytes()
    except OSError as error:
        raise UnreadableFile(path, f"cannot be read ({error.strerror})", "check its name and permissions") from None
    if not any(word in data for word in _ABOUT):
        return Pmi()
    return _Reader(Exchange(path, data), data).pmi()


class _Reader:
    """The statements of a file, and which faces each is about."""

    def __init__(self, file: Exchange, data: bytes) -> None:
        self.file, self.data, self.mm = file, data, declared_unit(data).mm
        self.others: list[str] = []
        self.items: dict[int, list[Ref]] = {}  # what an aspect of the shape is, directly
        self.within: dict[int, list[Ref]] = {}  # aspects of which it is made
        self.established: dict[int, list[Ref]] = {}  # features of a datum
        self.zones: dict[int, str] = {}  # form of a tolerance's zone
        self.ranges: dict[int, Ref] = {}  # limits of a dimension
        self.values: dict[int, list[Ref]] = {}  # its representations
        self.placements = Placements(file, self.mm)
        self.occurrences: dict[int, list[tuple[int, Rigid]]] = {}  # of each component: number, and place

    def pmi(self) -> Pmi:
        """Return all that is stated."""
        self._index()
        tolerances = tuple(self._each(_CHARACTERISTICS, self._tolerance))
        sizes = tuple(self._each((*_SIZES, *_DISTANCES), self._size))
        datums = tuple(self._each(("DATUM",), self._datum))
        self.others += self._each(_ANGLES, lambda *_: ["angle"])
        return Pmi(tolerances, sizes, datums, tuple(self.others))

    def _each(self, keywords: tuple[str, ...], read: Callable[[int, Entity], Iterable[Any]]) -> list[Any]:
        """Return what is read of each entity; those that cannot be are told."""
        out: list[Any] = []
        for number in self.file.having(*keywords):
            try:
                out += read(number, self.file[number])
            except _MALFORMED as error:
                why = error.reason if isinstance(error, UnreadableFile) else "it is not written as AP242 asks for"
                self.others.append(f"#{number}: {why}")
        return out

    def _index(self) -> None:
        """Note what refers to what, in the direction that is asked."""
        for aspect, items in self._parameters("GEOMETRIC_ITEM_SPECIFIC_USAGE", self._identified):
            self.items.setdefault(aspect, []).extend(items)
        for aspect, items in self._parameters("ITEM_IDENTIFIED_REPRESENTATION_USAGE", self._identified):
            self.items.setdefault(aspect, []).extend(items)
        for keyword in ("SHAPE_ASPECT_RELATIONSHIP", "SHAPE_ASPECT_DERIVING_RELATIONSHIP"):
            for of, to, datum in self._parameters(keyword, lambda p: (p[2], p[3], "DATUM" in self.file[p[3]])):
                if datum:
                    self.established.setdefault(to, []).append(of)
                else:
                    self.within.setdefault(of, []).append(to)
        for form, tolerances in self._parameters("TOLERANCE_ZONE", lambda p: (self._form(p[-1]), list(p[-2]))):
            self.zones |= dict.fromkeys(tolerances, form)
        self.ranges = {d: limits for limits, d in self._parameters("PLUS_MINUS_TOLERANCE", lambda p: (p[0], p[1]))}
        for dimension, representation in self._parameters(
            "DIMENSIONAL_CHARACTERISTIC_REPRESENTATION", lambda p: (p[0], p[1])
        ):
            self.values.setdefault(dimension, []).append(representation)

    def _parameters(self, keyword: str, read: Callable[[Parameters], Any]) -> Iterator[Any]:
        """Yield what is read of the parameters of each entity of a kind; what is malformed refers to nothing."""
        for number in self.file.having(keyword):
            try:
                found = read(self.file[number][keyword])
            except _MALFORMED:
                continue
            yield found

    def _identified(self, parameters: Parameters) -> tuple[Ref, list[Ref]]:
        """Return an aspect of the shape, and which faces or edges it is."""
        _, _, aspect, _, item = parameters[:5]
        if isinstance(item, tuple):  # SET_REPRESENTATION_ITEM((#1, #2))
            item = item[1][0]
        return aspect, list(item) if isinstance(item, list) else [item]

    def _form(self, zone: Ref) -> str:
        return str(self.file[zone]["TOLERANCE_ZONE_FORM"][0])

    def _faces(self, aspect: Ref) -> tuple[tuple[StepFace, ...], tuple[Curve, ...]]:
        """Return the faces of an aspect of the shape, and the edges that it names by themselves."""
        faces: dict[int, StepFace] = {}
        curves: dict[int, Curve] = {}
        waiting, done = [(aspect, 0)], set()
        while waiting:
            at, deep = waiting.pop(0)
            if at in done or deep > _DEEPEST:
                continue
            done.add(at)
            for item in self.items.get(at, ()):
                if (face := face_of(self.file, item, self.mm)) is not None:
                    faces[item] = face
                elif (curve := curve_of(self.file, item, self.mm)) is not None:
                    curves[item] = curve
            waiting += [(one, deep + 1) for one in self.within.get(at, ())]
        return tuple(faces.values()), tuple(curves.values())

    def _placed(self, aspect: Ref, stated: _S) -> list[_S]:
        """Return what is stated of an aspect of a component's shape for each of its occurrences."""
        try:
            shape = next(p[2] for p in self.file[aspect].values() if len(p) > 3)
            component = int(self.file[shape]["PRODUCT_DEFINITION_SHAPE"][2])
        except (*_MALFORMED, StopIteration):
            return [stated]
        if component not in self.occurrences:
            before = sum(map(len, self.occurrences.values()))
            self.occurrences[component] = list(enumerate(self.placements.of(component), before))
        return [_at(stated, *occurrence) for occurrence in self.occurrences[component]]

    def _tolerance(self, number: int, entity: Entity) -> list[StatedTolerance]:
        keyword = next(k for k in entity if k in _CHARACTERISTICS)
        name, _, magnitude, aspect = (entity.get("GEOMETRIC_TOLERANCE") or entity[keyword])[:4]
        if "DIMENSIONAL_SIZE" in self.file[aspect]:  # a tolerance beside a dimension
            aspect = self.file[aspect]["DIMENSIONAL_SIZE"][0]
        systems = entity.get("GEOMETRIC_TOLERANCE_WITH_DATUM_REFERENCE", [[]])[0] or (entity[keyword][4:5] or [[]])[0]
        modifiers = entity.get("GEOMETRIC_TOLERANCE_WITH_MODIFIERS", [[]])[0]
        displaced = entity.get("UNEQUALLY_DISPOSED_GEOMETRIC_TOLERANCE")
        stated = StatedTolerance(
            _named(name),
            *self._faces(aspect),
            keyword.removesuffix("_TOLERANCE").lower().replace("_", " "),
            self._length(magnitude),
            self.zones.get(number, "").startswith("cylindrical"),
            tuple(letter for system in systems for letter in self._letters(system)),
            tuple(m.lower().replace("_", " ") for m in modifiers if isinstance(m, Enumerated)),
            self._length(displaced[0]) if displaced else None,
        )
        return self._placed(aspect, stated)

    def _letters(self, system: Ref) -> Iterator[str]:
        """Yield the letters of a datum system, or of one datum reference, in their order."""
        entity = self.file[system]
        if "DATUM_SYSTEM" in entity:
            for compartment in entity["DATUM_SYSTEM"][4]:
                yield self._letter(self.file[compartment]["DATUM_REFERENCE_COMPARTMENT"][4])
        else:
            yield self._letter(entity["DATUM_REFERENCE"][1])

    def _letter(self, base: Any) -> str:
        """Return the letter of a datum, or the letters of a common one: A-B."""
        if isinstance(base, Ref):
            return _named(self.file[base]["DATUM"][4])
        elements = base[1][0] if isinstance(base, tuple) else base  # COMMON_DATUM_LIST((#1, #2))
        return "-".join(self._letter(self.file[one]["DATUM_REFERENCE_ELEMENT"][4]) for one in elements)

    def _datum(self, number: int, entity: Entity) -> list[StatedDatum]:
        found = [self._faces(feature) for feature in (number, *self.established.get(number, ()))]
        faces = tuple(face for some, _ in found for face in some)
        curves = tuple(curve for _, some in found for curve in some)
        stated = StatedDatum(_named(entity["DATUM"][0]), faces, curves, _named(entity["DATUM"][4]))
        return self._placed(Ref(number), stated)

    def _size(self, number: int, entity: Entity) -> list[StatedSize]:
        nominal, limits, fit = self._limits(number)
        keyword = next(k for k in (*_SIZES, *_DISTANCES) if k in entity)
        if keyword in _DISTANCES:
            kind, _, of, to = entity[keyword][:4]
            other = Stated("", *self._faces(to))
            stated = StatedSize("", *self._faces(of), _named(kind) or "distance", nominal, limits, fit, other)
            return self._placed(of, stated)
        of = entity[keyword][-2:] if keyword.endswith("DATUM_FEATURE") else entity[keyword][:2]
        stated = StatedSize("", *self._faces(of[0]), _named(of[1]) or "size", nominal, limits, fit)
        return self._placed(of[0], stated)

    def _limits(self, dimension: int) -> tuple[float | None, tuple[float, float] | None, str]:
        """Return a dimension's nominal value, its limits, mm, and its class of tolerance."""
        known: dict[str, float] = {}
        for representation in self.values.get(dimension, ()):
            for item in self.file[representation]["SHAPE_DIMENSION_REPRESENTATION"][1]:
                measure = self.file[item].get("REPRESENTATION_ITEM") or [""]
                if "MEASURE_WITH_UNIT" in self.file[item] or "LENGTH_MEASURE_WITH_UNIT" in self.file[item]:
                    known[str(measure[0] or "nominal value")] = self._length(item)
        nominal = known.get("nominal value")
        if {"upper limit", "lower limit"} <= known.keys():
            return nominal, (known["lower limit"], known["upper limit"]), ""
        if dimension not in self.ranges:
            return nominal, None, ""
        stated = self.file[self.ranges[dimension]]
        if "LIMITS_AND_FITS" in stated:
            form, _, grade = stated["LIMITS_AND_FITS"][:3]
            fit = f"{_named(form)}{_named(grade)}"
            return nominal, None if nominal is None else fit_limits_mm(fit, nominal), fit
        low, high = (self._length(bound) for bound in stated["TOLERANCE_VALUE"])
        return nominal, None if nominal is None else (nominal + low, nominal + high), ""

    def _length(self, measure: Ref) -> float:
        """Return a length with its unit, in mm."""
        entity = self.file[measure]
        value, unit = entity.get("MEASURE_WITH_UNIT") or entity["LENGTH_MEASURE_WITH_UNIT"]
        mm = length_unit_mm(self.data, unit)
        if mm is None:
            raise UnreadableFile(self.file.path, f"#{int(measure)} is no length")
        return float(value[1][0]) * mm


def _at(stated: _S, k: int, pose: Rigid) -> _S:
    """Return what is stated for the occurrence k of a component."""
    further = k * _FURTHER
    faces = tuple(face.moved(pose, further) for face in stated.faces)
    placed = replace(stated, faces=faces, curves=tuple(c.moved(pose, c.number + further) for c in stated.curves))
    if isinstance(placed, StatedTolerance):
        return replace(placed, datums=tuple(_lettered(letter, k) for letter in placed.datums))
    if isinstance(placed, StatedSize):
        return replace(placed, other=None if placed.other is None else _at(placed.other, k, pose))
    return replace(placed, letter=_lettered(placed.letter, k)) if isinstance(placed, StatedDatum) else placed


def _lettered(letter: str, k: int) -> str:
    """Return the letter of a datum, or those of a common one, of the occurrence k of a component."""
    return "-".join(f"{one}.{k + 1}" for one in letter.split("-")) if k else letter


def _named(value: Any) -> str:
    """Return a name in one line that can be printed; "" where there is none."""
    return "".join(c for c in " ".join(str(value or "").split()) if c.isprintable())
