"""`cadcam compare`: the difference of two cameras for the same directions, in px over the picture."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cadcam.cli.arguments import Verbs, add_json, size, verb
from cadcam.cli.output import check_target, print_json, print_tables, say_written
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera

_EXAMPLES = """\
  cadcam compare before.json after.json                     as they are
  cadcam compare before.json after.json --rotate            after the best rotation: what a new pose cannot take up
  cadcam compare camera.json opencv.yml -o field.png        with a picture of the field
"""
_DESCRIPTION = """\
Compare two cameras: each pixel of A is a direction; where does B see it? Printed are the largest and the rms distance
over the picture, and those at the centre and the corners, in px. Poses play no part. Two calibrations of one camera
may differ by a small rotation that the next pose takes up again: --rotate finds the rotation between the two camera
frames that makes the sum of squares least, and shows what is left. Files of any format that `cadcam convert` reads."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "compare",
        run,
        short="two cameras -> how far apart they see, in px over the picture",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("a", metavar="A", help="camera file of any known format")
    parser.add_argument("b", metavar="B", help="the other")
    parser.add_argument("--rotate", action="store_true", help="allow a rotation between the two camera frames")
    parser.add_argument("-o", "--output", metavar="FILE", help="picture of the field (.png or .svg)")
    parser.add_argument("--camera-name-a", metavar="NAME", help="which camera of A, by its name or number from 0")
    parser.add_argument("--camera-name-b", metavar="NAME", help="which camera of B")
    parser.add_argument("--size", type=size, metavar="WxH", help="picture size in px, where a file has none")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Compare, print, draw."""
    from cadcam.fit.compare import compare_cameras
    from cadcam.report.difference import difference_as_json, difference_table, write_difference

    check_target(arguments.output, (".png", ".svg"))
    a = _camera(arguments, arguments.a, arguments.camera_name_a)
    b = _camera(arguments, arguments.b, arguments.camera_name_b)
    difference = compare_cameras(a, b, rotate=arguments.rotate)
    if arguments.output:
        write_difference(arguments.output, difference, a.size)
    if arguments.json:
        print_json({"a": arguments.a, "b": arguments.b, **difference_as_json(difference)})
    else:
        print_tables([difference_table(difference, (arguments.a, arguments.b))])
    say_written(arguments.output)


def _camera(arguments: argparse.Namespace, path: str, name: str | None) -> Camera:
    from cadcam.files.foreign.registry import read_cameras

    found = read_cameras(path, size=arguments.size).named(name).cameras
    if any(named.camera is not found[0].camera for named in found):
        known = ", ".join(named.name for named in found[:8])
        raise BadValue(
            f"number of cameras in {path}", len(found), f"one: --camera-name-a or --camera-name-b NAME ({known})"
        )
    return found[0].camera
