"""Load a CAD file of any known format: a `Mesh` in mm, mended, with a report of how it was read."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from difflib import get_close_matches
from os import PathLike
from pathlib import Path

import numpy as np

from cadcam.arrays import significant
from cadcam.cad.formats.collada import read_collada
from cadcam.cad.formats.gltf import read_gltf
from cadcam.cad.formats.model import Model
from cadcam.cad.formats.obj import read_obj
from cadcam.cad.formats.off import read_off
from cadcam.cad.formats.ply import read_ply
from cadcam.cad.formats.step import read_iges, read_step
from cadcam.cad.formats.stl import read_stl
from cadcam.cad.formats.threemf import read_3mf
from cadcam.cad.mend import Repairs, mend
from cadcam.cad.mesh import Mesh
from cadcam.cad.units import MM, unit_name
from cadcam.errors import BadValue, DegenerateGeometry, UnreadableFile
from cadcam.kinds import expect_path, expect_positive

_READERS: dict[str, Callable[[Path, bytes], Model]] = {
    ".stl": read_stl,
    ".obj": read_obj,
    ".ply": read_ply,
    ".off": read_off,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".3mf": read_3mf,
    ".dae": read_collada,
}
_BREP_READERS = {".step": read_step, ".stp": read_step, ".iges": read_iges, ".igs": read_iges}
SUFFIXES = tuple(sorted({*_READERS, *_BREP_READERS}))

_SMALL_MM, _LARGE_MM = 1.0, 100_000.0  # outside these limits a mistaken unit is likelier than such a part
_LARGE_GLTF_MM = 10_000.0  # beyond this, a part written in mm against the rule of glTF is likelier than one so large
_ABSURD_MM = 1e12


@dataclass(frozen=True, slots=True)
class LoadReport:
    """How a file was read, and what it holds.

    `unit` is the unit of length its numbers were read in and `unit_source` where that comes from ("argument", "file",
    "format" or "assumed"); `size_mm` the extent along x, y, z; `sha256` of the bytes read; `repairs` made by mending;
    `warnings` sentences for the user.
    """

    path: str
    sha256: str
    unit: str
    unit_source: str
    size_mm: tuple[float, float, float]
    n_parts: int
    n_faces: int
    n_vertices: int
    repairs: Repairs
    warnings: tuple[str, ...]

    def lines(self) -> list[str]:
        """Return the report as lines of text, the size first."""
        name = Path(self.path).name
        return [
            f"{name}: size {_size(self.size_mm)} (unit {self.unit}: {_SOURCE[self.unit_source]})",
            f"{name}: {self.n_parts} part{'s' * (self.n_parts != 1)}, {self.n_faces} triangles",
            *(f"{name}: {line}" for line in self.repairs.lines()),
            *(f"{name}: warning: {line}" for line in self.warnings),
        ]


_SOURCE = {
    "argument": "as given",
    "file": "named in the file",
    "format": "by the rule of the format",
    "assumed": "assumed, the format has none",
}


def read_model(
    path: str | PathLike[str], *, unit: str | None = None, chordal_tolerance_mm: float | None = None
) -> Mesh:
    """Return the mesh of a CAD file in mm: welded, without empty or repeated faces, wound outwards, parts named.

    Formats by suffix: STL, OBJ, PLY, OFF (no unit: `unit` decides, mm if not given), GLB/glTF (metres by the
    specification; `unit` overrides it, as many writers ignore it), 3MF, COLLADA, STEP (the file names its
    unit; another is refused), IGES. STEP and IGES need the extra "step"; `chordal_tolerance_mm` bounds the distance of
    their triangles from the true surface (default: 5e-5 of the size). Raises `UnreadableFile`, `DegenerateGeometry`
    when no face has an area, `UnknownName` for a unit, `BadValue` for a unit against the file's own or a tolerance of
    given triangles, `MissingExtra`.
    """
    return read_model_with_report(path, unit=unit, chordal_tolerance_mm=chordal_tolerance_mm)[0]


def read_model_with_report(
    path: str | PathLike[str], *, unit: str | None = None, chordal_tolerance_mm: float | None = None
) -> tuple[Mesh, LoadReport]:
    """Return what `read_model` returns, and the report of it."""
    expect_path(path)
    wanted = None if unit is None else unit_name(unit)
    if chordal_tolerance_mm is not None:
        expect_positive(chordal_tolerance_mm, "chordal_tolerance_mm", "a positive length in mm")
    path = Path(path)
    data = _bytes(path)
    suffix = path.suffix.lower()
    if suffix in _BREP_READERS:
        model = _BREP_READERS[suffix](path, data, chordal_tolerance_mm=chordal_tolerance_mm)
    elif chordal_tolerance_mm is None:
        model = _READERS[suffix](path, data)
    else:
        raise BadValue(f"tolerance for {path.name}", f"{chordal_tolerance_mm:g} mm", "none: its triangles are given")
    name, source = _unit(path, model, wanted)
    mesh, repairs = _mended(path, model.mesh.scaled(model.unit_mm or MM[name]))
    report = LoadReport(
        path=str(path),
        sha256=hashlib.sha256(data).hexdigest(),
        unit=name,
        unit_source=source,
        size_mm=(float(mesh.size_mm[0]), float(mesh.size_mm[1]), float(mesh.size_mm[2])),
        n_parts=len(mesh.part_names),
        n_faces=mesh.n_faces,
        n_vertices=len(mesh.vertices),
        repairs=repairs,
        warnings=(*model.notes, *_doubts(mesh, model, name, source), *_torn(mesh, repairs)),
    )
    return mesh, report


def describe(mesh: Mesh) -> str:
    """Return one line: size in mm, number of parts and triangles."""
    n = len(mesh.part_names)
    return f"size {_size(mesh.size_mm)}, {n} part{'s' * (n != 1)}, {mesh.n_faces} triangles"


def _size(size: np.typing.ArrayLike) -> str:
    return " x ".join(f"{x:.1f}" if x >= 10 else f"{x:.4g}" for x in np.asarray(size, float)) + " mm"


def _bytes(path: Path) -> bytes:
    """Return the content of a file that can be a CAD file by its name."""
    try:
        _refuse_missing(path)
        _refuse_unknown(path)
        data = path.read_bytes()
    except OSError as error:
        raise UnreadableFile(path, f"cannot be read ({error.strerror})", "check its name and permissions") from None
    if not data.strip(b" \t\r\n\0"):
        raise UnreadableFile(path, f"is empty ({len(data)} bytes)", "export the model again")
    return data


def _refuse_missing(path: Path) -> None:
    if path.is_dir():
        raise UnreadableFile(path, "is a folder", "name a file in it")
    try:
        path.stat()  # not exists(): from Python 3.14 on a name too long, say, is to that a file that does not exist
    except (FileNotFoundError, NotADirectoryError):
        others = [p.name for p in path.parent.iterdir()] if path.parent.is_dir() else []
        near = get_close_matches(path.name, others, n=1)
        raise UnreadableFile(
            path, "does not exist", f"did you mean {near[0]!r}?" if near else "check the name"
        ) from None


def _refuse_unknown(path: Path) -> None:
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES:
        near = get_close_matches(suffix, SUFFIXES, n=1, cutoff=0.7) if suffix else []
        hint = f"did you mean {near[0]}? " if near else ""
        what = f"has the suffix {suffix!r}, which no CAD reader knows" if suffix else "has no suffix to tell its format"
        raise UnreadableFile(path, what, f"{hint}known: {', '.join(SUFFIXES)}")


def _unit(path: Path, model: Model, wanted: str | None) -> tuple[str, str]:
    """Return the unit of the model's numbers and where it comes from."""
    if model.unit is not None and model.declared:
        if wanted is not None and wanted != model.unit:
            raise BadValue(f"unit for {path.name}", wanted, f"{model.unit}, which the file names itself; leave it out")
        return model.unit, "file"
    if wanted is not None:
        return wanted, "argument"
    return (model.unit, "format") if model.unit is not None else ("mm", "assumed")


def _mended(path: Path, mesh: Mesh) -> tuple[Mesh, Repairs]:
    largest = float(np.abs(mesh.vertices).max())
    if largest > _ABSURD_MM:
        raise UnreadableFile(path, f"has a coordinate of {largest:.3g} mm", "check the unit and the file")
    try:
        return mend(mesh)
    except DegenerateGeometry as error:
        raise DegenerateGeometry(f"{path}: {error}; export a model with surfaces") from None


def _torn(mesh: Mesh, repairs: Repairs) -> list[str]:
    """Return what is to be said of a mesh most of whose sides are open: lines that the part does not have."""
    if 2 * repairs.open_edges <= 3 * mesh.n_faces:
        return []
    what = f"its triangles do not meet: {repairs.open_edges} of {3 * mesh.n_faces} sides are open"
    return [f"{what}, and each would be looked for as a line of the part; export it with shared or exact vertices"]


def _doubts(mesh: Mesh, model: Model, unit: str, source: str) -> list[str]:
    """Return what the user should check."""
    doubts = []
    largest = float(mesh.size_mm.max())
    often_mm = source == "format" and unit == "m" and largest > _LARGE_GLTF_MM
    if often_mm or not _SMALL_MM <= largest <= _LARGE_MM:
        doubts.append(f"the model is {_length(largest)} large: is the unit right? {_remedy(largest, unit, source)}")
    if source == "argument" and model.unit is not None and model.unit != unit:
        doubts.append(f"the format is in {model.unit} by its rule; read in {unit} as asked")
    return doubts


def _remedy(largest: float, unit: str, source: str) -> str:
    """Return what to do if a model of a doubtful size was read in another unit than it was written in."""
    if source == "file":
        return f"its file says {unit}; export it again if not"
    for other in ("mm", "m", "in", "um"):  # the likeliest first
        size = largest / MM[unit] * MM[other]
        if other != unit and _SMALL_MM <= size <= _LARGE_MM:
            right = "" if source == "argument" or not _SMALL_MM <= largest <= _LARGE_MM else f", --unit {unit} if it is"
            return f"pass --unit {other} if it is {_length(size)}{right}"
    return "check the scale of its export"


def _length(mm: float) -> str:
    return f"{significant(mm, 4)} mm" if mm < 1000 else f"{significant(mm / 1000, 4)} m"
