"""STEP and IGES through Open CASCADE (optional package cascadio): every B-rep face keeps its number and normals.

The conversion runs in a process of its own: Open CASCADE prints to standard output, and a bad file may crash it.
"""

from __future__ import annotations

import math
import re
import subprocess
import sys
import tempfile
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from cadcam.cad.formats.gltf import GltfDocument, Shape, collected
from cadcam.cad.formats.model import Model
from cadcam.cad.formats.step_unit import LengthUnit, declared_unit
from cadcam.cad.units import MM
from cadcam.errors import MissingExtra, UnreadableFile
from cadcam.kinds import expect_positive

# A part whose diagonal fills 2000 pixels then has a chordal error of 0.1 pixel.
CHORD_SHARE = 5e-5
ANGLE = 0.2  # rad between neighbouring facets of a curved surface at most

_METRE = MM["m"]
# what exporters call the occurrences of products that nobody gave a name: NAUO12, or Open CASCADE for them: 12
_COUNTED = re.compile(r"(NAUO|next assembly (usage|relationship)\W*)?\d*\s*", re.IGNORECASE)
_AGAIN = "export it again, as AP214 or AP242"


def read_step(path: Path, data: bytes, *, chordal_tolerance_mm: float | None = None) -> Model:
    """Return the faces of the solids of a STEP file as triangles in metres; every face is a surface of its own.

    Wires and points (drawing notes in AP203) are ignored, and so are loose surfaces beside a solid in the same product
    (datum planes of notes); a product of surfaces only keeps them. `chordal_tolerance_mm` bounds the distance between
    triangles and surface; by default `CHORD_SHARE` of the diagonal of the file's points. Raises `MissingExtra` without
    cascadio.
    """
    if data[:13].lstrip()[:12] != b"ISO-10303-21" and b"ISO-10303-21" not in data[:1000]:
        raise UnreadableFile(path, "does not begin with ISO-10303-21: not a STEP file", "check the suffix")
    if b"END-ISO-10303-21" not in data[-1000:]:
        raise UnreadableFile(path, f"ends at byte {len(data)} before END-ISO-10303-21: truncated", _AGAIN)
    unit = declared_unit(data)
    if not 0 < unit.mm < math.inf:
        raise UnreadableFile(path, f"its unit of length is {unit.name}", _AGAIN)
    tolerance = _tolerance(data, unit.mm, chordal_tolerance_mm)
    return _model(path, _converted(path, "step", tolerance), unit, _METRE)


def read_iges(path: Path, data: bytes, *, chordal_tolerance_mm: float | None = None) -> Model:
    """Return the faces of an IGES file as triangles, like `read_step`; the default tolerance is 0.05 mm."""
    if len(data) < 160 or data[72:73] != b"S":
        raise UnreadableFile(path, "has no IGES start section", "check the suffix")
    if not re.search(rb"^.{72}T", data[-200:], re.MULTILINE):
        raise UnreadableFile(path, "has no IGES terminate section: truncated", "export it again")
    glb = _converted(path, "iges", _positive(chordal_tolerance_mm) or 0.05)
    return _model(path, glb, LengthUnit("mm", MM["mm"]), MM["mm"])


def _positive(tolerance: float | None) -> float | None:
    if tolerance is not None:
        expect_positive(tolerance, "chordal_tolerance_mm", "a positive length in mm")
        return float(tolerance)  # it goes to another process as text, and numpy's own are none there
    return None


def _tolerance(data: bytes, mm: float, wanted: float | None) -> float:
    """Return the chordal tolerance in mm: as given, or from the spread of the points in the file."""
    if (given := _positive(wanted)) is not None:
        return given
    number = rb"\s*([-+.\dEe]+)\s*"
    triples = re.findall(rb"CARTESIAN_POINT\s*\([^(]*\(" + number + rb"," + number + rb"," + number + rb"\)", data)
    if not triples:
        return 0.05
    try:
        points = np.array(triples, float) * mm
    except ValueError:
        return 0.05
    low, high = np.percentile(points, [1, 99], axis=0)
    return max(CHORD_SHARE * float(np.linalg.norm(high - low)), 1e-4)


def _converted(path: Path, kind: str, tolerance: float) -> bytes:
    """Return the GLB that Open CASCADE makes of the file.

    `tolerance` is in mm whatever the unit of the file: the reader converts the model to mm before it is meshed.
    """
    if find_spec("cascadio") is None:
        raise MissingExtra(f"reading {path.name}", "step", "cascadio")
    with tempfile.TemporaryDirectory(prefix="cadcam-") as folder:
        target = Path(folder) / "converted.glb"
        command = [sys.executable, "-P", "-c", _CONVERT, str(path), str(target), kind, repr(tolerance), repr(ANGLE)]
        done = subprocess.run(command, capture_output=True, stdin=subprocess.DEVNULL, check=False)
        if done.returncode == 0 and target.exists() and target.stat().st_size:
            return target.read_bytes()
    if done.returncode < 0:
        reason = f"crashed the Open CASCADE reader (signal {-done.returncode})"
    else:
        said = [line for line in (done.stderr + done.stdout).decode("utf-8", "replace").splitlines() if line.strip()]
        reason = "cannot be read by Open CASCADE" + (f" ({said[-1].strip()[:200]})" if said else "")
    raise UnreadableFile(path, reason, _AGAIN)


_CONVERT = """
import sys
sys.modules["trimesh"] = None  # cascadio would load it, and half of SciPy, to teach it to read what is written here
import cascadio
source, target, kind, tolerance, angle = sys.argv[1:]
data = cascadio.load(open(source, "rb").read(), file_type=kind, tol_linear=float(tolerance),
                     tol_angular=float(angle), merge_primitives=False)
open(target, "wb").write(data)
sys.exit(0 if data else 3)
"""


def _model(path: Path, glb: bytes, unit: LengthUnit, mm: float) -> Model:
    """Return the model that Open CASCADE, which goes by the factor of a unit, has in units of so many mm.

    Of STEP it writes metres, as glTF asks for; of IGES it leaves the mm that it reads any unit as.
    """
    shapes, left_out = _without_loose(list(GltfDocument(path, glb).shapes()))
    mesh = collected(path, [by_product(shape) for shape in shapes], brep=True)
    notes = [f"{left_out} loose surfaces beside solids left out"] if left_out else []
    if unit.called:
        notes.append(f"its unit is called {unit.called!r}, but is {unit.mm:g} mm by its factor, which counts")
    return Model(replace(mesh, vertices=mesh.vertices * (mm / unit.mm)), unit.name, True, tuple(notes), unit.mm)


def by_product(shape: Shape) -> Shape:
    """Return a shape under the name of its product, the mesh's, where the name of its occurrence is a mere number."""
    counted = _COUNTED.fullmatch(shape.names[-1]) and shape.mesh_name
    return replace(shape, names=(*shape.names[:-1], shape.mesh_name)) if counted else shape


def _without_loose(shapes: list[Shape]) -> tuple[list[Shape], int]:
    """Leave out the shells that are, directly or one level down, beside a solid of the same product."""
    with_solid = {shape.names[:1] for shape in shapes if shape.mesh_name == "SOLID"}
    kept = [s for s in shapes if not (s.mesh_name == "SHELL" and s.names[:1] in with_solid)]
    return kept, len(shapes) - len(kept)
