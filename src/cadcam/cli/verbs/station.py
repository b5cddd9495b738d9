"""`cadcam station`: a camera on a gantry: calibrate, map its mechanics, measure, re-calibrate, report, simulate."""

from __future__ import annotations

import argparse

from cadcam.cli.arguments import Run, Verbs, add_jobs, add_json, job, names, pair, real, seed, verb, whole
from cadcam.cli.station import jobs as station_jobs
from cadcam.cli.station import measuring
from cadcam.cli.station import simulate as station_simulate
from cadcam.cli.whites import add_full_scale

_DESCRIPTION = """\
Measure with a camera that is carried over a plane. A plate of marks is laid down and surveyed at a grid of positions;
each gives a 3x3 matrix with its covariance. Comparing these calibrations separates the deflection and twist of the
mechanics from the vision's own error. A mark anywhere in the area is then measured by the calibrations around it, with
an uncertainty that includes pixels, survey, plate, repeatability and the mechanics between the positions."""
_EXAMPLES = """\
  cadcam station simulate hall                      a simulated hall: its files, and how well it measures
  cadcam station calibrate p*.pgm --camera-name 12 --plate plate.json --survey survey.csv --survey-sigma 0.2 -o s12.json
  cadcam station map s12.json --pairs --plot map.svg      deflection and twist, every pair of positions
  cadcam station measure A.pgm B.pgm --station-file s12.json --log station.jsonl --drawing marks.csv
  cadcam station recalibrate s12.json ref.pgm --known 5077.3,4763.1 -o s12-today.json
  cadcam station report s12.json s6.json --log station.jsonl -o report.html

Where and when a picture was taken is read from its header (PGM), from PICTURE.json beside it, or from --positions FILE:
  picture,camera,x_mm,y_mm,time
  p01.pgm,12,8175.40,21616.90,1995-07-21T09:28:08+00:00

survey file:  picture,reflector,x_mm,y_mm      plate file:  {"marks_mm": {"1": [0, 0], ...},
  p01.pgm,a,4647.6,999.5                         "reflectors_mm": {"a": [160, 0], ...}, "sigma_mm": 0.2,
drawing file: name,x_mm,y_mm                     "mark": "dot-ring:40mm:80mm:120mm"}

--pixels FILE takes marks found by other means, instead of pictures: name,view,x_px,y_px (view: the picture's name)."""


def add_to(verbs: Verbs) -> None:
    """Add the verb and its jobs."""
    short = "a camera on a gantry: calibrate its area, map the mechanics, measure, re-calibrate"
    parser = verb(verbs, "station", None, short=short, description=_DESCRIPTION, examples=_EXAMPLES)
    jobs = add_jobs(parser)
    _add_calibrate(jobs)
    _add_map(jobs)
    _add_measure(jobs)
    _add_recalibrate(jobs)
    _add_report(jobs)
    _add_simulate(jobs)


def _job(jobs: Verbs, name: str, run: Run, short: str) -> argparse.ArgumentParser:
    parser = job(jobs, name, run, short=short)
    add_json(parser)
    return parser


def _add_pictures(parser: argparse.ArgumentParser) -> None:
    group = parser.add_argument_group("pictures")
    group.add_argument("--positions", metavar="FILE", help="list of the pictures' positions")
    group.add_argument("--pixels", metavar="FILE", help="marks found by other means: name,view,x_px,y_px")
    group.add_argument("--sigma", type=real, metavar="PX", help="noise of one pixel coordinate (default: as found)")
    group.add_argument(
        "--mark", metavar="MARK", help="what the marks look like in pictures (default: as the plate file says)"
    )
    group.add_argument(
        "--radius", metavar="PX[,PX]", help="radius of a mark's outermost border in the picture, or its range"
    )
    add_full_scale(group)


def _add_rule(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--rule",
        default="smooth",
        choices=("smooth", "bilinear", "linear", "nearest", "b4"),
        help="how the calibrations around a mark are weighted (default smooth: least predicted error; b4: the "
        "dissertation's)",
    )


def _add_calibrate(jobs: Verbs) -> None:
    parser = _job(
        jobs,
        "calibrate",
        station_jobs.calibrate,
        "calibrate a camera from pictures of the plate at a grid of positions",
    )
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help="pictures of the plate, one for each position")
    parser.add_argument("--camera-name", metavar="NAME", help="the camera's name (default: as the pictures say)")
    parser.add_argument("--plate", required=True, metavar="FILE", help="plate file: where the marks are on it")
    parser.add_argument("--survey", required=True, metavar="FILE", help="survey file: where the plate was laid")
    parser.add_argument(
        "--survey-sigma",
        type=real,
        metavar="MM",
        help="noise of one surveyed coordinate (default: estimated from the residuals)",
    )
    parser.add_argument(
        "--repeatability",
        metavar="MM[,MM]",
        help="standard deviation of where the camera looks, from visit to visit, x and y",
    )
    parser.add_argument(
        "--camera", metavar="FILE", help="camera file: its lens distortion is removed from all pixels (default: none)"
    )
    parser.add_argument(
        "--limit", type=real, default=2.0, metavar="PX", help="largest allowed residual of a plate (default 2)"
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="station file to write (.json)")
    _add_pictures(parser)


def _add_map(jobs: Verbs) -> None:
    parser = _job(
        jobs,
        "map",
        station_jobs.map_deviations,
        "how the mechanics deviate over the area, separated from the vision's error",
    )
    parser.add_argument("stations", nargs="+", metavar="STATION", help="station files")
    parser.add_argument("--reference", metavar="POSITION", help="deviations relative to this position (default: mean)")
    parser.add_argument("--pairs", action="store_true", help="print every calibration at every position")
    parser.add_argument(
        "--plot", metavar="FILE", help="heat maps in x and y with arrows: .svg, .png, .pdf (cadcam[plots])"
    )


def _add_measure(jobs: Verbs) -> None:
    short = "measure marks, one in each picture"
    parser = _job(jobs, "measure", measuring.measure_marks, short)
    parser.add_argument(
        "pictures", nargs="*", metavar="PICTURE", help="pictures of one mark each, which is named as the file"
    )
    parser.add_argument(
        "--station-file", action="append", required=True, metavar="FILE", help="station file; may be repeated"
    )
    parser.add_argument("--drawing", metavar="FILE", help="where the marks are on the drawing: name,x_mm,y_mm")
    parser.add_argument(
        "--between",
        action="append",
        type=pair,
        default=[],
        metavar="A,B",
        help="only the distance between these two marks; may be repeated",
    )
    parser.add_argument("--csv", metavar="FILE", help="write all distances against the drawing: .csv")
    parser.add_argument("--explain", action="store_true", help="print where each calibration places each mark")
    parser.add_argument("--log", metavar="FILE", help="add the measurements to this log (JSON lines)")
    parser.add_argument("--store", metavar="FILE|URL", help="add a record for each mark to this store of product state")
    parser.add_argument("--block", metavar="NAME", help="which block the marks are on, for log and store")
    _add_rule(parser)
    parser.add_argument("--extrapolate", action="store_true", help="measure outside of the calibrated area too")
    _add_pictures(parser)


def _add_recalibrate(jobs: Verbs) -> None:
    parser = _job(
        jobs, "recalibrate", station_jobs.recalibrate, "correct a station by one mark whose position is known"
    )
    parser.add_argument("station_file", metavar="STATION", help="station file")
    parser.add_argument("pictures", nargs="*", metavar="PICTURE", help="picture of the mark")
    parser.add_argument("--known", required=True, metavar="X,Y", help="where the mark is, mm")
    parser.add_argument(
        "--known-sigma", type=real, default=0.0, metavar="MM", help="standard deviation of X and Y (default 0)"
    )
    parser.add_argument("-o", "--output", metavar="FILE", help="station file to write (.json)")
    _add_pictures(parser)


def _add_report(jobs: Verbs) -> None:
    short = "write stations and their log as one HTML file"
    parser = _job(jobs, "report", station_jobs.report, short)
    parser.add_argument("stations", nargs="+", metavar="STATION", help="station files")
    parser.add_argument("--log", metavar="FILE", help="log of `station measure`")
    parser.add_argument("--drawing", metavar="FILE", help="drawing file: the log's latest marks are compared with it")
    parser.add_argument("-o", "--output", required=True, metavar="FILE", help="report to write (.html)")


def _add_simulate(jobs: Verbs) -> None:
    parser = _job(
        jobs,
        "simulate",
        station_simulate.simulate,
        "simulate a hall: write its files, calibrate, measure, compare with the truth",
    )
    parser.add_argument("folder", nargs="?", metavar="FOLDER", help="folder for the files of the hall (default: none)")
    parser.add_argument(
        "--robots",
        type=names,
        default=("1", "6", "7", "12"),
        metavar="A,B",
        help="some of the robots 1, 6, 7, 12 (default all)",
    )
    parser.add_argument(
        "--deflection",
        type=real,
        default=20.0,
        metavar="MM",
        help="deflection of the mechanics between the two worst places (default 20)",
    )
    parser.add_argument(
        "--survey-sigma", type=real, default=0.1, metavar="MM", help="noise of the survey (default 0.1)"
    )
    parser.add_argument(
        "--sigma", type=real, default=0.03, metavar="PX", help="noise of one pixel coordinate (default 0.03)"
    )
    parser.add_argument(
        "--marks", type=whole, default=40, metavar="N", help="number of marks measured in a day (default 40)"
    )
    parser.add_argument(
        "--render", action="store_true", help="render pictures into FOLDER and find the marks in them (slow)"
    )
    parser.add_argument(
        "--sensor", metavar="PROFILE", help="sensor of those pictures: a file or a preset (`cadcam sensor`)"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the random numbers (default 0)")
    _add_rule(parser)
