"""What verbs that judge parts share: how they are asked to, what is judged, and the files that it came from."""

from __future__ import annotations

import argparse
from contextlib import contextmanager
from typing import TYPE_CHECKING

from cadcam.cli.arguments import real, share
from cadcam.cli.output import working
from cadcam.cli.photos import Shots
from cadcam.errors import CadcamError, UnreadableFile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from cadcam.cad.mesh import Mesh
    from cadcam.cad.read import LoadReport
    from cadcam.locate.part import Part
    from cadcam.report.verify.json import VerificationOrigin
    from cadcam.verify.inspection import InspectionOptions
    from cadcam.verify.tolerances.tolerance import Tolerances

TOLERANCES_HELP = """\
tolerance file (YAML; mm and degrees, in the part's axes):
  k: 2                             coverage factor
  datum: [{part: tank top}]        what the pose is fitted to; without it: all that is not judged
  features:
    stiffener:
      part: bar 1.1 port           or a pattern; box_mm, chains, kinds narrow it
      position_mm: 0.8             also: profile_mm, angle_deg; direction: [0, 1, 0] judges a position along it alone,
                                   axis: [0, 0, 1] across it alone, as of a hole or pin; diameter_mm: 0.1
      presence: required
  distances:                       between two features, each as above, with limits of its own or without
    pitch: {between: [stiffener, other], direction: [0, 1, 0], distance_mm: [-0.1, 0.2]}
"""


def add_judging_options(parser: argparse.ArgumentParser) -> None:
    """Add what says how far off features are looked for, and how surely."""
    parser.add_argument(
        "--reach",
        type=real,
        default=8.0,
        metavar="PX",
        help="how far off displaced features are looked for (default 8)",
    )
    parser.add_argument(
        "--alarms",
        type=share,
        default=0.01,
        metavar="SHARE",
        help="share of good pictures that may give a false alarm (default 0.01)",
    )


def options_as_asked(arguments: argparse.Namespace) -> InspectionOptions:
    """Return the options of `add_judging_options`."""
    from cadcam.verify.inspection import InspectionOptions

    return InspectionOptions(reach_px=arguments.reach, alarms=arguments.alarms)


def tolerances_as_asked(arguments: argparse.Namespace) -> Tolerances | None:
    """Return what --tolerances names; None without it."""
    from cadcam.verify.tolerances.file import read_tolerances

    return None if arguments.tolerances is None else read_tolerances(arguments.tolerances)


def edged(mesh: Mesh) -> Part:
    """Return the part with its edges."""
    from cadcam.locate.part import Part

    with working("finding edges"):
        return Part.of(mesh)


def part_to_judge(arguments: argparse.Namespace, mesh: Mesh, tolerances: Tolerances | None) -> tuple[Part, Tolerances]:
    """Return the part, and its tolerances: those given, which must name what it has, or all bodies without limits."""
    from cadcam.verify.tolerances.tolerance import whole_parts

    if tolerances is not None:
        with _in_file(arguments.tolerances):
            tolerances.check_names(mesh.part_names)  # before edges are found, which takes long in large models
    part = edged(mesh)
    tolerances = whole_parts(part.scene) if tolerances is None else tolerances
    with _in_file(arguments.tolerances):
        tolerances.check(part.scene)
    return part, tolerances


@contextmanager
def _in_file(path: str | None) -> Iterator[None]:
    """Let errors say in which file, if any, the names stand that they are about."""
    try:
        yield
    except CadcamError as error:
        if path is None:
            raise
        raise UnreadableFile(path, str(error)) from None


def origin_of(
    arguments: argparse.Namespace, shots: Shots, files: Sequence[tuple[str, str, str]], *, part: str, serial: str
) -> VerificationOrigin:
    """Return what a report says of where it comes from; files: `judged_by`."""
    from cadcam.record.record import Source
    from cadcam.report.camera import camera_words
    from cadcam.report.verify.json import VerificationOrigin

    cameras = tuple(
        f"{p.viewpoint.name}: {camera_words(p.camera)}" + ("" if white is None else f"; white is {white:g}")
        for p, white in zip(shots.photos, shots.whites, strict=True)
    )
    return VerificationOrigin(
        part,
        tuple(Source(*one) for one in (*shots.files, *files)),
        cameras,
        serial,
        arguments.station or "",
        photos=shots.read,
    )


def judged_by(arguments: argparse.Namespace, cad: LoadReport) -> list[tuple[str, str, str]]:
    """Return role, path and sha256 of the files that parts are judged by: the model, and the tolerances, if any."""
    from cadcam.files.text import read_text

    files = [("cad", cad.path, cad.sha256)]
    if arguments.tolerances is not None:
        files.append(("tolerances", arguments.tolerances, read_text(arguments.tolerances).sha256))
    return files
