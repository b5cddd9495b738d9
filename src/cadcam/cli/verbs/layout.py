"""`cadcam layout`: a scene of part, places and features -> the cameras to mount, and their predicted uncertainty."""

from __future__ import annotations

import argparse
import re
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO, Verbs, add_json, refuse, verb, whole
from cadcam.cli.output import check_folder, check_target, print_json, print_tables, progress, say, working
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.plan.choice.problem import Score
    from cadcam.plan.coverage import Painting
    from cadcam.plan.layout import CandidateSurvey, Layout
    from cadcam.plan.sight.candidate import Candidate
    from cadcam.plan.what_if import WhatIf

_OF_A_SET = (
    "--count",
    "--output",
    "--pictures",
    "--cameras",
    "--each",
    "--no-what-if",
)  # options without effect with --next
_SUFFIXES = (".html", ".json")
_DESCRIPTION = """\
Before there is a factory: which cameras to mount where, and how well they will measure. The scene file names the CAD
model, places where cameras can be, and the features that matter, with their limits. Three things are computed: what
every candidate camera sees (nothing hidden, in focus, not too oblique); how large the uncertainty of each feature will
be (noise, blur, slant, calibration, motion); and whether each limit can be judged, by the test uncertainty ratio TUR =
limit/U, with U = k sigma as in `cadcam verify`. The best set of cameras is the one whose worst TUR, over all features
and poses, is largest."""
_EXAMPLES = """\
  cadcam layout --sample folder                              two scenes to try and to edit, with their CAD model
  cadcam layout folder/four_fixed.yaml -o report.html        four fixed cameras at 6 m; a report to sign
  cadcam layout folder/six_stations.yaml -o report.html      one camera that a robot carries to six stations
  cadcam layout scene.yaml -k 3 --json                       three cameras, everything as JSON
  cadcam layout scene.yaml --keep 'gallery 6' --next         what is the next camera to buy beside this one?
  cadcam layout scene.yaml --pictures views/                 what each chosen camera will see, as PNG
  cadcam layout scene.yaml --cameras mounted/                each as a camera file: to render with, for trials
  cadcam layout scene.yaml -k 0 --keep 'gallery 6' --keep 'gallery 9'     this very set, another day

scene file (YAML; mm and degrees; all keys are in docs/layout.md):
  part: block.glb
  poses: {nominal: {position_mm: [0, 0, 0]}, shifted: {position_mm: [[-20, 20], 0, 0]}}
  cameras: {wide: {sensor: IMX304, focal_mm: 12, f_number: 8}}
  mounts:
    gallery: {box_mm: [[-1000, -6000, 2000], [5000, -6000, 4000]], count: 40, aim_mm: [2000, 1500, 900]}
    post: {positions_mm: [[0, -6000, 1500]], aim_mm: [2000, 1500, 900], fixed: true}       there already
    robot: {arc: {center_mm: [2000, 1500, 3000], radius_mm: 3000}, count: 24, one_camera: true}
  features:
    mark: {circle_mm: [100, 200, 12], normal: [0, 0, 1], diameter_mm: 40, position_mm: 0.5}
    edge: {edge_mm: [[0, 0, 12], [4000, 0, 12]], position_mm: 1, angle_deg: 0.05}
    stiffener: {part: bar 1.1 port, position_mm: 1}                       as in a tolerance file
  datum: [{part: tank top}]              the stiffener judged relative to it, as by `cadcam verify`; default: the world
  noise: {gray: 0.01, contrast: 0.4, sigma_px: 0.05}                      sigma_px for points, and without a datum
  calibration: {points: 30, sigma_px: 0.1}
  tur: 3

exit codes: 0 every limit reaches the wanted TUR, 3 not every one (the table says which, and why), 2 wrong input.
"""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "part + places for cameras + features with limits -> cameras to mount, and how well they will measure"
    parser = verb(verbs, "layout", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("scene", nargs="?", metavar="SCENE", help="scene file (see below)")
    parser.add_argument(
        "-k",
        "--count",
        type=whole,
        metavar="N",
        help="how many cameras to choose beside the fixed ones (default: the scene's)",
    )
    parser.add_argument(
        "--keep",
        action="append",
        default=[],
        metavar="NAME",
        help="a candidate camera that must be in the set; may be repeated",
    )
    parser.add_argument(
        "--next", action="store_true", help="rank every candidate as the next camera beside the fixed and kept ones"
    )
    parser.add_argument(
        "-o", "--output", action="append", default=[], metavar="FILE", help="report: .html or .json; may be repeated"
    )
    parser.add_argument(
        "--pictures", metavar="FOLDER", help="write what each chosen camera sees, and the coverage, as PNG"
    )
    parser.add_argument(
        "--cameras", metavar="FOLDER", help="write each chosen camera where it is mounted as a camera file, .json"
    )
    parser.add_argument(
        "--each",
        action="store_true",
        help="also list each feature from each camera: scale, slant, blur, sigma, or why not",
    )
    parser.add_argument(
        "--no-what-if",
        action="store_true",
        help="leave out the table of what-if changes (the same set with one thing changed)",
    )
    parser.add_argument("--sample", metavar="FOLDER", help="only write two sample scenes and their model into a folder")
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Plan, report; return the exit code."""
    if arguments.sample is not None:
        if arguments.scene is not None:
            raise BadValue(
                "scene", "given beside --sample", "one of them: --sample only writes two scenes to start from"
            )
        _sample(arguments)
        return 0
    if arguments.scene is None:
        raise BadValue("scene", "not given", "a scene file; cadcam layout --sample FOLDER writes two to start from")
    for path in arguments.output:
        check_target(path, _SUFFIXES)
    for folder in (arguments.pictures, arguments.cameras):
        if folder:
            check_folder(folder)
    seen = _survey(arguments.scene)
    have = seen.kept(arguments.keep)
    if arguments.next and have:
        _next(arguments, seen, have)
        return 0
    layout = _planned(arguments, seen)
    following = _following(layout) if arguments.next else []
    return _report(arguments, layout, following)


def _sample(arguments: argparse.Namespace) -> None:
    from cadcam.plan.scene.samples import write_samples

    written = write_samples(arguments.sample)
    if arguments.json:
        print_json({"written": [str(path) for path in written]})
    for path in written:
        say(f"wrote {path}")


def _survey(path: str) -> CandidateSurvey:
    from cadcam.plan.layout import survey
    from cadcam.plan.scene.file import read_layout_scene
    from cadcam.plan.sight.candidate import count_candidates

    with working(f"reading {path}"):
        scene = read_layout_scene(path)
    with progress("candidates", count_candidates(scene)) as step:
        return survey(scene, step=step)


def _planned(arguments: argparse.Namespace, seen: CandidateSurvey) -> Layout:
    from cadcam.plan.layout import plan_layout

    if arguments.count is not None and arguments.count < 0:
        raise BadValue("--count", arguments.count, "a number of cameras, from 0 on")
    with working("choosing cameras"):
        return plan_layout(seen, arguments.count, keep=arguments.keep)


def _following(layout: Layout) -> list[tuple[Candidate, Score]]:
    from cadcam.plan.layout import next_cameras

    return next_cameras(layout.survey, layout.chosen)


def _next(arguments: argparse.Namespace, seen: CandidateSurvey, have: tuple[int, ...]) -> None:
    """Rank the next cameras to add to existing ones."""
    from cadcam.plan.layout import next_cameras
    from cadcam.report.layout.json import next_as_json, score_as_json
    from cadcam.report.layout.words import next_table

    ranked = "none: candidates are ranked, no set is chosen and reported"
    refuse(arguments, *_OF_A_SET, why="with --next, beside cameras that are there", expected=ranked)
    order = next_cameras(seen, have)
    if arguments.json:
        names = [seen.candidates[i].name for i in have]
        print_json({"have": names, "now": score_as_json(seen.score(have)), "next": next_as_json(order)})
    else:
        print_tables([next_table(seen, have, order)])


def _report(arguments: argparse.Namespace, layout: Layout, following: list[tuple[Candidate, Score]]) -> int:
    from cadcam.files.jsontext import as_json
    from cadcam.plan.assessment.assess import Outcome
    from cadcam.plan.what_if import what_if
    from cadcam.report.layout.json import layout_as_json
    from cadcam.report.layout.words import layout_tables, next_table, sight_table
    from cadcam.whole import write_whole

    with working("trying changes"):
        changes = () if arguments.no_what_if else what_if(layout)
    document: dict[str, Any] = layout_as_json(layout, changes, following)
    for path in arguments.output:
        if path.lower().endswith(".html"):
            _page(path, layout, changes, following)
        else:
            write_whole(path, as_json(document))
    if arguments.pictures:
        _pictures(arguments.pictures, layout)
    if arguments.cameras:
        _cameras(arguments.cameras, layout)
    if arguments.json:
        print_json(document)
    else:
        tables = layout_tables(layout, changes)
        if arguments.each:
            tables.insert(2, sight_table(layout))
        if following:
            tables.append(next_table(layout.survey, layout.chosen, following))
        print_tables(tables)
        for path in arguments.output:
            say(f"wrote {path}")
    return 0 if layout.outcome is Outcome.SUITABLE else NO


def _page(path: str, layout: Layout, changes: tuple[WhatIf, ...], following: list[tuple[Candidate, Score]]) -> None:
    from cadcam.plan.pictures import camera_pictures
    from cadcam.report.layout.page import LayoutReport, write_layout_page

    with working("drawing pictures"):
        views = camera_pictures(layout)
    covered = _covered(layout)
    following = following or _following(layout)
    write_layout_page(path, LayoutReport(layout, changes, following, views, covered))


def _covered(layout: Layout) -> list[tuple[Painting, list[tuple[str, Picture]]]]:
    """Return the part painted by its coverage: by number of cameras, and by uncertainty where that is known."""
    from cadcam.plan.coverage import coverage, coverage_steps, divided
    from cadcam.plan.pictures import coverage_pictures

    pieces = divided(layout.survey.scene.part)
    with progress("looking at the surface", coverage_steps(layout, pieces)) as step:
        covered = coverage(layout, pieces, step=step)
    paintings = (covered.counted(len(layout.cameras)), covered.measured())
    with working("drawing pictures"):
        return [(p, coverage_pictures(layout, p)) for p in paintings if p is not None]


def _pictures(folder: str, layout: Layout) -> None:
    """Write what the chosen cameras see, and the coverage; cameras are numbered as their files are."""
    from pathlib import Path

    from cadcam.image.picture import write_picture
    from cadcam.plan.pictures import camera_pictures

    with working("drawing pictures"):
        views = zip(layout.cameras, camera_pictures(layout), strict=True)
        named = [(f"camera {i} {c.name}", p) for i, (c, p) in enumerate(views, 1)]
    named += [(f"coverage {title}", p) for _, views in _covered(layout) for title, p in views]
    for name, picture in named:
        path = Path(folder) / f"{_as_file_name(name)}.png"
        write_picture(path, picture)
        say(f"wrote {path}")


def _cameras(folder: str, layout: Layout) -> None:
    """Write the chosen cameras, where they are mounted; numbered, for two names may be alike as names of files."""
    from pathlib import Path

    from cadcam.files.camera import write_camera

    for i, c in enumerate(layout.cameras, 1):
        path = Path(folder) / f"{i}_{_as_file_name(c.name)}.json"
        write_camera(path, c.camera, camera_from_world=c.viewpoint.camera_from_world)
        say(f"wrote {path}")


def _as_file_name(name: str) -> str:
    return re.sub(r"\W+", "_", name).strip("_")
