"""Wireframes on the command line: which lines, and their style."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import real, refuse
from cadcam.cli.output import working
from cadcam.errors import NothingInView

if TYPE_CHECKING:
    from cadcam.cad.mesh import Mesh
    from cadcam.camera.camera import Camera
    from cadcam.geometry.rigid import Rigid
    from cadcam.render.lines.wireframe import Wireframe
    from cadcam.render.overlay import LineStyle
    from cadcam.render.view import Scene

LOOKS = ("--hidden", "--color-by", "--width")  # options of lines that are drawn
LINE = (0.0, 0.85, 0.35)  # on photos
INK = (0.05, 0.08, 0.12)  # on paper
_WIDTH_PX, _CREASE_DEG = 1.5, 30.0


def add_line_options(parser: argparse.ArgumentParser, *, color_by: str = "kind") -> None:
    """Add the options for the lines and their style; `color_by` is the default."""
    group = parser.add_argument_group("lines")
    group.add_argument("--hidden", action="store_true", help="hidden lines too, dashed")
    group.add_argument(
        "--color-by",
        choices=("kind", "part", "one"),
        default=color_by,
        help=f"colours: by kind of edge, by part, or one for all (default {color_by})",
    )
    group.add_argument("--width", type=real, default=_WIDTH_PX, metavar="PX", help=f"line width (default {_WIDTH_PX})")
    group.add_argument(
        "--crease-angle",
        type=real,
        default=_CREASE_DEG,
        metavar="DEG",
        help=f"least angle between two facets that is drawn as an edge (default {_CREASE_DEG:g})",
    )


def draws_lines(arguments: argparse.Namespace) -> bool:
    """Return whether the output of `render` shows lines."""
    return bool(arguments.channel == "wireframe" or arguments.edges)


def check_line_options(arguments: argparse.Namespace) -> None:
    """Refuse options for the style of lines where `render` draws none."""
    if not draws_lines(arguments):
        refuse(
            arguments,
            *LOOKS,
            "--crease-angle",
            why="where no lines are drawn",
            expected="--edges or --channel wireframe beside it",
        )


def scene_of(arguments: argparse.Namespace, mesh: Mesh) -> Scene:
    """Return the scene with its feature edges."""
    from cadcam.cad.edges import feature_edges
    from cadcam.render.view import Scene

    with working("finding edges"):
        return Scene.of(mesh, edges=feature_edges(mesh, crease_angle_deg=arguments.crease_angle))


def scene_without_edges(mesh: Mesh) -> Scene:
    """Return the scene for channels without lines: finding edges takes time."""
    from cadcam.cad.edges import NO_EDGES
    from cadcam.render.view import Scene

    return Scene.of(mesh, edges=NO_EDGES)


def wireframe_of(arguments: argparse.Namespace, scene: Scene, camera: Camera, pose: Rigid) -> Wireframe:
    """Return the visible wireframe, with the hidden lines if requested."""
    from cadcam.render.lines.visible import visible_wireframe
    from cadcam.render.lines.wireframe import LineOptions

    with working("removing hidden lines"), naming(arguments.model):
        return visible_wireframe(scene, camera, pose, options=LineOptions(hidden=arguments.hidden))


def style_of(arguments: argparse.Namespace, *, color: tuple[float, float, float] = LINE) -> LineStyle:
    """Return how the lines are drawn; `color` where all have one."""
    from cadcam.render.overlay import LineStyle

    return LineStyle(
        color_by=arguments.color_by, color=color, width=arguments.width, hidden_width=arguments.width * 2 / 3
    )


def lines_as_json(wireframe: Wireframe) -> dict[str, Any]:
    """Return how many polylines there are, and how long those of each kind are in px."""
    from cadcam.cad.edges import EdgeKind

    lines, length = wireframe.visible, wireframe.visible.length_px
    by_kind = {kind.name.lower(): float(length[lines.kind == kind].sum()) for kind in EdgeKind}
    return {
        "visible_lines": len(lines),
        "hidden_lines": len(wireframe.hidden),
        "visible_length_px": {name: total for name, total in by_kind.items() if total},
    }


def lines_in_words(said: dict[str, Any]) -> str:
    """Return what `lines_as_json` says as a sentence."""
    total = sum(said["visible_length_px"].values())
    kinds = ", ".join(f"{name} {length:.0f}" for name, length in said["visible_length_px"].items())
    hidden = f", {said['hidden_lines']} hidden ones" if said["hidden_lines"] else ""
    return f"{said['visible_lines']} visible lines{hidden}, {total:.0f} px ({kinds})"


@contextmanager
def naming(model: str) -> Iterator[None]:
    """Put the model's name before the error that none of it is in view."""
    try:
        yield
    except NothingInView as error:
        raise NothingInView(f"{model}: {error}") from None
