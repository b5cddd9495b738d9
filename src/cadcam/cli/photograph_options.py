"""Options of photographs: light with shadows, and a lens with an opening."""

from __future__ import annotations

import argparse

from cadcam.cli.arguments import given, real, refuse, whole
from cadcam.errors import BadValue
from cadcam.kinds import expect_count

LIGHTS = ("hall", "sun", "ring", "even")
WALL = "#808080"  # behind a photograph, where nothing else is asked for
SAMPLES = 64


def add_photograph_options(parser: argparse.ArgumentParser) -> None:
    """Add light and lens."""
    group = parser.add_argument_group(
        "photograph", "what a camera would really take, in linear light; with --sensor, down to its grey levels"
    )
    group.add_argument(
        "--light",
        choices=LIGHTS,
        help="hall (lamps under the roof, soft shadows; the default with --f-number), sun (hard shadows), ring (flash "
        "round the lens), even; +Z is up",
    )
    group.add_argument(
        "--focal", type=real, metavar="MM", help="focal length, for --f-number; lens distortion is the camera file's"
    )
    group.add_argument("--f-number", type=real, metavar="N", help="aperture of the lens: blurs what is out of focus")
    group.add_argument(
        "--focus", type=real, metavar="MM", help="distance in focus, from the lens (default: the middle of the model)"
    )
    group.add_argument(
        "--renderings",
        type=whole,
        metavar="N",
        help=f"renderings that make up the photograph (default: {SAMPLES}; more for much blur, fewer for speed)",
    )


def is_photograph(arguments: argparse.Namespace) -> bool:
    """Whether light or lens were asked for."""
    return arguments.light is not None or arguments.f_number is not None


def check_photograph_options(arguments: argparse.Namespace) -> None:
    """Refuse options that would be ignored, and a lens that is half specified, before the work starts."""
    photograph = ("--light", "--f-number", "--focal", "--focus", "--renderings")
    if arguments.channel != "shaded":
        here = f"with --channel {arguments.channel}"
        refuse(arguments, *photograph, why=here, expected="--channel shaded, or leave it out")
    if arguments.f_number is None:
        all_of_it = "--f-number N too: blur is decided by the opening"
        refuse(arguments, "--focal", "--focus", why="without --f-number", expected=all_of_it)
    elif arguments.focal is None:
        raise BadValue("--f-number", "given without --focal", "both: the opening is focal length by f-number")
    if not is_photograph(arguments):
        one = "one of them: else nothing is photographed"
        refuse(arguments, "--renderings", why="without --light or --f-number", expected=one)
    if arguments.renderings is not None:
        from cadcam.render.samples import MOST

        expect_count(arguments.renderings, "--renderings", most=MOST)
    for asked in given(arguments, *photograph)[:1]:
        neither = "one of them: photographs have neither looks nor drawn edges"
        refuse(arguments, "--look", "--edges", why=f"beside {asked}", expected=neither)
