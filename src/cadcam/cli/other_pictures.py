"""--resize, --binning and --crop: cameras, and rigs, for pictures that were scaled, binned or cut."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING

from cadcam.cli.arguments import given, refuse, size
from cadcam.cli.output import check_target, say
from cadcam.errors import BadValue, UnknownName

if TYPE_CHECKING:
    from cadcam.camera.resampled import PictureMap
    from cadcam.camera.rig_estimate import RigEstimate
    from cadcam.files.foreign.model import Foreign

_OPTIONS = ("--resize", "--binning", "--crop")
_OF_OTHER_FORMATS = ("--from", "--to", "--size", "--unit", "--pixel-pitch", "--allow-loss", "--fit")
_MOST_BINNED = 64  # pixels: far more than any sensor takes together


def add_picture_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how the new pictures were made of those that a camera was calibrated with."""
    group = parser.add_argument_group("a camera, or a rig, for other pictures than it was calibrated with")
    group.add_argument("--resize", type=size, metavar="WxH", help="whole pictures scaled to this size, px")
    group.add_argument("--stretched", action="store_true", help="with --resize: width and height each by its own scale")
    group.add_argument("--binning", type=_binning, metavar="N[xM]", help="N x N (or N x M) pixels taken together")
    group.add_argument("--crop", type=_crop, metavar="X,Y,WxH", help="pictures cut out at pixel X,Y, this size, px")


def for_other_pictures(arguments: argparse.Namespace, found: Foreign) -> Foreign:
    """Return the cameras of pictures that were resized, binned or cut, as asked; one of these at a time."""
    from dataclasses import replace

    if not _asked(arguments):
        return found
    cameras = []
    for one in found.cameras:
        to = _map(arguments, one.name, one.camera.size)
        estimate = None if one.estimate is None else to.estimate(one.estimate)
        cameras.append(replace(one, camera=to.camera(one.camera), estimate=estimate))
    return replace(found, cameras=tuple(cameras))


def convert_rig(arguments: argparse.Namespace) -> RigEstimate:
    """Return the rig of IN for other pictures of all its cameras, or of those named; written, unless OUT is -.

    Of several cameras, --resize and --crop require pictures of one size: they say what becomes of one.
    """
    from cadcam.camera.resampled import resampled_rig
    from cadcam.files.rig import read_rig, write_rig

    for option in given(arguments, *_OF_OTHER_FORMATS):
        raise BadValue(option, "given for a rig file", "leave it out: it has its sizes and units, and stays a rig file")
    asked, told = _asked(arguments), arguments.output == "-"
    if not asked and not told:
        raise BadValue(arguments.input, "a rig file", f"{', '.join(_OPTIONS)}, or - in place of {arguments.output}")
    if not told:
        check_target(arguments.output, (".json",))
    rig = read_rig(arguments.input)
    if not asked:
        refuse(
            arguments, "--camera-name", why="for a rig whose pictures stay", expected=f"{', '.join(_OPTIONS)} beside it"
        )
        return rig
    chosen = arguments.camera_name or rig.names
    for name in chosen:
        if name not in rig.names:
            raise UnknownName(f"camera of {arguments.input}", name, rig.names)
    sizes = {rig.camera(name).size for name in chosen}
    if asked != "--binning" and len(sizes) > 1:
        each = ", ".join("{} {} x {}".format(name, *rig.camera(name).size) for name in chosen)
        remedy = (
            "--camera-name NAME: those of one size; convert the result again for the others, which stay as they are"
        )
        raise BadValue(asked, f"given for cameras of several sizes ({each} px)", remedy)
    rig = resampled_rig(rig, {name: _map(arguments, name, rig.camera(name).size) for name in chosen})
    if not told:
        write_rig(arguments.output, rig)
        say(f"wrote {arguments.output} (rig of {', '.join(rig.names)})")
    return rig


def rig_as_cameras(rig: RigEstimate) -> Foreign:
    """Return a rig's cameras, at their places in the frame of the first, to be listed."""
    from cadcam.files.foreign.model import Foreign, NamedCamera

    cameras = (NamedCamera(name, rig.camera(name), rig.mount(name)) for name in rig.names)
    return Foreign("cadcam", tuple(cameras))


def _asked(arguments: argparse.Namespace) -> str | None:
    """Return the one of these options that is given, if any."""
    asked = given(arguments, *_OPTIONS)
    if len(asked) > 1:
        refuse(arguments, asked[1], why=f"beside {asked[0]}", expected="one at a time; convert the result again")
    if arguments.resize is None:
        refuse(arguments, "--stretched", why="without --resize", expected="both, or leave it out")
    return asked[0] if asked else None


def _map(arguments: argparse.Namespace, name: str, old: tuple[int, int]) -> PictureMap:
    """Return how a camera's new pictures lie in the old ones, and say their size."""
    from cadcam.camera.resampled import PictureMap

    if arguments.resize is not None:
        to = PictureMap.resized(old, arguments.resize, stretched=arguments.stretched)
    elif arguments.binning is not None:
        to = PictureMap.binned(old, arguments.binning)
    else:
        to = PictureMap.cut(old, *arguments.crop)
    say(f"{name}: for pictures of {to.size[0]} x {to.size[1]} px instead of {old[0]} x {old[1]} px")
    return to


def _binning(text: str) -> tuple[int, int]:
    """Return the pixels (x, y) that a text such as 2 or 2x1 bins together."""
    x, cross, y = text.lower().partition("x")
    sides = (x, y if cross else x)
    if not all(side.isdecimal() and 1 <= int(side) <= _MOST_BINNED for side in sides):
        raise argparse.ArgumentTypeError(f"{text!r} is not N or NxM px from 1 to {_MOST_BINNED}, such as 2 or 2x1")
    return int(sides[0]), int(sides[1])


def _crop(text: str) -> tuple[tuple[int, int], tuple[int, int]]:
    """Return (x, y) of the first pixel and (width, height) of a text such as 400,200,1024x768."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 3 or not (parts[0].isdecimal() and parts[1].isdecimal()):
        raise argparse.ArgumentTypeError(f"{text!r} is not X,Y,WxH in whole px, such as 400,200,1024x768")
    return (int(parts[0]), int(parts[1])), size(parts[2])
