"""`cadcam render --poses`: one model and camera, many poses, one file each; existing files are kept."""

from __future__ import annotations

import argparse
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import refuse
from cadcam.cli.cameras import read_any_camera
from cadcam.cli.looks import scene_as_asked
from cadcam.cli.models import load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, progress, say
from cadcam.cores import usable_cores
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.camera.camera import Camera
    from cadcam.cli.channels import Output
    from cadcam.geometry.rigid import Rigid


@dataclass(frozen=True, slots=True, eq=False)
class PictureToMake:
    """A picture to make: the pose's name, camera_from_world, the file."""

    name: str
    pose: Rigid
    path: str


def run_batch(arguments: argparse.Namespace, suffixes: Sequence[str]) -> None:
    """Render every pose without a file, write, report."""
    _check_options(arguments)
    from cadcam.files.camera import camera_as_json
    from cadcam.files.poses import read_poses

    camera = read_any_camera(arguments.camera).camera
    shots = shots_of(arguments.output, read_poses(arguments.poses))
    _check_targets(shots, suffixes)
    kept = [] if arguments.overwrite else [shot.path for shot in shots if Path(shot.path).exists()]
    there = set(kept)
    todo = [shot for shot in shots if shot.path not in there]
    mesh, report = load_as_asked(arguments)
    scene = scene_as_asked(arguments, mesh)
    from cadcam.cli.channels import output_of

    said = []
    if todo:
        output = output_of(arguments, scene, [shot.pose for shot in shots])
        with progress("rendering", len(todo)) as step:
            for one in written(output, camera, todo, threads=arguments.threads or usable_cores()):
                said.append(one)
                step()
    if arguments.json:
        document = {"channel": arguments.channel, "written": said, "kept": kept}
        print_json(document | {"model": model_as_json(report, mesh), "camera": camera_as_json(camera)})
    else:
        _say(said, kept)


def shots_of(pattern: str, poses: Mapping[str, Rigid]) -> list[PictureToMake]:
    """Return the pictures of a pattern such as views/{name}.png or {index:04d}.png; each has its own file."""
    shots = []
    for index, (name, pose) in enumerate(poses.items()):
        if "{name" in pattern and (name in ("", ".", "..") or set(name) & set("/\\:\0")):
            raise BadValue("pose name", repr(name), "one that can be part of a file's name, or {index} in --output")
        try:
            path = pattern.format(name=name, index=index)
        except (LookupError, ValueError, AttributeError) as error:
            raise BadValue("--output", f"{pattern!r} ({error})", "a pattern with {name} or {index:04d}") from None
        shots.append(PictureToMake(name, pose, path))
    paths = [shot.path for shot in shots]
    twice = next((path for path in paths if paths.count(path) > 1), None) if len(set(paths)) < len(paths) else None
    if twice is not None:
        raise BadValue("--output", f"{pattern!r}: several poses would be {twice}", "a pattern with {name} or {index}")
    return shots


def written(
    output: Output, camera: Camera, shots: Sequence[PictureToMake], *, threads: int
) -> Iterator[dict[str, Any]]:
    """Yield the report on each file, in order, once it is written; files are encoded while the next are rendered."""

    def write(shot: PictureToMake, frame: Any) -> dict[str, Any]:
        said = {"output": shot.path, "name": shot.name, "empty": output.empty(frame)}
        return said | output.write(shot.path, frame)

    under_way: deque[Future[dict[str, Any]]] = deque()
    with ThreadPoolExecutor(threads) as pool:
        for shot, frame in zip(shots, output.frames(camera, [shot.pose for shot in shots]), strict=True):
            under_way.append(pool.submit(write, shot, frame))
            if len(under_way) > threads:
                yield under_way.popleft().result()
        while under_way:
            yield under_way.popleft().result()


def _check_options(arguments: argparse.Namespace) -> None:
    if arguments.camera is None:
        raise BadValue("--poses", "given without --camera", "both: poses do not say the focal length")
    refuse(arguments, "--pose", why="beside --poses", expected="one of them")
    refuse(arguments, "--view", "--size", why="beside --poses", expected="neither: camera and poses decide")


def _check_targets(shots: Sequence[PictureToMake], suffixes: Sequence[str]) -> None:
    """Check one file in each folder: the others differ only in name."""
    one_a_folder = {Path(shot.path).parent: shot.path for shot in shots}
    for path in one_a_folder.values():
        check_target(path, suffixes)


def _say(said: Sequence[Mapping[str, Any]], kept: Sequence[str]) -> None:
    there = f", {len(kept)} were there already (--overwrite renders them again)" if kept else ""
    print(f"{len(said)} pictures written{there}")
    if said and "depth_mm_per_step" in said[0]:
        print(f"{said[0]['depth_mm_per_step']:g} mm a step in all of them, 0 for the background")
    empty = [str(one["name"]) for one in said if one["empty"]]
    if empty:
        names = ", ".join(empty[:5]) + (" ..." if len(empty) > 5 else "")
        say(f"{len(empty)} of them show nothing of the model: {names}")
