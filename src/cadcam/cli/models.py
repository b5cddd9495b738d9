"""CAD models on the command line: loaded once, with a report on stderr."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import real
from cadcam.cli.output import say, working
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.cad.mesh import Mesh
    from cadcam.cad.read import LoadReport


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the model and the options for reading it."""
    parser.add_argument(
        "model",
        metavar="MODEL",
        help="CAD file: STL, OBJ, PLY, OFF, GLB/glTF, 3MF, COLLADA (.dae); STEP and IGES with cadcam[step]",
    )
    add_reading_options(parser)


def add_reading_options(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add the options for reading a model."""
    parser.add_argument(
        "--unit", metavar="U", help="the model's unit where its file names none: um, mm (default), cm, m, in, ft"
    )
    parser.add_argument(
        "--mesh-tolerance",
        type=real,
        metavar="MM",
        help="STEP, IGES: largest distance of triangles from the true surface (default: by the model's size)",
    )


def check_order(photos: Sequence[str], model: str, *, frames: bool = False) -> None:
    """Refuse a photo and a model that were swapped; frames: photos may be folders, patterns and videos."""
    from cadcam.cad.read import SUFFIXES

    what, expected = ("frames", "a folder, pattern or video") if frames else ("photo", "a picture")
    if not model.lower().endswith(SUFFIXES):
        for photo in photos:
            if photo.lower().endswith(SUFFIXES):
                which = "frames come" if frames else "photos come"
                raise BadValue(what, repr(photo), f"{expected}; {which} first, the model last (now {model!r})")


def load_as_asked(arguments: argparse.Namespace) -> tuple[Mesh, LoadReport]:
    """Return the mesh in mm and the report of loading it, which is also printed to stderr except with --json.

    Raises `BadValue` where --pose or --start says that this file was located in another unit.
    """
    with working(f"loading {arguments.model}"):
        from cadcam.cad.read import read_model_with_report

        mesh, report = read_model_with_report(
            arguments.model, unit=arguments.unit, chordal_tolerance_mm=arguments.mesh_tolerance
        )
    if not arguments.json:
        for line in report.lines():
            say(line)
    for file in (getattr(arguments, "pose", None), getattr(arguments, "start", None)):
        if file is not None:
            _check_unit(report, file)
    return mesh, report


def _check_unit(report: LoadReport, pose: str) -> None:
    """Refuse a model in another unit than that in which it was located: it would be drawn 25 or 1000 times too small.

    pose: a file that may be the JSON of `cadcam locate`, which says the unit; others do not.
    """
    import json

    from cadcam.files.text import read_text

    try:
        said = json.loads(read_text(pose).text)
    except (ValueError, RecursionError):
        return
    model = said.get("model") if isinstance(said, dict) else None
    if not isinstance(model, dict) or model.get("sha256") != report.sha256:
        return
    unit = model.get("unit")
    if isinstance(unit, str) and unit != report.unit:
        raise BadValue(f"unit of {report.path}", report.unit, f"that in which {pose} has it: --unit {unit}")


def model_as_json(report: LoadReport, mesh: Mesh) -> dict[str, Any]:
    """Return the report on the model's file."""
    return {
        "file": report.path,
        "sha256": report.sha256,
        "size_mm": list(report.size_mm),
        "unit": report.unit,
        "unit_source": report.unit_source,
        "triangles": report.n_faces,
        "parts": list(mesh.part_names),
        "warnings": list(report.warnings),
    }
