"""`cadcam decompose`: a 3x4 matrix or a camera file as eleven parameters, K, pose and OpenGL's values."""

from __future__ import annotations

import argparse
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import Verbs, add_json, real, refuse, size, verb
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.output import print_json, print_tables
from cadcam.errors import BadValue, CadcamError, UnreadableFile

if TYPE_CHECKING:
    from cadcam.files.camera import CameraFile
    from cadcam.report.table import Table

_CAMERA_FILES = (".json", ".yaml", ".yml", ".xml")
_EXAMPLES = """\
  cadcam decompose camera.json                            parameters with sigmas, K, pose, OpenGL
  cadcam decompose C.txt --rows uv --size 768x576         the dissertation's matrix: rows U (down), V (right), 1
  cadcam decompose P.txt --rows xy                        OpenCV's or a computer vision book's: rows x, y, 1
  cadcam decompose camera.json --near 200 --far 5000 --json
"""
_DESCRIPTION = """\
Take a camera apart: from a 3x4 projection matrix (a text file with three rows of four numbers, any scale and sign) or a
camera file, the eleven parameters of the extended pinhole (with standard deviations where the file knows them), the
camera matrix K, the pose camera_from_world, and the values for glFrustum, gluLookAt and glViewport beside the exact
4x4 matrices, which carry skew and aspect too. Lengths are in the world's unit (mm), angles in degrees."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "decompose",
        run,
        short="3x4 matrix or camera file -> eleven parameters, K, pose, OpenGL values",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument(
        "file", metavar="FILE", help="text file with a 3x4 matrix, or a camera file (.json, .yaml, .xml)"
    )
    parser.add_argument(
        "--rows",
        choices=("uv", "xy"),
        help="of a matrix, must be given: its rows are (U, V, 1) = (row, column, 1), or (x, y, 1)",
    )
    parser.add_argument("--size", type=size, metavar="WxH", help="picture size in px, for OpenGL's values of a matrix")
    parser.add_argument("--near", type=real, default=10.0, metavar="MM", help="near plane, mm (default 10)")
    parser.add_argument("--far", type=real, default=100_000.0, metavar="MM", help="far plane, mm (default 100000)")
    add_json(parser)


def run(arguments: argparse.Namespace) -> None:
    """Print tables or JSON."""
    known = _read(arguments)
    sized = arguments.size is not None or _is_camera_file(arguments.file)
    if not sized:
        refuse(arguments, "--near", "--far", why="without --size", expected="both: OpenGL's values need the picture")
    if known.camera_from_world is None:
        refuse(arguments, "--near", "--far", why="for a camera without a pose", expected="a camera file with its pose")
    if arguments.json:
        print_json(_document(known, arguments, sized=sized))
    else:
        print_tables(_tables(known, arguments, sized=sized))


def _is_camera_file(path: str) -> bool:
    return path.lower().endswith(_CAMERA_FILES)


def _read(arguments: argparse.Namespace) -> CameraFile:
    from cadcam.camera.extended_pinhole import ExtendedPinhole, uv_from_pixel_matrix
    from cadcam.files.camera import CameraFile
    from cadcam.files.matrix import read_matrix

    if _is_camera_file(arguments.file):
        says_both = "neither: the file says both"
        refuse(arguments, "--rows", "--size", why="beside a camera file", expected=says_both)
        return read_any_camera(arguments.file)
    matrix = read_matrix(arguments.file, rows=3, columns=4)
    if arguments.rows is None:
        raise BadValue(
            "--rows",
            "not given",
            "uv for a matrix with rows (U, V, 1) = (row, column, 1), as the dissertation has it, or xy for rows "
            "(x, y, 1), as OpenCV and textbooks have it; nothing in the numbers tells which",
        )
    try:
        pinhole = ExtendedPinhole.from_matrix(matrix if arguments.rows == "uv" else uv_from_pixel_matrix(matrix))
    except CadcamError as error:
        raise UnreadableFile(arguments.file, f"holds no camera: {error}") from None
    return CameraFile(pinhole.camera(arguments.size or (1, 1)), pinhole.camera_from_world)


def _tables(known: CameraFile, arguments: argparse.Namespace, *, sized: bool) -> list[Table]:
    from cadcam.camera.extended_pinhole import ExtendedPinhole
    from cadcam.report.camera import camera_table, opengl_tables, parameter_table, pinhole_table, pose_table

    camera, pose = known.camera, known.camera_from_world
    tables = [camera_table(camera, sized=sized)]
    if pose is None:
        return tables
    if known.estimate is not None:
        tables.insert(0, parameter_table(known.estimate))
    else:
        tables.insert(0, pinhole_table(ExtendedPinhole.from_camera(camera, pose)))
    tables.append(pose_table(pose))
    return [*tables, *(opengl_tables(camera, pose, near=arguments.near, far=arguments.far) if sized else [])]


def _document(known: CameraFile, arguments: argparse.Namespace, *, sized: bool) -> dict[str, Any]:
    from cadcam.camera.extended_pinhole import uv_matrix
    from cadcam.files.camera import camera_as_json, pinhole_as_json
    from cadcam.report.camera import opengl_as_json

    camera, pose = known.camera, known.camera_from_world
    document = camera_as_json(known.estimate or camera, camera_from_world=None if known.estimate else pose)
    if not sized:
        del document["size_px"]
    if pose is None:
        return document
    if known.estimate is None:
        document["parameters"] = pinhole_as_json(camera, pose)
    document["matrix_uv"] = uv_matrix(camera, pose).tolist()
    if sized:
        document["opengl"] = opengl_as_json(camera, pose, near=arguments.near, far=arguments.far)
    return document
