"""`cadcam convert`: a camera file of one program -> that of another, and what is lost on the way."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, names, real, refuse, size, verb
from cadcam.cli.other_pictures import add_picture_options, convert_rig, for_other_pictures, rig_as_cameras
from cadcam.cli.output import print_json, print_tables, say
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.files.foreign.model import Foreign, Format, NamedCamera
    from cadcam.files.foreign.registry import Written
    from cadcam.report.table import Table

_EXAMPLES = """\
  cadcam convert intrinsics.yml -                                 what is in it, and which format it is
  cadcam convert intrinsics.yml camera.json                       OpenCV (found by the content) to ours
  cadcam convert camera.json cameras.yaml --to ros                .yaml is many things: say which
  cadcam convert camera.json sparse/0 --to colmap --unit m        a folder; lengths in m
  cadcam convert camera.json cam.dat --to halcon --fit            the nearest HALCON lens, its error in px told
  cadcam convert skewed.json camera.yml --to opencv --allow-loss skew
  cadcam convert sparse/0 view7.json --camera-name IMG_0007.jpg --unit m
  cadcam convert camera.json half.json --resize 1224x1024         for photos scaled after the calibration
  cadcam convert camera.json binned.json --binning 2              for photos taken with 2 x 2 pixels binned
  cadcam convert camera.json roi.json --crop 400,200,1024x768     for photos of a region of interest
  cadcam convert rig.json small.json --binning 2                  all cameras of a rig, or --camera-name left alone

formats: cadcam opencv ros colmap colmap-bin kalibr mrcal bop nerfstudio metashape halcon visp blender gltf usd.
Each is read by its content. By the suffix of OUT alone are written: .json cadcam, .cameramodel mrcal, .dat .cal halcon,
.py blender, .gltf gltf, .usda usd. What each can hold: docs/camera-formats.md

other pictures: the lens is the same; focal length, principal point and the covariance follow. --resize maps the outline
on the outline; --binning drops columns and rows left over, as sensors do; --crop counts px of the whole picture, from
(0, 0), its top-left pixel. One at a time: convert the result again for two of them.
"""
_WRITING = ("--pixel-pitch", "--allow-loss", "--fit")
_LEAST_UM, _MOST_UM = 0.1, 1000.0  # of a pixel: less than the wavelength of light, and far above any detector's
_DESCRIPTION = """\
Read a camera with its pose from one program's file and write it for another: every half pixel, axis, unit and lens
term by the rules of both. What the new format cannot hold is said on stderr. If that moves pixels (lens, skew, aspect,
principal-point), nothing is written and the exit code is 2, unless --allow-loss accepts it by name or --fit replaces
the lens. The result is read back before it is written.
--resize, --binning and --crop make it the camera of pictures that were scaled, binned or cut after the calibration; of
a rig file the cameras of all its pictures, or of those named by --camera-name."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "convert",
        run,
        short="camera files of OpenCV, ROS, COLMAP, HALCON ... to and from each other, and to other picture sizes",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("input", metavar="IN", help="camera file, or the folder of a format that is one")
    parser.add_argument(
        "output", metavar="OUT", help="file or folder to write; - writes nothing and tells what IN holds"
    )
    parser.add_argument("--from", dest="source_format", metavar="FORMAT", help="IN's format, if its content misleads")
    parser.add_argument("--to", dest="target_format", metavar="FORMAT", help="OUT's format, if its suffix does not say")
    parser.add_argument(
        "--camera-name",
        action="append",
        default=[],
        metavar="NAME",
        help="only this camera of IN, by its name or number from 0; of a rig, those whose pictures are others: "
        "may be repeated",
    )
    parser.add_argument("--size", type=size, metavar="WxH", help="picture size in px, where IN has none")
    parser.add_argument(
        "--unit", metavar="U", help="unit of length of formats that have none of their own: mm (default), m, in ..."
    )
    parser.add_argument(
        "--pixel-pitch",
        type=real,
        metavar="UM",
        help="pixel pitch in um, for formats with a sensor (HALCON, Blender, USD)",
    )
    parser.add_argument(
        "--allow-loss",
        type=names,
        default=(),
        metavar="NAMES",
        help="accept these losses: lens, skew, aspect, principal-point (with commas), or all",
    )
    parser.add_argument("--fit", action="store_true", help="replace a lens without a place by the nearest with one")
    add_picture_options(parser)
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Read, report, write."""
    from cadcam.files.foreign.registry import format_named, read_cameras
    from cadcam.files.rig import is_rig

    _check_options(arguments)
    if is_rig(arguments.input):
        _run_rig(arguments)
        return
    if len(arguments.camera_name) > 1:
        raise BadValue(
            "--camera-name", f"given {len(arguments.camera_name)} times", "once: several are named of a rig alone"
        )
    found = read_cameras(
        arguments.input,
        format_name=arguments.source_format,
        size=arguments.size,
        unit=_unit_of_input(arguments),
    ).named(arguments.camera_name[0] if arguments.camera_name else None)
    for note in found.notes:
        say(f"{arguments.input}: {note}")
    found = for_other_pictures(arguments, found)
    written = None if arguments.output == "-" else _write(arguments, found)
    if arguments.json:
        print_json(_document(found, written))
    elif written is None:
        print_tables([_table(found, format_named(found.format).title)])


def _run_rig(arguments: argparse.Namespace) -> None:
    rig = convert_rig(arguments)
    if arguments.json:
        from cadcam.files.rig import rig_as_json

        print_json(rig_as_json(rig))
    elif arguments.output == "-":
        print_tables([_table(rig_as_cameras(rig), "rig")])


def _check_options(arguments: argparse.Namespace) -> None:
    from cadcam.errors import UnknownName
    from cadcam.files.foreign.model import PIXEL_LOSSES

    for name in arguments.allow_loss:
        if name not in (*PIXEL_LOSSES, "all"):
            raise UnknownName("loss", name, (*PIXEL_LOSSES, "all"))
    if arguments.output == "-":
        refuse(arguments, *_WRITING, why="where nothing is written", expected="a file in place of -, or leave it out")
    pitch = arguments.pixel_pitch
    if pitch is not None and not _LEAST_UM <= pitch <= _MOST_UM:
        raise BadValue(
            "--pixel-pitch", f"{pitch:g}", f"a pixel's pitch from {_LEAST_UM:g} to {_MOST_UM:g} um, such as 3.45"
        )


def _refuse_unit(arguments: argparse.Namespace, formats: Sequence[Format]) -> None:
    """Refuse --unit where every format involved has a unit of its own."""
    if all(form.unit is not None for form in formats):
        units = " and ".join(dict.fromkeys(f"{form.title} is in {form.unit}" for form in formats))
        refuse(arguments, "--unit", why="where nothing is left to it", expected=f"none: {units} by its rules")


def _unit_of_input(arguments: argparse.Namespace) -> str | None:
    """Return --unit unless IN's format has a unit of its own: then it is meant for OUT."""
    from cadcam.files.foreign.registry import format_named, format_of
    from cadcam.files.foreign.source import ForeignFile

    if arguments.unit is None:
        return None
    named = arguments.source_format
    form = format_named(named) if named else format_of(ForeignFile(arguments.input))
    target = [] if arguments.output == "-" else [_target_format(arguments)]
    _refuse_unit(arguments, [form, *target])
    return arguments.unit if form.unit is None else None


def _target_format(arguments: argparse.Namespace) -> Format:
    from cadcam.files.foreign.registry import format_for, format_named

    return format_named(arguments.target_format) if arguments.target_format else format_for(arguments.output)


def _write(arguments: argparse.Namespace, found: Foreign) -> Written:
    from cadcam.files.foreign.registry import write_cameras

    form = _target_format(arguments)
    written = write_cameras(
        arguments.output,
        found,
        format_name=form.name,
        unit=arguments.unit if form.unit is None else None,
        pixel_mm=None if arguments.pixel_pitch is None else arguments.pixel_pitch / 1000,
        allow_loss=arguments.allow_loss,
        fit=arguments.fit,
    )
    for line in (*written.notes, *(f"lost: {loss}" for loss in written.losses)):
        say(f"{arguments.output}: {line}")
    rounding = f"read back, no pixel is off by more than {written.read_back_px:.1g} px"
    say(f"wrote {', '.join(written.paths)} ({form.title}; {rounding})")
    return written


def _table(found: Foreign, what: str) -> Table:
    from cadcam.report.table import Table, counted

    rows = tuple(_row(named) for named in found.cameras)
    columns = ("camera", "size px", "fx px", "fy px", "cx px", "cy px", "skew px", "lens", "stands at mm")
    return Table(f"{what}: {counted(len(rows), 'camera')}", columns, rows, left=("camera", "lens"))


def _row(named: NamedCamera) -> tuple[str, ...]:
    import numpy as np

    c = named.camera
    terms = " ".join(f"{name} {value:.4g}" for name, value in c.lens.parameters.items() if value)
    pose = named.camera_from_world
    decimals = 1 if pose is None or np.linalg.norm(pose.origin) >= 10 else 4  # of lengths in m that are taken as mm
    place = "" if pose is None else ", ".join(f"{x:.{decimals}f}" for x in np.round(pose.origin, decimals) + 0.0)
    numbers = (f"{x:.3f}" for x in (c.fx, c.fy, *c.principal_point, c.skew))
    return (named.name, f"{c.width} x {c.height}", *numbers, f"{c.lens.name} {terms}".strip(), place)


def _document(found: Foreign, written: Written | None) -> dict[str, Any]:
    from cadcam.files.camera import camera_as_json
    from cadcam.files.jsontext import or_null

    cameras = [
        {"name": named.name, **camera_as_json(named.camera, camera_from_world=named.camera_from_world)}
        for named in found.cameras
    ]
    document: dict[str, Any] = {"format": found.format, "notes": list(found.notes), "cameras": cameras}
    if written is not None:
        document["written"] = {
            "format": written.format,
            "files": list(written.paths),
            "losses": [{"what": loss.what, "text": loss.text, "px": or_null(loss.px)} for loss in written.losses],
            "read_back_px": written.read_back_px,
        }
    return document
