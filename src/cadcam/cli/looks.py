"""Options of shaded pictures: light, colours of parts, edge lines, background."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from cadcam.cli.arguments import named_color, refuse
from cadcam.cli.photograph_options import add_photograph_options, check_photograph_options
from cadcam.cli.sensors import add_sensor_options
from cadcam.cli.wires import draws_lines, scene_of, scene_without_edges
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.cad.mesh import Mesh
    from cadcam.render.view import Look, Scene

NAMES = ("default", "inspection", "flat")
_SAMPLES = 3  # per pixel and axis: for smooth outlines


def add_look_options(parser: argparse.ArgumentParser) -> None:
    """Add the options for the look of the shaded picture."""
    group = parser.add_argument_group("looks of the shaded picture")
    group.add_argument(
        "--look",
        choices=NAMES,
        help="light: default (three lights), inspection (even, no face dark), flat (each part in its colour)",
    )
    group.add_argument(
        "--part-color",
        type=named_color,
        action="append",
        metavar="NAME=#rrggbb",
        help="colour of a part, or of parts by a pattern such as 'bolt*'; may be repeated, the last one wins",
    )
    group.add_argument("--edges", action="store_true", help="soft edge lines on it; see lines below")
    group.add_argument(
        "--background",
        metavar="COLOUR|PHOTO",
        help="'#rrggbb', white (default), black, or a photo of the camera's size",
    )
    group.add_argument("--transparent", action="store_true", help="no background at all: .png with alpha")
    add_photograph_options(parser)
    add_sensor_options(parser)


def check_look_options(arguments: argparse.Namespace) -> None:
    """Refuse options without effect, before the work starts."""
    look = ("--look", "--edges", "--background", "--transparent", "--sensor")
    here = f"with --channel {arguments.channel}"
    if arguments.channel != "shaded":
        refuse(arguments, *look, why=here, expected="--channel shaded, or leave it out")
    if arguments.channel not in ("shaded", "parts"):
        refuse(arguments, "--part-color", why=here, expected="--channel shaded or parts")
    if arguments.sensor is None:
        refuse(arguments, "--seed", why="without --sensor", expected="both: nothing else here is left to chance")
    if arguments.transparent:
        beside = "beside --transparent"
        refuse(arguments, "--background", why=beside, expected="one of them")
        refuse(arguments, "--sensor", why=beside, expected="one of them: a camera sees some background")
    if arguments.transparent and not arguments.output.lower().endswith(".png"):
        raise BadValue("--transparent", f"given for {arguments.output}", "an output .png: no other format has alpha")
    check_photograph_options(arguments)


def look_of(arguments: argparse.Namespace) -> Look:
    """Return the look to render with: on black, because `Dress` adds the background."""
    from cadcam.render.looks import named_look

    look = named_look(arguments.look or "default")
    return replace(look, supersampling=_SAMPLES, background=(0.0, 0.0, 0.0))


def scene_as_asked(arguments: argparse.Namespace, mesh: Mesh) -> Scene:
    """Return the scene in the requested colours, with its edges where they are drawn: finding them takes time."""
    from cadcam.render.looks import repaint

    scene = scene_of(arguments, mesh) if draws_lines(arguments) else scene_without_edges(mesh)
    return repaint(scene, arguments.part_color or ())
