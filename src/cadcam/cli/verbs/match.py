"""`cadcam match`: the places in a photo most similar to a template, or to the features of a CAD model."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import NO, Verbs, add_json, real, refuse, span, verb, whole
from cadcam.cli.cameras import POSE_HELP, add_camera_options, camera_and_pose, view_as_json
from cadcam.cli.models import add_reading_options, check_order, load_as_asked, model_as_json
from cadcam.cli.output import check_target, print_json, print_tables, say_written, working
from cadcam.cli.whites import add_full_scale, say_pages, white_as_asked
from cadcam.errors import BadValue
from cadcam.image.suffixes import READABLE, WRITABLE

if TYPE_CHECKING:
    from cadcam.arrays import Picture
    from cadcam.image.picture import PictureInfo
    from cadcam.image.template import Template
    from cadcam.locate.match.closeness import Closeness
    from cadcam.locate.match.templates import TemplateMatches
    from cadcam.locate.photo import Photo

_TEMPLATE_OPTIONS = ("--mask", "--angles", "--scales", "--count", "--least-score", "--either-sign")
_PART_OPTIONS = (
    *("--camera", "--pose", "--unit", "--mesh-tolerance"),
    *("--appearance", "--reach", "--turn", "--measure", "--peaks"),
)
_TURN, _OVER_PX = math.radians(0.25), 2.0  # step of angles at which a template is to fit, and by how much it may not
_EXAMPLES = f"""\
  cadcam match photo.png corner.png -o where.png
  cadcam match photo.png corner.png --angles -20,20 --scales 0.9,1.1 --count 5 --json
  cadcam match photo.png part.step --camera camera.json --pose start.txt -o features.png
  cadcam match photo.png part.stl --unit mm --camera camera.json --measure --peaks

The gap is the score of a peak less that of the next one: a high score with a small gap means that the picture shows the
same thing twice. A large template whose only structure is small may not be found: cut out that alone. A feature whose
best peak is wrong does no harm: the pose is that on which most features agree. Of a template that shows one straight
edge the place along it is not determined, of a round one the angle: a note says so, and +- is the range searched.

exit codes: 0 found; 3 not found: nothing reaches --least-score, or too few features agree on a pose.

{POSE_HELP}"""
_DESCRIPTION = """\
Match by area, by normalised correlation. With a picture as template: the peaks of the correlation over all positions
and angles, to parts of a pixel and of a degree, with the gap to the runner-up. With a CAD model, a camera and a rough
pose: the model is drawn as that camera sees it, distinctive windows of the drawing (features) are searched for in the
photo, and the pose on which most of them agree is taken. Hidden and repeated features do no harm."""


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    short = "photo + template, or CAD model + camera + rough pose -> where they match"
    parser = verb(verbs, "match", run, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    parser.add_argument("photo", metavar="PHOTO", help="picture to search: PNG, JPEG, TIFF ...")
    parser.add_argument("what", metavar="WHAT", help="a picture: the template; or a CAD file: STL, OBJ, PLY, STEP ...")
    parser.add_argument("-o", "--output", metavar="FILE", help="write the photo with what was found: .png or .jpg")
    add_full_scale(parser)
    _add_template_options(parser)
    _add_part_options(parser)
    add_json(parser)


def _add_template_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("template")
    group.add_argument(
        "--mask",
        metavar="FILE",
        help="picture of the template's size: pixels that are dark or transparent in it are ignored, as those are that"
        " are transparent in the template itself",
    )
    group.add_argument(
        "--angles",
        type=span,
        default=(-180.0, 180.0),
        metavar="DEG,DEG",
        help="least and greatest angle of the template, from x towards y (default -180,180)",
    )
    group.add_argument(
        "--scales",
        type=span,
        default=(1.0, 1.0),
        metavar="S,S",
        help="least and greatest scale of the template (default 1)",
    )
    group.add_argument("--count", type=whole, default=3, metavar="N", help="number of peaks to report (default 3)")
    group.add_argument(
        "--least-score", type=real, default=0.4, metavar="S", help="least score of a peak, 0 to 1 (default 0.4)"
    )
    group.add_argument("--either-sign", action="store_true", help="reversed contrast matches as well")


def _add_part_options(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("CAD model")
    add_reading_options(group)
    add_camera_options(parser, required=False)
    group.add_argument(
        "--appearance",
        choices=("lines", "gradient", "gray"),
        default="lines",
        help="what is compared: drawn lines or shades with the photo's gradient, or grey levels (default lines)",
    )
    group.add_argument(
        "--reach", type=real, default=45.0, metavar="PX", help="how far off the pose may draw the part (default 45)"
    )
    group.add_argument(
        "--turn", type=real, default=20.0, metavar="DEG", help="how far it may be rotated in the picture (default 20)"
    )
    group.add_argument(
        "--measure", action="store_true", help="also say how close the photo's edges are to each CAD edge"
    )
    group.add_argument("--peaks", action="store_true", help="also print each feature's peaks")


def run(arguments: argparse.Namespace) -> int:
    """Match, write, report."""
    check_target(arguments.output, WRITABLE)
    check_order([arguments.photo], arguments.what)
    if arguments.what.lower().endswith(READABLE):
        template = "for a picture as template"
        refuse(arguments, *_PART_OPTIONS, why=template, expected="a CAD model, or leave it out")
        return _run_template(arguments)
    _check_model(arguments.what)
    refuse(arguments, *_TEMPLATE_OPTIONS, why="for a CAD model", expected="a picture as template, or leave it out")
    if not arguments.camera:
        raise BadValue(
            "--camera", "missing", "the camera that took the photo, for a CAD model; or a picture as template"
        )
    return _run_part(arguments)


def _check_model(what: str) -> None:
    """Refuse what is neither a picture nor a CAD model, before a camera is required."""
    from cadcam.cad.read import SUFFIXES

    if not what.lower().endswith(SUFFIXES) and not Path(what).is_dir():
        known = f"a picture ({' '.join(READABLE)}) or a CAD model ({' '.join(SUFFIXES)})"
        raise BadValue("template", repr(what), known)


def _check_size(arguments: argparse.Namespace, photo: Picture, template: Template) -> None:
    """Refuse a template that no angle makes fit into the photo, as where the two were swapped."""
    if _fits(arguments, photo, template):
        return
    (height, width), (w, h) = photo.shape, template.size
    sizes = f"{w} x {h} px, which does not fit into the photo {arguments.photo}, {width} x {height} px"
    raise BadValue(
        f"template {arguments.what}",
        sizes,
        "the photo first, then what is looked for in it; or a part cut out of it, or smaller --scales",
    )


def _fits(arguments: argparse.Namespace, photo: Picture, template: Template) -> bool:
    """Return whether what counts of a template lies within the photo at the least scale and any angle asked for."""
    import numpy as np

    mask = template.mask
    rows = np.flatnonzero(mask.any(axis=1))
    ends = np.concatenate([mask[rows].argmax(axis=1), mask.shape[1] - 1 - mask[rows, ::-1].argmax(axis=1)])
    low, high = np.radians(arguments.angles)
    angle = np.linspace(low, high, 1 + math.ceil((high - low) / _TURN))
    c, s = np.cos(angle)[:, None], np.sin(angle)[:, None]
    y = np.concatenate([rows, rows])
    need = min(arguments.scales) * np.stack(
        [np.ptp(c * ends - s * y, axis=1), np.ptp(s * ends + c * y, axis=1)], axis=1
    )
    room = np.array(photo.shape[::-1]) - 1 + _OVER_PX + _TURN / 2 * math.hypot(*template.size)
    return bool((need <= room).all(axis=1).any())


def _run_template(arguments: argparse.Namespace) -> int:
    from cadcam.image.correlate import CorrelateOptions, correlate
    from cadcam.image.picture import to_gray, write_picture
    from cadcam.image.template_file import read_template
    from cadcam.report.match import peaks_as_json, peaks_table, template_as_json
    from cadcam.report.match_picture import with_peaks
    from cadcam.report.photos import photos_as_json

    low, high = arguments.angles
    if not 0 <= high - low <= 360:
        raise BadValue("--angles", f"{low:g},{high:g}", "least,greatest in degrees, at most a full turn apart")
    options = CorrelateOptions(
        angles=(math.radians(low), math.radians(high)),
        scales=arguments.scales,
        count=arguments.count,
        least_score=arguments.least_score,
        either_sign=arguments.either_sign,
    )
    picture, read = _picture(arguments)
    say_pages([arguments.what])
    photo, template = to_gray(picture), read_template(arguments.what, mask=arguments.mask)
    _check_size(arguments, photo, template)
    with working("matching"):
        peaks = correlate(photo, template, options=options)
    if arguments.output:
        write_picture(arguments.output, with_peaks(photo, template, peaks))
    if arguments.json:
        document = {"photo": arguments.photo, "photos": photos_as_json([read]), "template": arguments.what}
        print_json(document | template_as_json(template) | peaks_as_json(peaks, template))
    else:
        print_tables([peaks_table(peaks, f"Peaks of {arguments.what} in {arguments.photo}", template=template)])
        say_written(arguments.output)
    return 0 if len(peaks) else NO


def _picture(arguments: argparse.Namespace) -> tuple[Picture, PictureInfo]:
    """Return the photo, and how it was read."""
    from cadcam.image.camera_picture import read_camera_picture_with_info

    return read_camera_picture_with_info(arguments.photo, full_scale=white_as_asked(arguments, [arguments.photo]))


def _run_part(arguments: argparse.Namespace) -> int:
    from cadcam.image.picture import write_picture
    from cadcam.locate.match.closeness import edge_closeness
    from cadcam.locate.match.templates import TemplateOptions, match_templates
    from cadcam.locate.part import Part
    from cadcam.report.match import closeness_as_json, matches_as_json
    from cadcam.report.match_picture import with_features

    if not 0 <= arguments.turn <= 180:
        raise BadValue("--turn", f"{arguments.turn:g}", "0 to 180 degrees")
    photo, start, said = _photo(arguments)
    arguments.model = arguments.what
    mesh, report = load_as_asked(arguments)
    with working("finding edges"):
        part = Part.of(mesh)
    options = TemplateOptions(appearance=arguments.appearance, reach=arguments.reach, turn=math.radians(arguments.turn))
    with working("matching"):
        matches = match_templates(part, [photo], start, options=options)
        pose = matches.pose.world_from_part if matches.found and matches.pose else start
        close = edge_closeness(photo.gray, part.lines.draw(photo.camera, pose))
    if arguments.output:
        write_picture(arguments.output, with_features(photo, part, matches))
    if arguments.json:
        document = {"photo": arguments.photo, "model": model_as_json(report, mesh)} | said
        print_json(document | matches_as_json(matches, photo) | {"edges": closeness_as_json(close)})
    else:
        _print_part(arguments, matches, close)
    return 0 if matches.found else NO


def _photo(arguments: argparse.Namespace) -> tuple[Photo, Any, dict[str, Any]]:
    """Return the photo, the part's pose, and what the document says of camera and photo."""
    from cadcam.image.picture import to_gray
    from cadcam.locate.photo import Photo
    from cadcam.render.overlay import fitting
    from cadcam.report.photos import photos_as_json

    known, start = camera_and_pose(arguments.camera, arguments.pose)
    picture, read = _picture(arguments)
    said = {"camera": view_as_json(known.camera, start), "photos": photos_as_json([read])}
    gray = to_gray(fitting(picture, known.camera, name=arguments.photo))
    return Photo.of(gray, known.calibrated), start, said


def _print_part(arguments: argparse.Namespace, matches: TemplateMatches, close: Closeness) -> None:
    from cadcam.report.match import closeness_table, feature_peaks, feature_table

    tables = [feature_table(matches)]
    tables += feature_peaks(matches.features) if arguments.peaks else []
    tables += [closeness_table(close)] if arguments.measure else []
    print_tables(tables)
    where = "at the pose found" if matches.found else "at the pose given"
    print("found" if matches.found else f"not found: {_why_not(matches)}")
    share = round(100 * close.total)
    if share > 0:
        print(f"edges of the photo lie on {share} % of the visible lines {where}, beyond chance")
    else:
        print(f"no more edges of the photo lie on the visible lines {where} than by chance")
    if matches.found and matches.pose is not None:
        _print_pose(matches)
    say_written(arguments.output)


def _why_not(matches: TemplateMatches) -> str:
    from cadcam.locate.match.templates import CERTAIN

    if matches.pose is None or matches.by_chance >= CERTAIN:
        return "no more features agree on a pose than could by chance"
    return "most features, or most lines, contradict the pose that some agree on"


def _print_pose(matches: TemplateMatches) -> None:
    import numpy as np

    assert matches.pose is not None
    T, sigma = matches.pose.world_from_part, np.sqrt(np.diag(matches.pose.covariance))
    print("camera_from_part, mm:")
    for row in T.matrix[:3]:
        print("  " + " ".join(f"{v:14.8f}" for v in row))
    mm, deg = (" ".join(f"{v:.3g}" for v in part) for part in (sigma[:3], np.degrees(sigma[3:])))
    known = "calibration included" if matches.pose.from_calibration.any() else "the camera taken as exact"
    print(f"+- {mm} mm, {deg} degrees along and about the part's axes, {known}")
