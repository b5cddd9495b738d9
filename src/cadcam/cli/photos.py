"""Pictures on the command line: their files; photos with the cameras that took them, one, several, or a rig."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path
from typing import TYPE_CHECKING

from cadcam.cli.cameras import CameraFiles, hash_of
from cadcam.cli.output import say, working
from cadcam.cli.whites import add_full_scale, white_as_asked
from cadcam.errors import BadValue, UnknownName, UnreadableFile
from cadcam.image.suffixes import READABLE

if TYPE_CHECKING:
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.files.camera import CameraFile
    from cadcam.geometry.rigid import Rigid
    from cadcam.image.picture import PictureInfo
    from cadcam.locate.photo import Photo


@dataclass(frozen=True, slots=True, eq=False)
class Shots:
    """Photos, the files they and their cameras came from with their hashes (role, path, sha256), and the stated pose.

    camera_from_world: of the one camera whose file says where it stands; else None. whites: of each photo, the stored
    value of white that its camera's photos share (`image.camera_picture`), or None. read: how each photo was read.
    """

    photos: tuple[Photo, ...]
    files: tuple[tuple[str, str, str], ...]
    camera_from_world: Rigid | None
    whites: tuple[float | None, ...]
    read: tuple[PictureInfo, ...]


def add_photo_options(parser: argparse.ArgumentParser) -> None:
    """Add the camera files and the rig."""
    parser.add_argument(
        "--camera",
        action="append",
        default=[],
        metavar="FILE",
        help="camera file; several photos: one for each, in their order, each with the camera's pose",
    )
    parser.add_argument(
        "--rig",
        metavar="FILE",
        help="rig file of `cadcam rig`, in place of --camera; name photos as its cameras: left.png, left=1.png",
    )
    add_full_scale(parser)


def picture_files(paths: Sequence[str]) -> list[str]:
    """Return the files of paths, patterns and folders of pictures, each once, in order. Raises `UnreadableFile`."""
    files: list[str] = []
    for path in paths:
        if Path(path).is_dir():
            inside = sorted(str(p) for p in Path(path).iterdir() if p.suffix.lower() in READABLE)
            if not inside:
                raise UnreadableFile(path, "is a folder without pictures", f"pictures end in {' '.join(READABLE)}")
            files += inside
        elif any(c in path for c in "*?[") and not Path(path).exists():
            matching = sorted(glob(path))  # noqa: PTH207 - a pattern with a folder in it, as a shell has them
            if not matching:
                raise UnreadableFile(path, "no file has such a name", "check the folder and the pattern")
            files += matching
        else:
            files.append(path)
    return list(dict.fromkeys(files))


def read_shots(paths: Sequence[str], arguments: argparse.Namespace) -> Shots:
    """Return the photos with their cameras; the world is the rig's, that of the camera files, or one camera's own."""
    viewpoints, said = viewpoints_of(paths, arguments.camera, arguments.rig)
    files = [file_of(path) for path in paths]
    return shots_by(viewpoints, said, files, _whites(files, arguments), camera_sources(arguments))


def shots_by(
    viewpoints: Sequence[Viewpoint],
    camera_from_world: Rigid | None,
    files: Sequence[str],
    whites: Sequence[float | None],
    sources: Sequence[tuple[str, str, str]],
) -> Shots:
    """Return the photos in files, one by each camera; whites, camera_from_world: see `Shots`.

    sources: the cameras' own files.
    """
    each = zip(files, viewpoints, whites, strict=True)
    photos, read = zip(*(_photo(*one) for one in each), strict=True)
    of = [("photo", info.path, info.sha256) for info in read]
    return Shots(photos, (*of, *sources), camera_from_world, tuple(whites), read)


def camera_sources(arguments: argparse.Namespace) -> list[tuple[str, str, str]]:
    """Return role, path and hash of the files that cameras came from."""
    files = (
        [("rig", arguments.rig)] if arguments.rig else [("camera", file) for file in dict.fromkeys(arguments.camera)]
    )
    return [(role, path, hash_of(path)) for role, path in files]


def _whites(files: Sequence[str], arguments: argparse.Namespace) -> list[float | None]:
    """Return the white of each photo: one for all, which may be of one camera that was moved; of a rig one a camera."""
    if arguments.rig and arguments.full_scale is None:
        return [white_as_asked(arguments, [file]) for file in files]
    return [white_as_asked(arguments, files)] * len(files)


def viewpoints_of(
    paths: Sequence[str], cameras: Sequence[str], rig: str | None
) -> tuple[list[Viewpoint], Rigid | None]:
    """Return the camera of each photo, folder or video, and camera_from_world of a single one whose file gives it."""
    if not cameras and not rig:
        raise BadValue("--camera", "not given", "one --camera a photo, or --rig FILE")
    if cameras and rig:
        raise BadValue("--camera", "given beside --rig", "one of them: a rig file holds its cameras")
    if rig:
        return _of_rig(paths, rig), None
    if len(cameras) != len(paths):
        times = "once" if len(cameras) == 1 else f"{len(cameras)} times"
        given = f"given {times} for {len(paths)} photos ({', '.join(paths)})"
        raise BadValue("--camera", given, "one for each photo; the last file is the CAD model")
    return _of_files(paths, cameras)


def file_of(path: str) -> str:
    """Return the file of a photo given as NAME=FILE or FILE."""
    return _named(path)[1]


def _named(path: str) -> tuple[str, str]:
    """Return the camera's name and the file of NAME=FILE or FILE, named as its camera; FILE may have a = of its own."""
    name, equals, file = path.partition("=")
    return (name, file) if equals and file and not Path(path).exists() else (Path(path).stem, path)


def _of_rig(paths: Sequence[str], rig: str) -> list[Viewpoint]:
    from cadcam.files.rig import read_rig
    from cadcam.locate.photo import EDGE_PX

    known = {v.name: v for v in read_rig(rig).viewpoints(sigma_px=EDGE_PX)}
    out = []
    for path in paths:
        name, _ = _named(path)
        if name not in known:
            raise UnknownName(f"camera of photo {path} in {rig}:", name, known)
        out.append(known[name])
    return out


def _of_files(paths: Sequence[str], cameras: Sequence[str]) -> tuple[list[Viewpoint], Rigid | None]:
    from cadcam.camera.viewpoint import Viewpoint
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.photo import EDGE_PX

    out, said = [], None
    files = CameraFiles()  # photos of one camera share its errors
    for name, file in zip(_told_apart([file_of(path) for path in paths]), cameras, strict=True):
        known = files.read(file)
        if len(paths) > 1 and known.camera_from_world is None:
            raise BadValue(f"the pose in {file}", "missing", "camera files with camera_from_world, or --rig FILE")
        if len(paths) == 1:  # its pose at calibration does not matter: its own frame is the world
            said = known.camera_from_world
            if known.estimate is not None:
                out.append(Viewpoint.placed(name, known.estimate, Rigid(), sigma_px=EDGE_PX))
            else:
                out.append(Viewpoint.exact(name, known.camera, Rigid(), sigma_px=EDGE_PX))
        elif known.estimate is not None:
            out.append(Viewpoint.fixed(name, known.estimate, sigma_px=EDGE_PX))
        else:
            place = Rigid() if known.camera_from_world is None else known.camera_from_world
            out.append(Viewpoint.exact(name, known.camera, place, sigma_px=EDGE_PX))
    _say_exact([file for file in dict.fromkeys(cameras) if _pose_alone(files.read(file))], alone=len(paths) == 1)
    return out, said


def _pose_alone(known: CameraFile) -> bool:
    return known.estimate is not None and known.estimate.pose_alone


def _say_exact(files: Sequence[str], *, alone: bool) -> None:
    """Say which camera files hold a pose found with a known camera: its own errors are not in them."""
    if not files:
        return
    way = (
        f"give the calibration that it was found with: --camera CALIBRATION --start {files[0]}"
        if alone
        else "from Python, Viewpoint.located(name, calibration, pose) adds their errors"
    )
    say(f"{', '.join(files)}: a pose alone: results are as if the camera's own numbers were exact; {way}")


def _told_apart(files: Sequence[str]) -> list[str]:
    """Return the files' names, each with as many of its folders as tell all apart: left/0008.jpg, right/0008.jpg."""
    names, parts = [Path(file).name for file in files], [Path(file).parts for file in files]
    for n in range(2, max(map(len, parts)) + 1):
        if len(set(names)) == len(names):
            break
        names = [Path(*p[-n:]).as_posix() for p in parts]
    return names


def _photo(path: str, view: Viewpoint, white: float | None) -> tuple[Photo, PictureInfo]:
    from cadcam.image.camera_picture import read_camera_picture_with_info
    from cadcam.locate.photo import Photo
    from cadcam.render.overlay import fitting

    with working(f"reading {path}"):
        picture, info = read_camera_picture_with_info(path, full_scale=white)
    return Photo(fitting(picture, view.camera, name=path), view), info
