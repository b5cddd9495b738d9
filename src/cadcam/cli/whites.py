"""How photos on the command line are read: of 10, 12 or 14 bits in 16, of several pages, turned; found or as asked."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING

from cadcam.cli.arguments import real
from cadcam.cli.output import say, working
from cadcam.errors import BadValue, listed

if TYPE_CHECKING:
    from cadcam.image.camera_picture import FullScale


def add_full_scale(parser: argparse.ArgumentParser | argparse._ArgumentGroup) -> None:
    """Add --full-scale."""
    parser.add_argument(
        "--full-scale",
        type=real,
        metavar="VALUE",
        help="white as stored in photos of more than 8 bits: 4095 for 12 bits in 16 (default: the least of 1023, 4095, "
        "16383 and 65535 that no photo exceeds)",
    )


def white_as_asked(arguments: argparse.Namespace, files: Sequence[str]) -> float | None:
    """Return the stored value of white in photos of one camera, None where it is not in question.

    Says so where fewer than 16 bits are found to be used, of which files only the first page is read, and which are
    turned by their EXIF orientation. Raises `UnreadableFile`, or `BadValue` for a white that counts for none of them.
    """
    from cadcam.image.camera_picture import full_scale_of

    say_pages(files)
    say_turned(files)
    if arguments.full_scale is not None:
        check_counts(arguments.full_scale, files)
        return float(arguments.full_scale)
    with working("reading how bright the photos are" if len(files) > 1 else f"reading {files[0]}"):
        found = full_scale_of(files)
    say_white(files[0] if len(files) == 1 else f"{files[0]} and {len(files) - 1} more", found)
    return None if found is None else found.white


def say_white(which: str, found: FullScale | None) -> None:
    """Say what was taken as white where fewer than 16 bits seem to be used, and how to say otherwise."""
    if found is not None and found.bits < 16:
        say(
            f"{which}: read as {found.bits} bits in 16: no value exceeds {found.brightest} "
            "(--full-scale 65535 if it is 16 bits and dark)"
        )


def say_pages(files: Sequence[str]) -> None:
    """Say which files hold several pictures, of which only the first is read."""
    from cadcam.image.camera_picture import pictures_in

    several = {file: count for file in files if (count := pictures_in(file)) > 1}
    if several:
        each = listed([f"{file} ({count})" for file, count in several.items()], 3)
        say(f"{each}: of several pages only the first is read; save the others as files of their own")


def say_turned(files: Sequence[str]) -> None:
    """Say which photos are turned when they are read: by 180 degrees they have the size of those that are not."""
    from cadcam.image.picture import turned_in

    turned = {file: how for file in files if (how := turned_in(file))}
    if turned:
        each = listed([f"{file} ({how})" for file, how in turned.items()], 3)
        say(f"{each}: by its EXIF orientation; the camera file has to be of photos read so")


def check_counts(white: float, files: Sequence[str]) -> None:
    """Refuse a white that is not positive, or that counts for none of the files."""
    from cadcam.image.camera_picture import is_deep
    from cadcam.image.picture import check_full_scale

    check_full_scale(white, "--full-scale")
    if not any(is_deep(file) for file in files):
        these = f"{files[0]}, which has" if len(files) == 1 else "pictures that all have" if files else "videos, with"
        raise BadValue("--full-scale", f"given for {these} 8 bits a sample", "none: white is 255 there")
