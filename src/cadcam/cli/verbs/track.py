"""`cadcam track`: a folder of pictures or a video and a CAD model -> the part's pose in each frame."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO, Verbs, add_json, refuse, verb
from cadcam.cli.locating import (
    START_HELP,
    VIEW_OPTIONS,
    VIEWS_HELP,
    add_start_options,
    add_view_options,
    aspects_kept,
    freedom_as_asked,
    overlaid,
    part_as_asked,
    prepare,
    start_as_asked,
    views_as_asked,
)
from cadcam.cli.models import add_model_options, check_order, load_as_asked
from cadcam.cli.output import (
    check_folder,
    check_target,
    print_json,
    print_tables,
    progress,
    refuse_own_folder,
    say,
    say_written,
    working,
)
from cadcam.cli.photos import add_photo_options, file_of, viewpoints_of
from cadcam.cli.whites import check_counts, say_pages, say_white
from cadcam.cli.wires import LOOKS, add_line_options

if TYPE_CHECKING:
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.part import Part
    from cadcam.locate.track.frames import Frame, Frames
    from cadcam.locate.views.view_range import ViewRange

_EXAMPLES = f"""\
  cadcam track frames/ part.obj --unit m --camera camera.json --start first.txt -o track.jsonl --csv track.csv
  cadcam track film.mp4 part.step --camera camera.json -o track.jsonl --overlays seen/
  cadcam track left/ right/ part.stl --camera left.json --camera right.json -o track.jsonl
  cadcam track left=one.mp4 right=two.mp4 part.stl --rig rig.json -o track.jsonl
  cadcam track 'shots/*.png' part.stl --camera camera.json --points picked.csv -o track.jsonl
  cadcam track frames/ part.stl --camera camera.json --seen-from above --distance 800,1500 -o track.jsonl

{START_HELP}
{VIEWS_HELP}
frames: a folder of pictures in the order of the numbers in their names, a pattern, or a video (cadcam[video]). With
several cameras, their n-th pictures must have been taken together.

The log (-o) gets one line of JSON per frame, on disk before the next frame is read: found, quality, and two poses with
covariances.
  "pose"        what this frame's pictures show: the part's edges, and the texture of its faces as learned from earlier
                frames (with --no-print edges alone: then no other frame enters). A sudden motion is followed at once.
                Measure with it.
  "filtered"    combines it with all earlier frames (constant velocity, with accelerations as large as this part has
                shown): steadier, and better where a frame shows little, but late where the motion changes. Guide and
                draw with it.

Run the same command again to continue after the last complete line; other pictures, part, cameras, start or range of
views are refused. --csv writes a table for spreadsheets: of "pose", with --smooth of "filtered".

how the part was found in a frame ("how" in log and table):
  followed      by its texture
  predicted     near the pose that its motion predicts
  kept          around the last pose
  recovered     searched for around the last pose (or the start)
  searched      searched for without a start, within the range of views
  lost          not found; if it stays lost it is searched for less and less often, in the end every eighth frame

exit code: 0, or 3 where the part was found in no frame."""
_DESCRIPTION = """\
Follow a part through pictures. The texture of its surface and its motion predict where to look in the next frame, and
how far around. A part that is lost is reported as lost, and searched for again."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "pictures or a video + CAD model + camera -> where the part is in each frame"
    parser = verb(verbs, "track", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "frames",
        nargs="+",
        metavar="FRAMES",
        help="folder of pictures, pattern such as 'left/*.png', or video; one per camera",
    )
    add_model_options(parser)
    add_photo_options(parser)
    add_start_options(parser)
    add_view_options(parser, when="without a start, and for a part that stays lost")
    parser.add_argument(
        "--no-velocity", action="store_true", help="predict that the part stays where it was, instead of moving on"
    )
    parser.add_argument(
        "--no-print", action="store_true", help="edges alone: do not learn and follow the texture of the faces"
    )
    group = parser.add_argument_group("results")
    group.add_argument("-o", "--output", metavar="FILE", required=True, help="log: .jsonl, one line per frame")
    group.add_argument("--csv", metavar="FILE", help="the same as a table: .csv")
    group.add_argument("--smooth", action="store_true", help="table and overlays show the filtered poses")
    group.add_argument("--overlays", metavar="FOLDER", help="write each frame with the model's lines on it")
    group.add_argument("--overwrite", action="store_true", help="start a new log where there is a track log already")
    add_line_options(parser, color_by="one")
    parser.set_defaults(resumes=True)
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Track, log, print a summary; return the exit code."""
    from cadcam.locate.track.frames import Frames
    from cadcam.locate.track.log import TrackLog, head_of, track_part_to_log

    _check_options(arguments)
    viewpoints, said = viewpoints_of(arguments.frames, arguments.camera, arguments.rig)
    start, freedom = start_as_asked(arguments, viewpoints, said), freedom_as_asked(arguments)
    if freedom.basis.shape[1] < 6:
        alone = "one of them: such a part is looked for around its start alone"
        refuse(arguments, *VIEW_OPTIONS, why="beside --freedom", expected=alone)
    views = views_as_asked(arguments, said)
    frames = Frames([file_of(path) for path in arguments.frames], viewpoints, full_scale=arguments.full_scale)
    refuse_own_folder(arguments.overlays, frames.files)
    for gap in frames.gaps:
        say(gap)
    _settle_white(arguments, frames)
    mesh, _ = load_as_asked(arguments)
    part = part_as_asked(arguments, mesh)
    if start is None:
        start = _at_the_world(part, frames, said, freedom, views)
    how: dict[str, Any] = {
        "freedom": freedom,
        "velocity": not arguments.no_velocity,
        "texture": not arguments.no_print,
        "views": views,
    }
    head = head_of(part, frames.viewpoints, start, **how)
    kept: dict[str, Any] = {"table": arguments.csv, "filtered": arguments.smooth, "overwrite": arguments.overwrite}
    with TrackLog.open(arguments.output, head, **kept) as log, aspects_kept(part):
        if log.entries and not arguments.json:
            say(f"{len(log.entries)} frames are in {arguments.output}; going on")
        if start is None and not log.entries:
            prepare(part, [viewpoint.camera for viewpoint in viewpoints], views)
        with progress("tracking", frames.count or 0) as step:
            there = {entry["frame"] for entry in log.entries}
            for frame, entry in track_part_to_log(log, part, frames, start, **how):
                if arguments.overlays:
                    _write_overlay(arguments, part, frame, entry, anew=frame.index not in there)
                step()
        entries = log.entries
    if frames.count and len(entries) < frames.count:  # of a video that breaks off or is damaged
        whole = f"{len(entries)} of the {frames.count} frames that it says it has could be decoded"
        say(f"{frames.sources[0]}: {whole}; is it damaged or cut off?")
    _report(arguments, entries)
    return 0 if any(entry["found"] for entry in entries) else NO


def _at_the_world(
    part: Part, frames: Frames, camera_from_world: Rigid | None, freedom: Freedom, views: ViewRange
) -> Rigid | None:
    """Return the pose that a camera's file states as a start, if the first frame shows the part there; or None.

    A motion that is restricted has no other start.
    """
    from cadcam.cli.locating import at_the_world
    from cadcam.locate.usable import faults_in

    if not freedom.full:
        return camera_from_world
    first = next(iter(frames), None) if camera_from_world is not None else None
    if first is None:
        return None
    faults = faults_in(first.photos)
    usable = [photo for k, photo in enumerate(first.photos) if k not in faults]
    there = at_the_world(part, usable, camera_from_world, freedom, views) if usable else None
    return None if there is None else camera_from_world


def _check_options(arguments: argparse.Namespace) -> None:
    check_order(arguments.frames, arguments.model, frames=True)
    check_target(arguments.output, (".jsonl",))
    check_target(arguments.csv, (".csv",))
    if arguments.overlays:
        check_folder(arguments.overlays)
    else:
        refuse(arguments, *LOOKS, why="where no lines are drawn", expected="--overlays FOLDER beside it")
        if not arguments.csv:
            shown = "--csv FILE or --overlays FOLDER beside it: the log holds both poses"
            refuse(arguments, "--smooth", why="where no pose is shown", expected=shown)


def _settle_white(arguments: argparse.Namespace, frames: Frames) -> None:
    """Find what is white in the pictures of each camera, and say so; refuse a white that counts for none of them."""
    say_pages(frames.files)
    if arguments.full_scale is not None:
        check_counts(arguments.full_scale, frames.pictures)
        return
    with working("reading how bright all pictures are"):
        found = frames.full_scales
    for source, white in zip(frames.sources, found, strict=True):
        say_white(source, white)


def _write_overlay(
    arguments: argparse.Namespace, part: Part, frame: Frame, entry: dict[str, Any], *, anew: bool
) -> None:
    """Write each camera's frame with the part's lines, none where it was lost.

    anew: whether a file that is there is another run's; those of frames that were in the log are not written again.
    """
    from cadcam.files.jsontext import Place
    from cadcam.files.matrix import pose_at
    from cadcam.image.picture import to_rgb, write_picture

    for camera, photo in enumerate(frame.photos):
        name = f"{frame.index:05d}.jpg" if len(frame.photos) == 1 else f"{frame.index:05d}_{camera + 1}.jpg"
        path = Path(arguments.overlays) / name
        if path.exists() and not anew:
            continue
        picture = to_rgb(photo.gray)
        if entry["found"]:
            which = "filtered" if arguments.smooth else "pose"
            pose = pose_at(Place(arguments.output, (which,), entry[which]["world_from_part"]))
            picture = overlaid(arguments, part.lines, picture, photo, pose)
        write_picture(path, picture)


def _report(arguments: argparse.Namespace, entries: Sequence[dict[str, Any]]) -> None:
    from cadcam.report.locate import lost_stretches, track_table

    found = sum(bool(entry["found"]) for entry in entries)
    if arguments.json:
        said = {"output": arguments.output, "frames": len(entries), "found": found}
        print_json(said | {"lost": [list(stretch) for stretch in lost_stretches(entries)]})
        return
    print_tables([track_table(entries)])
    say_written(arguments.output, arguments.csv, arguments.overlays)
