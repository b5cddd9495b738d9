"""`cadcam locate`: photo and CAD model -> the part's pose with its uncertainty, or that the part is not there."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO, Verbs, add_json, refuse, verb, whole
from cadcam.cli.locating import (
    START_HELP,
    VIEWS_HELP,
    add_start_options,
    add_view_options,
    freedom_as_asked,
    instances_located,
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
from cadcam.errors import BadValue
from cadcam.image.suffixes import WRITABLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.arrays import Picture
    from cadcam.cad.read import LoadReport
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.location import Location
    from cadcam.locate.part import Part
    from cadcam.locate.photo import Photo

MOST_INSTANCES = 100
_REFUSED = (1.0, 0.15, 0.1)  # colour of the lines of a pose that is not accepted
_EXAMPLES = f"""\
  cadcam locate photo.png part.step --camera camera.json -o overlay.png
  cadcam locate photo.png part.obj --unit m --camera camera.json --start rough.txt --pose-out pose.json
  cadcam locate photo.png part.stl --camera camera.json --points picked.csv --json
  cadcam locate photo.png part.stl --camera camera.json --seen-from above --distance 800,1500
  cadcam locate tray.png part.stl --camera camera.json --instances -o tray_found.png --pose-out pose.json
  cadcam locate tray.png part.stl --camera camera.json --instances --on 0,0,1,0 --lying 0,0,-1 -o tray_found.png
  cadcam locate left.png right.png part.stl --camera left.json --camera right.json -o both.png
  cadcam locate left.png right.png part.stl --rig rig.json
  cadcam locate photo.png plate.stl --camera camera.json --start rough.txt --freedom plane:0,0,1@part

{START_HELP}
{VIEWS_HELP}
several photos: of a rig's cameras, or of one camera that was moved. Every camera file says where it stood.

instances: of several equal parts in one photo (a tray, a belt, a heap) none stands out, so that without --instances
the answer is "not certain". With it all of them are found that show enough of themselves, also partly one behind the
other, the surest first; --instances 12 ends after 12. --pose-out pose.json writes pose-1.json, pose-2.json ...

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
    parser.add_argument(
        "photos",
        nargs="+",
        metavar="PHOTO",
        help="PNG, JPEG, TIFF ... (EXIF orientation applied): one, or one per camera",
    )
    add_model_options(parser)
    add_photo_options(parser)
    add_start_options(parser)
    add_view_options(parser)
    parser.add_argument(
        "--instances",
        nargs="?",
        type=whole,
        const=MOST_INSTANCES,
        metavar="N",
        help=f"find all instances of the part, at most N (default {MOST_INSTANCES}), not just the only one",
    )
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
    if arguments.instances is not None:
        if arguments.instances < 1:
            raise BadValue("--instances", arguments.instances, "a whole number of at least 1")
        searched = "no start: instances are searched for"
        refuse(arguments, "--start", "--points", "--freedom", why="beside --instances", expected=searched)
    viewpoints, freedom = [photo.viewpoint for photo in shots.photos], freedom_as_asked(arguments)
    start = start_as_asked(arguments, viewpoints, shots.camera_from_world)
    views = views_as_asked(arguments, shots.camera_from_world, "--start", "--points")
    mesh, report = load_as_asked(arguments)
    part = part_as_asked(arguments, mesh)
    if arguments.instances is None:
        every = [located(part, shots, start, freedom, views)]
    else:
        every = instances_located(part, shots, views, arguments.instances)
    faults = [] if every[0].found else faults_in_words(shots)
    if arguments.output:
        _write_overlay(arguments, part, shots, every)
    written = _write_poses(arguments, every, shots, report) if arguments.pose_out and every[0].found else []
    if arguments.json:
        document = _as_json(arguments, every, shots, report)
        print_json(document | {"faults": faults, "model": model_as_json(report, mesh)})
    else:
        _print(arguments, part, every, shots, faults)
        say_written(arguments.output, *written)
    return 0 if every[0].found else NO


def faults_in_words(shots: Shots) -> list[str]:
    """Return the faults of each photo by itself."""
    from cadcam.image.faults import faults_of

    pairs = zip(_photo_files(shots), shots.photos, strict=True)
    return [f"{file}: {fault}" for file, photo in pairs for fault in faults_of(photo.gray)]


def radius_of(part: Part) -> float:
    """Return the largest distance of the part from its origin, mm."""
    import numpy as np

    return float(np.linalg.norm(np.abs(part.scene.mesh.bounds).max(axis=0)))


def _write_overlay(arguments: argparse.Namespace, part: Part, shots: Shots, every: Sequence[Location]) -> None:
    """Write the photos with the lines of what was found, instances with the numbers of their rows."""
    from cadcam.geometry.rigid import Rigid
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.image.picture import write_picture
    from cadcam.render.lines.visible import LineDrawer

    color = LINE if every[0].found else _REFUSED
    poses = [one.pose.world_from_part for one in every]
    lines, pose = (part.lines, poses[0]) if len(every) == 1 else (LineDrawer(part.scene.repeated(poses)), Rigid())
    drawn = []
    for file, white, photo in zip(_photo_files(shots), shots.whites, shots.photos, strict=True):
        picture = overlaid(arguments, lines, read_camera_picture(file, full_scale=white), photo, pose, color)
        drawn.append(picture if arguments.instances is None else _numbered(picture, part, photo, poses))
    write_picture(arguments.output, drawn[0] if len(drawn) == 1 else _beside(drawn))


def _numbered(picture: Picture, part: Part, photo: Photo, poses: Sequence[Rigid]) -> Picture:
    """Return a picture with the number of each pose at the middle of the part there."""
    from cadcam.image.draw import draw_text

    height = max(12.0, photo.camera.height / 32)
    middle = part.scene.mesh.bounds.mean(axis=0)
    for number, pose in enumerate(poses, 1):
        q = photo.camera.project(photo.camera_from_world @ pose @ middle)
        if photo.camera.sees(q):
            for at, color in ((q + 1.5, (0.0, 0.0, 0.0)), (q, (1.0, 1.0, 1.0))):
                picture = draw_text(picture, at, str(number), color=color, height=height)
    return picture


def _write_poses(
    arguments: argparse.Namespace, every: Sequence[Location], shots: Shots, report: LoadReport
) -> list[str]:
    """Write the pose, or those of instances in numbered files; return the files."""
    from cadcam.files.pose_estimate import write_part_pose

    model = {"path": str(report.path), "sha256": report.sha256, "unit": report.unit}
    cameras = [photo.viewpoint for photo in shots.photos]
    target = Path(arguments.pose_out)
    files = [target]
    if arguments.instances is not None:
        files = [target.with_stem(f"{target.stem}-{number}") for number in range(1, len(every) + 1)]
    for file, one in zip(files, every, strict=True):
        write_part_pose(file, one.pose, viewpoints=cameras, model=model)
    stale = target.with_stem(f"{target.stem}-{len(every) + 1}")
    if arguments.instances is not None and stale.exists():
        say(f"{stale} and what follows it are of an earlier run")
    return [str(file) for file in files]


def _beside(pictures: Sequence[Picture]) -> Picture:
    """Return pictures side by side, the lower ones padded with white."""
    import numpy as np

    from cadcam.render.overlay import side_by_side

    height = max(p.shape[0] for p in pictures)
    return side_by_side(*(np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=1.0) for p in pictures))


def _photo_files(shots: Shots) -> list[str]:
    return [path for role, path, _ in shots.files if role == "photo"]


def _as_json(
    arguments: argparse.Namespace, every: Sequence[Location], shots: Shots, report: LoadReport
) -> dict[str, Any]:
    """Return the document; that of one part `cadcam state add` reads as a record without deviations."""
    from datetime import UTC, datetime

    from cadcam import __version__
    from cadcam.report.locate import location_as_json
    from cadcam.report.photos import photos_as_json

    several = arguments.instances is not None
    head = {
        "format": "cadcam instances" if several else "cadcam location",
        "version": 1,
        "software": f"cadcam {__version__}",
        "time_utc": datetime.now(UTC).replace(tzinfo=None).isoformat() + "Z",
        "part": arguments.part or Path(arguments.model).stem,
    }
    files = [*shots.files, ("cad", str(report.path), report.sha256)]
    sources = [dict(zip(("role", "path", "sha256"), file, strict=True)) for file in files]
    each = [location_as_json(one, shots.photos) for one in every]
    said = each[0]
    if several and every[0].found:
        said = {"found": True, "instances": each}
    elif several:
        said = each[0] | {"instances": []}
    photos = {"photos": photos_as_json(shots.read)}
    return head | said | photos | ({} if several else {"deviations": []}) | {"sources": sources}


def _print(
    arguments: argparse.Namespace, part: Part, every: Sequence[Location], shots: Shots, faults: Sequence[str]
) -> None:
    from cadcam.locate.reason import Refusal
    from cadcam.report.locate import evidence_table, instances_table, location_tables

    best = every[0]
    if best.found and arguments.instances is not None:
        print_tables([instances_table(every, shots.photos[0], radius_mm=radius_of(part))])
    elif best.found:
        print_tables(location_tables(best, shots.photos, radius_mm=radius_of(part)))
    else:
        print_tables([evidence_table(best)])
        said = [f"{arguments.model} was not found in {', '.join(_photo_files(shots))}", *faults]
        if best.why.refusal is Refusal.NOT_CERTAIN and arguments.instances is None:
            said.append("if there are several of it, --instances finds each of them")
        elif best.why.off_plane:
            said.append("if it does: is --on in the world of the camera's pose, and known as well as stated (:MM)?")
        elif not faults:
            said.append(f"the picture itself is fit for use: {best.doubts(freedom_as_asked(arguments))}")
        say("\n".join(said))
