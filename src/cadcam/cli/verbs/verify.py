"""`cadcam verify`: a photo of a part, its CAD and its tolerances -> PASS, FAIL or UNDECIDED, with a report."""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from cadcam.cli.arguments import Verbs, add_json, refuse, verb
from cadcam.cli.judging import (
    TOLERANCES_HELP,
    add_judging_options,
    edged,
    judged_by,
    options_as_asked,
    origin_of,
    part_to_judge,
    tolerances_as_asked,
)
from cadcam.cli.locating import (
    START_HELP,
    VIEWS_HELP,
    add_start_options,
    add_view_options,
    freedom_as_asked,
    pose_in_file,
    start_as_asked,
    views_as_asked,
)
from cadcam.cli.models import add_model_options, check_order, load_as_asked
from cadcam.cli.output import check_target, print_json, print_tables, say_written, stages, working
from cadcam.cli.photos import Shots, add_photo_options, read_shots
from cadcam.errors import BadValue
from cadcam.image.suffixes import WRITABLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cadcam.cad.mesh import Mesh
    from cadcam.geometry.rigid import Rigid
    from cadcam.locate.freedom import Freedom
    from cadcam.locate.location import Location
    from cadcam.locate.part import Part
    from cadcam.locate.photo import Photo
    from cadcam.locate.views.view_range import ViewRange
    from cadcam.render.view import Scene
    from cadcam.report.verify.json import VerificationOrigin
    from cadcam.verify.inspection import InspectionOptions
    from cadcam.verify.judge import Verification
    from cadcam.verify.tolerances.tolerance import Selection, Tolerances

_SUFFIXES = (".html", ".json")
_OF_A_VERDICT = ("--tolerances", "--reach", "--alarms", "--serial", "--station")
_POSED_PX = 4.0  # largest error of a pose that was found before
_DESCRIPTION = """\
Judge a part against its CAD, from one photo or several. The part is found, its pose is fitted to datum features, and
every other feature is compared with where the CAD has it: is it there at all, and how far is it displaced, in mm, with
what uncertainty? Each limit of the tolerance file gets a verdict by ISO 14253-1. With U = k sigma: PASS if |deviation|
<= limit - U, FAIL if |deviation| > limit + U, else UNDECIDED. A photo that is too poor to judge by never gives PASS.

The uncertainty has four causes: the photo's noise, errors common to an edge, the pose, and the camera's calibration, as
far as its file has a covariance. One photo shows no displacement along the line of sight."""
_EXAMPLES = f"""\
  cadcam verify part.step --list -o names.png                     what a tolerance file can name, on a picture
  cadcam verify part.step --list 'bar 1*'                         the edges (chains) of these parts
  cadcam verify part.step --list -o names.html                    edges and bodies to be clicked, for a tolerance file
  cadcam verify part.step --template -o tolerances.yaml           the limits that a STEP AP242 file states (PMI)
  cadcam verify photo.png part.step --camera camera.json --template -o tolerances.yaml
  cadcam verify photo.png part.step --camera camera.json --tolerances tolerances.yaml -o report.html
  cadcam verify photo.png part.step --camera camera.json --tolerances tolerances.yaml --start rough.txt --json
  cadcam verify left.png right.png part.step --rig rig.json --tolerances tolerances.yaml -o report.html -o report.json

{TOLERANCES_HELP}
{START_HELP}
{VIEWS_HELP}
exit codes: 0 PASS, 1 FAIL, 3 UNDECIDED or not found (the reason is printed), 2 errors. Without --tolerances nothing is
judged: displaced and missing parts are reported, and the code is 0, or 3 if the part is not found.
`cadcam state add report.json` keeps the result; of every part in view that has no limit how far it is off, that it is
missing, or why it is unclear, each without a verdict.
"""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + CAD + tolerances -> PASS, FAIL or UNDECIDED, deviations in mm with U, a report"
    parser = verb(verbs, "verify", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument(
        "photos", nargs="*", metavar="PHOTO", help="one photo, or one per camera (EXIF orientation applied)"
    )
    add_model_options(parser)
    add_photo_options(parser)
    parser.add_argument("--tolerances", metavar="FILE", help="tolerance file (see below)")
    add_start_options(parser)
    parser.add_argument(
        "--pose", metavar="FILE", help="a start that is right to a pixel or two (`cadcam locate --pose-out`): no search"
    )
    add_view_options(parser)
    add_judging_options(parser)
    parser.add_argument("--serial", metavar="NAME", help="serial number of the part, for the report")
    parser.add_argument("--station", metavar="NAME", help="where it was measured, for the report")
    parser.add_argument(
        "-o",
        "--output",
        action="append",
        default=[],
        metavar="FILE",
        help="report: .html or .json, may be repeated; with --list a picture or .html, with --template a .yaml",
    )
    parser.add_argument(
        "--list",
        nargs="?",
        const=True,
        metavar="PART",
        help="only list what a tolerance file can name; PART (or a pattern): its edges",
    )
    parser.add_argument(
        "--template",
        action="store_true",
        help="only write (-o FILE.yaml) or print a tolerance file: the limits that a STEP AP242 file states, or one to "
        "start from",
    )
    parser.add_argument(
        "--datum",
        metavar="LETTERS",
        help="with --template: the system of datums, 'A B C', of which the stated tolerances are written (default: the "
        "one that most refer to)",
    )
    add_json(parser)


def run(arguments: argparse.Namespace) -> int:
    """Verify, report; return the exit code."""
    only = "--list" if arguments.list is not None else "--template"
    if arguments.list is not None or arguments.template:
        refuse(arguments, *_OF_A_VERDICT, why=f"beside {only}", expected="one of them: nothing is judged")
    if not arguments.template:
        refuse(arguments, "--datum", why="without --template", expected="both: it chooses what is written")
    if arguments.list is not None:
        refuse(arguments, "--template", why="beside --list", expected="one of them")
        _list(arguments)
        return 0
    if arguments.template:
        refuse(arguments, "--json", why="beside --template", expected="neither: a tolerance file is YAML")
    for path in arguments.output:
        check_target(path, (".yaml", ".yml") if arguments.template else _SUFFIXES)
    asked = _asked(arguments)
    if asked is None and not arguments.template:
        raise BadValue("photos", "none given", "cadcam verify PHOTO MODEL --camera FILE; or --list, --template")
    mesh = _mesh(arguments)
    if asked is None or arguments.template:
        _template(arguments, edged(mesh), asked)
        return 0
    part, tolerances = part_to_judge(arguments, mesh, asked.tolerances)
    return _verified(arguments, part, asked, tolerances)


def _mesh(arguments: argparse.Namespace) -> Mesh:
    """Return the model, and keep what the report says of its file."""
    mesh, arguments.cad = load_as_asked(arguments)
    return mesh


@dataclass(frozen=True, slots=True, eq=False)
class _Asked:
    """What is asked of photos: the contents of the command line and its files, read before the model."""

    shots: Shots
    tolerances: Tolerances | None
    start: Rigid | None
    freedom: Freedom
    views: ViewRange
    options: InspectionOptions


def _asked(arguments: argparse.Namespace) -> _Asked | None:
    """Return what is asked; None without photos."""
    check_order(arguments.photos, arguments.model)
    if not arguments.photos:
        return None
    shots = read_shots(arguments.photos, arguments)
    viewpoints = [photo.viewpoint for photo in shots.photos]
    freedom = freedom_as_asked(arguments, posed=bool(arguments.pose))
    if arguments.start or arguments.points:
        refuse(arguments, "--pose", why="beside --start or --points", expected="one of them")
    start = start_as_asked(arguments, viewpoints, shots.camera_from_world)
    views = views_as_asked(arguments, shots.camera_from_world, "--start", "--points", "--pose")
    if arguments.pose:
        start = pose_in_file(arguments, arguments.pose, viewpoints, shots.camera_from_world)
    tolerances, options = tolerances_as_asked(arguments), options_as_asked(arguments)
    return _Asked(shots, tolerances, start, freedom, views, options)


def _located(arguments: argparse.Namespace, part: Part, asked: _Asked) -> Location:
    """Return the pose of the part, as given by the options."""
    from cadcam.cli.locating import located
    from cadcam.locate.refine.options import EdgeOptions
    from cadcam.locate.refine.refinement import refine_pose

    if not arguments.pose or asked.start is None:
        return located(part, asked.shots, asked.start, asked.freedom, asked.views)
    options = EdgeOptions(search_px=_POSED_PX)
    with working("finding the part"):
        found = refine_pose(part, asked.shots.photos, asked.start, freedom=asked.freedom, options=options)
    if found.found:
        return found
    alone = found.why.noting(f"looked for within {_POSED_PX:g} px around the start alone, --pose")
    return replace(found, why=replace(alone, around_start=True))


def _verified(arguments: argparse.Namespace, part: Part, asked: _Asked, tolerances: Tolerances) -> int:
    from cadcam.verify.judge import verify_part
    from cadcam.verify.tolerances.verdict import Verdict

    located, shots = _located(arguments, part, asked), asked.shots
    with stages("searching edges") as tell:
        found = verify_part(
            part, shots.photos, located, tolerances, options=asked.options, freedom=asked.freedom, tell=tell
        )
    _report(arguments, shots, found, _origin(arguments, shots), part.scene)
    if not found.judgements:
        return found.verdict.exit_code if found.verdict is Verdict.NOT_FOUND else 0
    return found.verdict.exit_code


def _report(
    arguments: argparse.Namespace, shots: Shots, found: Verification, origin: VerificationOrigin, scene: Scene
) -> None:
    from cadcam.files.jsontext import as_json
    from cadcam.report.verify.json import verification_as_json
    from cadcam.report.verify.page import write_verification_page
    from cadcam.report.verify.words import verification_tables
    from cadcam.whole import write_whole

    document = verification_as_json(found, origin)
    for path in arguments.output:
        if path.lower().endswith(".html"):
            write_verification_page(path, found, shots.photos, origin, scene=scene)
        else:
            write_whole(path, as_json(document))
    if arguments.json:
        print_json(document)
    else:
        print_tables(verification_tables(found))
        say_written(*arguments.output)


def _origin(arguments: argparse.Namespace, shots: Shots) -> VerificationOrigin:
    from pathlib import Path

    part, files = Path(arguments.model).stem, judged_by(arguments, arguments.cad)
    return origin_of(arguments, shots, files, part=part, serial=arguments.serial or "")


def _template(arguments: argparse.Namespace, part: Part, asked: _Asked | None) -> None:
    """Write or print a tolerance file: of what the CAD file states, else one to start from."""
    from cadcam.verify.tolerances.file import template
    from cadcam.whole import utf8, write_whole

    seen = None if asked is None else _seen(arguments, part, asked)
    text = _as_stated(arguments, part, seen)
    if text is None:
        names = () if seen is None else tuple(seen.names)
        text = template(part.scene, seen=names, chain=None if seen is None else seen.longest)
    if not arguments.output:
        print(text, end="")
    for path in arguments.output:
        write_whole(path, utf8(text))
        say_written(path)


@dataclass(frozen=True)
class _Seen:
    """What photos show: names of parts, numbers of feature chains, and the chain of which they show most."""

    names: Sequence[str]
    chains: frozenset[int]
    longest: int | None


def _seen(arguments: argparse.Namespace, part: Part, asked: _Asked) -> _Seen:
    import numpy as np

    from cadcam.cad.edges import EdgeKind
    from cadcam.verify.edges.sightlines import sightlines

    pose = _located(arguments, part, asked).pose.world_from_part
    lines = sightlines(part, asked.shots.photos, pose)[0]
    shown, chains = set(lines.part.tolist()), lines.chain[lines.kind != EdgeKind.CONTOUR]  # others in every view
    names = [name for i, name in enumerate(part.scene.mesh.part_names) if i in shown]
    return _Seen(names, frozenset(chains.tolist()), int(np.bincount(chains).argmax()) if len(chains) else None)


def _as_stated(arguments: argparse.Namespace, part: Part, seen: _Seen | None) -> str | None:
    """Return the tolerance file that a CAD file's own tolerances make; None where it has none."""
    from pathlib import Path

    from cadcam.cad.pmi.read import read_pmi
    from cadcam.verify.tolerances.drawing import drawing_template

    path = Path(arguments.model)
    pmi = read_pmi(path) if path.suffix.lower() in (".step", ".stp") else None
    if not pmi:
        refuse(arguments, "--datum", why=f"of {path.name}", expected="a STEP AP242 file that states tolerances")
        return None
    letters = arguments.datum.replace("|", " ").split() if arguments.datum else ()
    return drawing_template(part.scene, pmi, path.name, letters=letters, seen=None if seen is None else seen.chains)


def _list(arguments: argparse.Namespace) -> None:
    """Print the names that can be used; draw them."""
    from cadcam.report.verify.names import chain_table, part_table
    from cadcam.verify.tolerances.tolerance import Selection

    for path in arguments.output:
        check_target(path, (*WRITABLE, ".html"))
    asked = _asked(arguments)
    mesh = _mesh(arguments)
    chosen = None if arguments.list is True else Selection(arguments.list)
    if chosen is not None:
        chosen.among(mesh.part_names)  # a name that is none is told before edges are found
    part = edged(mesh)
    table = part_table(part.scene) if chosen is None else chain_table(part.scene, chosen)
    if arguments.json:
        print_json({"columns": list(table.columns), "rows": [list(row) for row in table.rows]})
    else:
        print_tables([table])
    pictures = [path for path in arguments.output if not path.lower().endswith(".html")]
    for path in arguments.output:
        if path not in pictures:
            _write_names(path, part, chosen, arguments.model)
    if pictures:
        over = None
        if asked is not None:
            over = asked.shots.photos[0], _located(arguments, part, asked).pose.world_from_part
        _draw_names(pictures, part, chosen, over)


def _write_names(path: str, part: Part, chosen: Selection | None, model: str) -> None:
    from pathlib import Path

    from cadcam.report.verify.names_page import names_page
    from cadcam.whole import utf8, write_whole

    write_whole(path, utf8(names_page(part.scene, Path(model).name, chosen)))
    say_written(path)


def _draw_names(paths: Sequence[str], part: Part, chosen: Selection | None, over: tuple[Photo, Rigid] | None) -> None:
    """Write a picture of the part with the chosen names, on paper or over a photo of it in a pose."""
    import numpy as np

    from cadcam.image.picture import to_rgb, write_picture
    from cadcam.render.standard_view import standard_view
    from cadcam.report.verify.names import names_on_paper, names_over_photo

    mesh = part.scene.mesh
    if over is None:
        shown = mesh if chosen is None else mesh.subset(np.flatnonzero(chosen.bodies(part.scene)).tolist())
        picture = names_on_paper(part.lines, *standard_view(shown), chosen)
    else:
        photo, world_from_part = over
        pose = photo.camera_from_world @ world_from_part
        picture = names_over_photo(to_rgb(photo.gray), part.lines, photo.camera, pose, chosen)
    for path in paths:
        write_picture(path, picture)
        say_written(path)
