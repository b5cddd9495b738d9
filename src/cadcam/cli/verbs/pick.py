"""`cadcam pick`: a page on which corners of the CAD model are clicked in a photo, for `cadcam calibrate`."""

from __future__ import annotations

import argparse

from cadcam.cli.arguments import (
    POINTS_OPTIONS,
    Verbs,
    add_json,
    add_points_options,
    read_points_as_asked,
    refuse,
    verb,
)
from cadcam.cli.models import add_model_options, check_order, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, say_written, working
from cadcam.cli.whites import add_full_scale, white_as_asked

_EXAMPLES = """\
  cadcam pick photo.jpg part.step -o pick.html
  cadcam pick photo.jpg part.stl --unit m --points points.csv -o pick.html     go on with what was picked before

then: open pick.html in a browser, click corners, save points.csv, and
  cadcam calibrate points.csv --photo photo.jpg -o camera.json                 six corners or more: the camera
  cadcam overlay photo.jpg part.step --camera internals.json --points points.csv -o overlay.png     four: its pose"""
_DESCRIPTION = """\
Write a page that shows the CAD model beside the photo: click a corner of the model, then its place in the photo, under
a magnifier and to a tenth of a pixel. From six corners on the page shows how far each is off, the model's lines over
the photo as the corners have it, and where the next one is to be expected. What was picked is saved as a points file.
The page is one file, loads nothing from anywhere, and the photo stays on this machine."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + CAD model -> a page on which corners are clicked, for a points file"
    parser = verb(verbs, "pick", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("photo", metavar="PHOTO", help="PNG, JPEG, TIFF ... (EXIF orientation is applied)")
    add_model_options(parser)
    add_full_scale(parser)
    parser.add_argument("--points", metavar="FILE", help="points file of what was picked before, to go on with")
    parser.add_argument("-o", "--output", metavar="FILE", required=True, help="page to write: .html")
    add_points_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Read, write, say what to do with it."""
    check_target(arguments.output, (".html", ".htm"))
    check_order([arguments.photo], arguments.model)
    if arguments.points is None:
        refuse(arguments, *POINTS_OPTIONS, why="without --points", expected="both, or leave it out")
    from cadcam.image.camera_picture import read_camera_picture
    from cadcam.render.view import Scene
    from cadcam.report.pick.page import write_pick_page

    picked = None if arguments.points is None else read_points_as_asked(arguments, arguments.points)
    with working(f"reading {arguments.photo}"):
        photo = read_camera_picture(arguments.photo, full_scale=white_as_asked(arguments, [arguments.photo]))
    mesh, report = load_as_asked(arguments)
    with working("finding corners"):
        scene = Scene.of(mesh)
    names = (arguments.photo, arguments.model)
    offered = write_pick_page(arguments.output, photo, scene, picked=picked, names=names)
    if arguments.json:
        print_json({"output": arguments.output, "points": offered, "model": model_as_json(report, mesh)})
        return
    print(f"{offered} points of the model to choose from: open {arguments.output} in a browser, click, save points.csv")
    print(f"then: cadcam calibrate points.csv --photo {arguments.photo} -o camera.json")
    say_written(arguments.output)
