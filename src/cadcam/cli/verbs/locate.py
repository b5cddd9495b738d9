"""`cadcam locate`: photo and CAD model -> the part's pose with its uncertainty, or that the part is not there."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO, Verbs, add_json, refuse, verb
from cadcam.cli.locating import (
    START_HELP,
    VIEWS_HELP,
    add_start_options,
    add_view_options,
    freedom_as_asked,
    located,
    overlaid,
    part_as_asked,
    start_as_asked,
    views_as_asked,
)
from cadcam.cli.models import add_model_options, check_order, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, print_tables, say, say_written
from cadcam.cli.photos import Shots, add_photo_options, read_shots
from cadcam.cli.wires import LINE, LOOKS, add_line_options
from cadcam.image.suffixes import WRITABLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.arrays import Picture
    from cadcam.cad.read import LoadReport
    from cadcam.locate.location import Location
    from cadcam.locate.part import Part

_REFUSED = (1.0, 0.15, 0.1)  # colour of the lines of a pose that is not accepted
_EXAMPLES = f"""\
  cadcam locate photo.png part.step --camera camera.json -o overlay.png
  cadcam locate photo.png part.obj --unit m --camera camera.json --start rough.txt --pose-out pose.json
  cadcam locate photo.png part.stl --camera camera.json --points picked.csv --json
  cadcam locate photo.png part.stl --camera camera.json --seen-from above --distance 800,1500
  cadcam locate left.png right.png part.stl --camera left.json --camera right.json -o both.png
  cadcam locate left.png right.png part.stl --rig rig.json
  cadcam locate photo.png plate.stl --camera camera.json --start rough.txt --freedom plane:0,0,1@part

{START_HELP}
{VIEWS_HELP}
several photos: of a rig's cameras, or of one camera that was moved. Every camera file says where it stood.

exit code: 0 found, 3 not found, 2 wrong input. Not found means that no pose fits the edges in the picture: another
part, a hidden part, a mirrored or blurred picture, or the file of another camera. The reason is printed, the overlay
shows the best candidate in red, and --pose-out writes nothing."""
_DESCRIPTION = """\
Find a part in a photo by the edges of its CAD model, to a fraction of a pixel. The pose comes with its covariance
(noise of the photo, errors of the camera's calibration), with a quality between 0 and 1 (found from 0.5 on, for all
parts), and with the other poses that the photo allows (symmetric parts)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + CAD model + camera -> where the part is, with covariance, or that it is not there"
    parser = verb(verbs, "locate", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("photos", nargs="+", metavar="PHOTO", help="PNG, JPEG, TIFF ...: one, or one per camera")
    add_model_options(parser)
    add_photo_options(parser)
    add_start_options(parser)
    add_view_options(parser)
    group = parser.add_argument_group("results")
    group.add_argument("-o", "--output", metavar="FILE", help="photo with the model's lines on it: .png or .jpg")
    group.add_argument("--pose-out", metavar="FILE", help="write the pose with its covariance: .json")
    group.add_argument("--part", metavar="NAME", help="kind of part, for `cadcam state` (default: the model's name)")
    add_line_options(parser, color_by="one")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Locate, print, write; return the exit code."""
    if arguments.output:
        check_target(arguments.output, WRITABLE)
    else:
        refuse(arguments, *LOOKS, why="where no lines are drawn", expected="-o FILE beside it")
    check_target(arguments.pose_out, (".json",))
    check_order(arguments.photos, arguments.model)
    shots = read_shots(arguments.photos, arguments)
    start, freedom = start_as_asked(arguments, shots.photos[0].viewpoint), freedom_as_asked(arguments)
    views = views_as_asked(arguments, "--start", "--points")
    mesh, report = load_as_asked(arguments)
    part = part_as_asked(arguments, mesh)
    location = located(part, shots, start, freedom, views)
    faults = [] if location.found else faults_in_words(shots)
    if arguments.output:
        _write_overlay(arguments, part, shots, location)
    if arguments.pose_out and location.found:
        from cadcam.files.pose_estimate import write_part_pose

        model = {"path": str(report.path), "sha256": report.sha256, "unit": report.unit}
        cameras = [photo.viewpoint for photo in shots.photos]
        write_part_pose(arguments.pose_out, location.pose, viewpoints=cameras, model=model)
    if arguments.json:
        document = _as_json(arguments, location, shots, report)
        print_json(document | {"faults": faults, "model": model_as_json(report, mesh)})
    else:
        _print(arguments, part, location, shots, faults)
    return 0 if location.found else NO


def faults_in_words(shots: Shots) -> list[str]:
    """Return the faults of each photo by itself."""
    from cadcam.image.faults import faults_of

    pairs = zip(_photo_files(shots), shots.photos, strict=True)
    return [f"{file}: {fault}" for file, photo in pairs for fault in faults_of(photo.gray)]


def radius_of(part: Part) -> float:
    """Return the largest distance of the part from its origin, mm."""
    import numpy as np

    return float(np.linalg.norm(np.abs(part.scene.mesh.bounds).max(axis=0)))


def _write_overlay(arguments: argparse.Namespace, part: Part, shots: Shots, location: Location) -> None:
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.image.picture import write_picture

    color = LINE if location.found else _REFUSED
    pictures = [
        read_camera_picture(file, full_scale=white)
        for file, white in zip(_photo_files(shots), shots.whites, strict=True)
    ]
    drawn = [
        overlaid(arguments, part, picture, photo, location.pose.world_from_part, color)
        for picture, photo in zip(pictures, shots.photos, strict=True)
    ]
    write_picture(arguments.output, drawn[0] if len(drawn) == 1 else _beside(drawn))


def _beside(pictures: Sequence[Picture]) -> Picture:
    """Return pictures side by side, the lower ones padded with white."""
    import numpy as np

    from cadcam.render.overlay import side_by_side

    height = max(p.shape[0] for p in pictures)
    return side_by_side(*(np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=1.0) for p in pictures))


def _photo_files(shots: Shots) -> list[str]:
    return [path for role, path, _ in shots.files if role == "photo"]


def _as_json(arguments: argparse.Namespace, location: Location, shots: Shots, report: LoadReport) -> dict[str, Any]:
    """Return the document, which `cadcam state add` reads as a record without deviations."""
    from datetime import UTC, datetime

    from cadcam import __version__
    from cadcam.report.locate import location_as_json
    from cadcam.report.photos import photos_as_json

    head = {
        "format": "cadcam location",
        "version": 1,
        "software": f"cadcam {__version__}",
        "time_utc": datetime.now(UTC).replace(tzinfo=None).isoformat() + "Z",
        "part": arguments.part or Path(arguments.model).stem,
    }
    files = [*shots.files, ("cad", str(report.path), report.sha256)]
    sources = [dict(zip(("role", "path", "sha256"), file, strict=True)) for file in files]
    said = location_as_json(location, shots.photos) | {"photos": photos_as_json(shots.read)}
    return head | said | {"deviations": [], "sources": sources}


def _print(arguments: argparse.Namespace, part: Part, location: Location, shots: Shots, faults: Sequence[str]) -> None:
    from cadcam.report.locate import evidence_table, location_tables

    if location.found:
        print_tables(location_tables(location, shots.photos, radius_mm=radius_of(part)))
    else:
        print_tables([evidence_table(location)])
        said = [f"{arguments.model} was not found in {', '.join(_photo_files(shots))}", *faults]
        if not faults:
            said.append("the picture itself is fit for use: is it this part, this camera, not mirrored, all in view?")
        say("\n".join(said))
    say_written(arguments.output, arguments.pose_out if location.found else None)
