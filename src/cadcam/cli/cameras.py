"""Cameras on the command line: internals from a camera file, the pose from it, a pose file or points."""

from __future__ import annotations

import argparse
from os import fsencode
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.output import say
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera
    from cadcam.files.camera import CameraFile
    from cadcam.geometry.rigid import Rigid

POSE_HELP = """\
pose file: a first line '# camera_from_world, mm' (or world_from_camera; or m, in ...), then a 3x4 or 4x4 matrix. Or
where the part was found: JSON of `cadcam locate --pose-out`, or such a matrix of world_from_part or camera_from_part.
"""


def camera_and_pose(camera_file: str, pose_file: str | None, *, else_: str = "--pose FILE") -> tuple[CameraFile, Rigid]:
    """Return the contents of a camera file, ours or another program's, and its pose unless a pose file says another.

    else_: the verb's options in place of a camera file with its pose, as named where there is none.
    """
    from cadcam.files.pose_estimate import read_view_pose

    known = read_any_camera(camera_file)
    pose = known.camera_from_world
    if pose_file:
        pose = read_view_pose(pose_file, camera_from_world=pose)
    if pose is None:
        raise BadValue(f"the pose in {camera_file}", "missing", f"a camera file with camera_from_world, or {else_}")
    return known, pose


def read_any_camera(camera_file: str) -> CameraFile:
    """Return the contents of a camera file, ours or another program's."""
    from cadcam.files.camera import read_camera

    return _foreign(camera_file) or read_camera(camera_file)


class CameraFiles:
    """Camera files that are read once: what they have been read as, by content.

    A file given twice is one calibration, whose errors its views share, under whatever names: another spelling of the
    path, a link, a copy. Two calibrations never have the same bytes, since a file holds the pixels it was made from.
    """

    def __init__(self) -> None:
        self._read: dict[str, CameraFile] = {}

    def read(self, camera_file: str) -> CameraFile:
        """Return the contents of a camera file, ours or another program's: the same object for the same content."""
        content = hash_of(camera_file)
        if content not in self._read:
            self._read[content] = read_any_camera(camera_file)
        return self._read[content]


def hash_of(path: str) -> str:
    """Return the SHA-256 of a file's content; of the path where it names a folder, or nothing."""
    from hashlib import sha256

    from cadcam.files.text import read_bytes

    return sha256(read_bytes(path) if Path(path).is_file() else fsencode(path)).hexdigest()


def _foreign(camera_file: str) -> CameraFile | None:
    """Return the contents of another program's camera file; None for ours, and for what can only be ours."""
    from cadcam.errors import UnreadableFile
    from cadcam.files.camera import CameraFile
    from cadcam.files.foreign.registry import NAMES, format_of, read_cameras
    from cadcam.files.foreign.source import ForeignFile

    try:
        if format_of(ForeignFile(camera_file)).name == "cadcam":
            return None
    except UnreadableFile:
        if not Path(camera_file).is_file() or Path(camera_file).read_bytes()[:64].lstrip()[:1] in (b"", b"{"):
            return None
        raise UnreadableFile(
            camera_file,
            "is no camera file known by its content",
            f"give one of {', '.join(NAMES)} (docs/camera-formats.md), or make one: cadcam calibrate",
        ) from None
    found = read_cameras(camera_file)
    for note in found.notes:
        say(f"{camera_file}: {note}")
    first = found.cameras[0]
    if any(named.camera is not first.camera for named in found.cameras):
        raise BadValue(
            f"number of cameras in {camera_file}",
            len(found.cameras),
            "one: cadcam convert --camera-name NAME makes a file of it",
        )
    return CameraFile(first.camera, first.camera_from_world if len(found.cameras) == 1 else None)


def add_camera_options(parser: argparse.ArgumentParser, *, required: bool) -> None:
    """Add the camera file and the pose file."""
    parser.add_argument(
        "--camera", metavar="FILE", required=required, help="camera file, best with its pose; or another program's"
    )
    parser.add_argument("--pose", metavar="FILE", help="pose of the camera, if not that of its file (see below)")


def view_as_json(camera: Camera, camera_from_world: Rigid) -> dict[str, Any]:
    """Return camera and pose in a camera file's form."""
    from cadcam.files.camera import camera_as_json

    return camera_as_json(camera, camera_from_world=camera_from_world)
