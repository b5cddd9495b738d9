"""Options for estimates from points, shared by several verbs, and the estimate itself."""

from __future__ import annotations

import argparse
import math
from typing import TYPE_CHECKING

from cadcam.cli.arguments import check_in_picture, number, refuse, size
from cadcam.cli.cameras import read_any_camera
from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from cadcam.camera.estimate import CameraEstimate
    from cadcam.camera.lens import Lens
    from cadcam.camera.observations import Observations


def add_estimate_options(parser: argparse.ArgumentParser, *, required: bool = True) -> None:
    """Add the picture's size (`required` or not), fixed values, the lens and the method."""
    source = parser.add_mutually_exclusive_group(required=required)
    source.add_argument("--size", type=size, metavar="WxH", help="picture size in px")
    source.add_argument("--photo", metavar="FILE", help="take the size from this picture (as displayed: EXIF applied)")
    source.add_argument(
        "--internals", metavar="FILE", help="camera file whose K and lens are held: only the pose is estimated"
    )
    parser.add_argument(
        "--fix",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="hold a parameter: X Y Z mm, a b c skew degrees, aspect, focal U0 V0 px; may be repeated; values that the "
        "points contradict are named",
    )
    parser.add_argument(
        "--lens",
        metavar="MODEL:TERMS",
        help="lens with coefficients to estimate (k1) or to hold (k1=-0.2): brown-conrady:k1,k2 division:k fisheye:k1 "
        "odd-radial:a3,a5 (default: ideal, no distortion)",
    )
    parser.add_argument(
        "--method",
        default="reprojection",
        choices=("reprojection", "dlt", "dlt-c23"),
        help="least squares (default), or the direct linear transform alone: normalised, or with C23 = 1",
    )


def estimate_as_asked(arguments: argparse.Namespace, observations: Observations) -> CameraEstimate:
    """Return the estimate by the options of `add_estimate_options`."""
    from cadcam.calibrate.points.camera import calibrate_camera, locate_camera

    if arguments.internals:
        kept = "none: all internals are kept"
        refuse(arguments, "--fix", "--lens", "--method", why="beside --internals", expected=kept)
        camera = read_any_camera(arguments.internals).camera
        check_in_picture(observations, camera.size)
        return locate_camera(observations, camera)
    lens, free_lens = lens_as_asked(arguments)
    picture = size_as_asked(arguments)
    check_in_picture(observations, picture)
    return calibrate_camera(
        observations,
        picture,
        fixed=fixed_as_asked(arguments),
        lens=lens,
        free_lens=free_lens,
        method=arguments.method,
    )


def size_as_asked(arguments: argparse.Namespace) -> tuple[int, int]:
    """Return the picture's (width, height) from --size or --photo."""
    if arguments.size:
        width, height = arguments.size
        return width, height
    from cadcam.image.picture import read_picture_with_info

    return read_picture_with_info(arguments.photo)[1].size


def fixed_as_asked(arguments: argparse.Namespace) -> dict[str, float]:
    """Return the values of --fix NAME=VALUE, degrees converted to radians."""
    from cadcam.report.camera import ANGLES

    fixed: dict[str, float] = {}
    for text in arguments.fix:
        name, equals, value = text.partition("=")
        if not equals or name in fixed:
            raise BadValue("--fix", repr(text), "NAME=VALUE such as skew=0, each name once")
        degrees = number(f"--fix {name}", value)
        fixed[name] = math.radians(degrees) if name in ANGLES else degrees
    return fixed


def _no_lens(model: str, text: str) -> BadValue | UnknownName:
    """Return the error for --lens text with a model that is none, perhaps a coefficient of one."""
    from cadcam.camera.lens import LENSES

    having = [name for name in LENSES if model in LENSES[name]().parameters]
    if having:
        return BadValue("--lens", repr(text), f"MODEL:TERMS; {model} is of {', '.join(having)}: {having[0]}:{text}")
    return UnknownName("lens model", model, LENSES)


def lens_as_asked(arguments: argparse.Namespace) -> tuple[Lens | None, tuple[str, ...]]:
    """Return the lens of --lens MODEL:TERMS and the names of its free coefficients; (None, ()) where none is given."""
    from cadcam.camera.lens import LENSES

    text: str | None = arguments.lens
    if text is None:
        return None, ()
    model, _, terms = text.partition(":")
    if model not in LENSES:
        raise _no_lens(model, text)
    known = LENSES[model]().parameters
    held: dict[str, float] = {}
    free: list[str] = []
    for term in (t.strip() for t in terms.split(",") if t.strip()):
        name, equals, value = term.partition("=")
        if name not in known:
            raise UnknownName(f"coefficient of the {model} lens", name, known)
        if equals:
            held[name] = number(f"--lens {name}", value)
        else:
            free.append(name)
    if known and not (held or free):
        raise BadValue("--lens", repr(text), f"coefficients behind a colon, such as {model}:{next(iter(known))}")
    start = {name: value for name, value in LENSES[model].start.items() if name in free}
    return LENSES[model](**start, **held), tuple(free)
