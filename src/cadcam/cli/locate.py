"""`cadcam locate`: photo and CAD model -> where the part is, how sure that is, or that it is not there."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, verb
from cadcam.cli.locating import (
    START_HELP,
    View,
    add_start_options,
    add_view_options,
    freedom_as_asked,
    part_as_asked,
    start_as_asked,
    views_as_asked,
)
from cadcam.cli.models import add_model_options, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, print_tables, say, working
from cadcam.cli.wires import LINE, add_line_options, style_of
from cadcam.errors import SizeMismatch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.arrays import Picture
    from cadcam.cad.load import LoadReport
    from cadcam.locate.location import Location
    from cadcam.locate.part import Part
    from cadcam.locate.photo import Photo

NOT_FOUND = 3  # exit code
_REFUSED = (1.0, 0.15, 0.1)  # colour of lines that are not believed
_EXAMPLES = f"""\
  cadcam locate photo.png part.step --camera camera.json -o overlay.png
  cadcam locate photo.png part.obj --unit m --camera camera.json --start rough.txt --pose-out pose.json
  cadcam locate photo.png part.stl --camera camera.json --points picked.csv --json
  cadcam locate left.png part.stl --camera left.json --also right.png=right.json -o both.png
  cadcam locate left.png part.stl --rig rig.json --camera left --also right.png=right
  cadcam locate photo.png plate.stl --camera cell.json --start rough.txt --freedom plane:0,0,1

{START_HELP}
several photos: from cameras of a rig, or from one that was moved: every camera file says where it stood.

exit code: 0 found, 3 not found, 2 wrong input. Not found means that the picture does not show the model's edges where
any pose would put them: another part, a part that is hidden, a mirrored or blurred picture, a camera file of another
camera. What was looked at is said, and the overlay shows the best candidate in red. --pose-out then writes nothing."""
_DESCRIPTION = """\
Find a part in a photo by its CAD model's edges, to a fraction of a pixel, and say how sure that is: the pose comes with
its covariance (noise of the photo, errors of the camera's calibration), a quality between 0 and 1 (found from 0.5 on,
for all parts), and the other poses that the photo allows (symmetric parts)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + CAD model + camera -> where the part is, with covariance, or that it is not there"
    parser = verb(verbs, "locate", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("photo", help="PNG, JPEG, TIFF ... of the camera's size (EXIF orientation is applied)")
    add_model_options(parser)
    add_view_options(parser, what="PHOTO")
    add_start_options(parser)
    group = parser.add_argument_group("results")
    group.add_argument("-o", "--output", metavar="FILE", help="photo with the model's lines on it: .png or .jpg")
    group.add_argument("--pose-out", metavar="FILE", help="write the pose with its covariance: .json")
    group.add_argument("--part", metavar="NAME", help="kind of part, for `cadcam state` (default: the model's name)")
    add_line_options(parser, color_by="one")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Locate, print, write; return the exit code."""
    if arguments.output:
        check_target(arguments.output, (".png", ".jpg", ".jpeg"))
    if arguments.pose_out:
        check_target(arguments.pose_out, (".json",))
    views = views_as_asked(arguments, arguments.photo)
    start, freedom = start_as_asked(arguments, views[0].viewpoint), freedom_as_asked(arguments)
    pictures = [read_photo(view) for view in views]
    photos = [photo for _, photo, _ in pictures]
    mesh, report = load_as_asked(arguments)
    part = part_as_asked(arguments, mesh)
    with working("looking for the part" if start is None else "locating"):
        from cadcam.locate.locate import locate

        location = locate(part, photos, start, freedom=freedom)
    faults = [] if location.found else faults_in_words([view.source for view in views], photos)
    if arguments.output:
        _write_overlay(arguments, part, [picture for picture, _, _ in pictures], photos, location)
    if arguments.pose_out and location.found:
        from cadcam.files.pose_estimate import write_part_pose

        write_part_pose(arguments.pose_out, location.pose)
    if arguments.json:
        sources = _sources(views, [sha256 for _, _, sha256 in pictures], report)
        document = _as_json(arguments, location, photos, faults) | {"sources": sources}
        print_json(document | {"model": model_as_json(report, mesh)})
    else:
        _print(arguments, part, location, photos, faults)
    return 0 if location.found else NOT_FOUND


def read_photo(view: View) -> tuple[Picture, Photo, str]:
    """Return the picture of a view in its colours, the photo to locate in, and the file's hash."""
    from cadcam.image.picture import read_picture_with_info
    from cadcam.locate.photo import Photo

    picture, info = read_picture_with_info(view.source)
    try:
        return picture, Photo(picture, view.viewpoint), info.sha256
    except SizeMismatch as error:
        raise SizeMismatch(view.source, error.size, error.expected, "give the camera that took it") from None


def faults_in_words(sources: Sequence[str], photos: Sequence[Photo]) -> list[str]:
    """Return what is wrong with each photo in itself."""
    from cadcam.image.faults import faults_of

    pairs = zip(sources, photos, strict=True)
    return [f"{source}: {fault}" for source, photo in pairs for fault in faults_of(photo.gray)]


def radius_of(part: Part) -> float:
    """Return how far the part reaches from its origin, mm."""
    import numpy as np

    return float(np.linalg.norm(np.abs(part.scene.mesh.bounds).max(axis=0)))


def _write_overlay(
    arguments: argparse.Namespace,
    part: Part,
    pictures: Sequence[Picture],
    photos: Sequence[Photo],
    location: Location,
) -> None:
    from cadcam.image.picture import write_picture

    color = LINE if location.found else _REFUSED
    drawn = [
        overlaid(arguments, part, picture, photo, location.pose.world_from_part, color)
        for picture, photo in zip(pictures, photos, strict=True)
    ]
    write_picture(arguments.output, drawn[0] if len(drawn) == 1 else _beside(drawn))


def overlaid(
    arguments: argparse.Namespace,
    part: Part,
    picture: Picture,
    photo: Photo,
    world_from_part: Any,
    color: tuple[float, float, float] = LINE,
) -> Picture:
    """Return a picture with the part's visible lines at a pose; without any where the pose puts it out of view."""
    from cadcam.errors import NothingInView
    from cadcam.image.picture import to_rgb
    from cadcam.render.overlay import overlay
    from cadcam.render.wireframe import LineOptions

    pose = photo.viewpoint.camera_from_world @ world_from_part
    try:
        wireframe = part.lines.draw(photo.camera, pose, options=LineOptions(hidden=arguments.hidden))
    except NothingInView:
        return to_rgb(picture)
    return overlay(picture, wireframe, style=style_of(arguments, color=color))


def _beside(pictures: Sequence[Picture]) -> Picture:
    """Return pictures side by side, the lower ones filled up with white."""
    import numpy as np

    from cadcam.render.overlay import side_by_side

    height = max(p.shape[0] for p in pictures)
    return side_by_side(*(np.pad(p, ((0, height - len(p)), (0, 0), (0, 0)), constant_values=1.0) for p in pictures))


def _sources(views: Sequence[View], hashes: Sequence[str], report: LoadReport) -> list[dict[str, str]]:
    """Return the files that the result came from, as a record of `cadcam state` has them."""
    import hashlib

    found = [{"role": "photo", "path": v.source, "sha256": h} for v, h in zip(views, hashes, strict=True)]
    found.append({"role": "cad", "path": str(report.path), "sha256": report.sha256})
    cameras = dict.fromkeys(view.camera_file for view in views)
    return found + [
        {"role": "camera", "path": path, "sha256": hashlib.sha256(Path(path).read_bytes()).hexdigest()}
        for path in cameras
    ]


def _as_json(
    arguments: argparse.Namespace, location: Location, photos: Sequence[Photo], faults: Sequence[str]
) -> dict[str, Any]:
    """Return the document, which `cadcam state add` reads as a record without deviations."""
    from datetime import UTC, datetime

    from cadcam import __version__
    from cadcam.report.locate import location_as_json

    head = {
        "format": "cadcam location",
        "version": 1,
        "software": f"cadcam {__version__}",
        "time_utc": datetime.now(UTC).replace(tzinfo=None).isoformat() + "Z",
        "part": arguments.part or Path(arguments.model).stem,
    }
    return head | location_as_json(location, photos) | {"deviations": [], "faults": list(faults)}


def _print(
    arguments: argparse.Namespace,
    part: Part,
    location: Location,
    photos: Sequence[Photo],
    faults: Sequence[str],
) -> None:
    from cadcam.report.locate import evidence_table, location_tables

    if location.found:
        print_tables(location_tables(location, photos, radius_mm=radius_of(part)))
    else:
        print_tables([evidence_table(location)])
        said = [f"{arguments.model} was not found in {arguments.photo}", *faults]
        if not faults:
            said.append("the picture itself is fit for use: is it this part, this camera, not mirrored, all in view?")
        say("\n".join(said))
    for path in (arguments.output, arguments.pose_out if location.found else None):
        if path:
            say(f"wrote {path}")
