"""`cadcam station` as its user meets it: the whole procedure from files, and one clear error for each wrong input."""

from __future__ import annotations

import csv
import json
import re
import shlex
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.cli.main import main
from cadcam.files.camera import write_camera
from cadcam.files.shot import ShotPosition, write_pgm
from cadcam.record.store import open_store
from cadcam.station.document import read_station, write_plate
from cadcam.station.hall import Visit, make_hall
from cadcam.station.hall_picture import hall_picture
from cadcam.station.plate import turn
from cadcam.station.simulate import calibrate_robot, day, write_day, write_inputs
from cadcam.station.survey import read_drawing, write_survey

from .job import Ran, replaced

Cadcam = Callable[..., Ran]
PAGE = (Path(__file__).resolve().parents[2] / "docs" / "station.md").read_text()


@pytest.fixture(scope="session")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a simulated hall's files."""
    folder = tmp_path_factory.mktemp("station") / "hall"
    assert main(["station", "simulate", str(folder), "--robots", "6,12", "--marks", "12", "--json"]) == 0
    return folder


@pytest.fixture
def folder(made: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of it, to work in."""
    shutil.copytree(made, tmp_path / "hall")
    monkeypatch.chdir(tmp_path / "hall")
    return tmp_path / "hall"


CALIBRATE = (
    *("station", "calibrate", "--pixels", "plate_6_pixels.csv", "--positions", "positions_6.csv"),
    *("--plate", "plate.json", "--survey", "survey_6.csv", "--survey-sigma", "0.1"),
)
MEASURE = ("station", "measure", "--pixels", "day_pixels.csv", "--positions", "day_positions.csv")
BOTH = ("--station-file", "station_6.json", "--station-file", "station_12.json")


def test_a_lens_is_taken_off(cadcam: Cadcam, folder: Path) -> None:
    """The worst mark of twelve lies within the hall's mechanics between positions, some 10 mm; 20 px are 26 mm."""
    rng = np.random.default_rng(8)
    bent = Camera.from_focal((768, 576), 4650.0, fy=5070.0, lens=BrownConrady(k1=-8.0))
    hall = make_hall(rng, robots=("6",), camera=bent)
    write_inputs(folder, calibrate_robot(hall, "6", rng).station)
    write_day(folder, hall, day(hall, rng, marks=12), rng)
    write_plate(folder / "plate.json", hall.plate)
    write_camera(folder / "camera.json", bent)
    assert cadcam(*CALIBRATE, "--limit", "0.5").code == 2
    assert cadcam(*CALIBRATE, "--limit", "0.5", "--camera", "camera.json", "-o", "bent.json").code == 0
    found = cadcam(*MEASURE, "--station-file", "bent.json", "--drawing", "day_truth.csv", "--json").json
    assert read_station(folder / "bent.json").lens is not None
    truth = read_drawing(folder / "day_truth.csv")
    off = [np.array(one["point_mm"]) - truth[one["mark"]] for one in found["measured"]]
    assert np.abs(off).max() < 15


def test_the_simulation_says_how_well_it_went(cadcam: Cadcam) -> None:
    said = cadcam("station", "simulate", "--robots", "7", "--marks", "12", "--json").json
    assert said["cameras"]["7"]["map_error_rms_mm"] < 0.1
    assert 0.5 <= said["within"] <= 1


def test_a_calibration_from_files_is_the_simulation_s_own(cadcam: Cadcam, folder: Path) -> None:
    ran = cadcam(*CALIBRATE, "--sigma", "0.03", "--repeatability", "0.2", "-o", "again.json")
    assert ran.code == 0
    assert "Camera 6: 15 calibrated positions" in ran.out
    one, other = read_station(folder / "again.json"), read_station(folder / "station_6.json")
    assert one.map().deviation == pytest.approx(other.map().deviation, abs=1e-9)
    assert one.repeatability.sigma == pytest.approx([0.2, 0.2])


def test_marks_are_measured_logged_kept_and_compared(cadcam: Cadcam, folder: Path) -> None:
    keep = ("--log", "log.jsonl", "--store", "parts.sqlite", "--block", "B1")
    ran = cadcam(*MEASURE, *BOTH, "--drawing", "day_truth.csv", *keep)
    assert ran.code == 0
    assert "Distances against the drawing" in ran.out
    assert len((folder / "log.jsonl").read_text().splitlines()) == 12
    with open_store(folder / "parts.sqlite") as store:
        assert len(store.query(serial="B1")) == 12
    said = cadcam(*MEASURE, *BOTH, "--drawing", "day_truth.csv", "--between", "mark01,mark02", "--json").json
    assert len(said["distances"]) == 1
    assert len(said["measured"]) == 12


def test_of_many_distances_the_table_shows_the_worst_and_a_file_all(cadcam: Cadcam, folder: Path) -> None:
    ran = cadcam(*MEASURE, *BOTH, "--drawing", "day_truth.csv", "--csv", "all.csv")
    table = ran.out.partition("Distances against the drawing")[2].partition("differences together")[0]
    shown = [tuple(map(float, line.split()[3:7])) for line in table.splitlines() if " - mark" in line]
    assert len(shown) == 20
    assert "shown: the 20 of 66 that differ most for their uncertainty" in table
    with (folder / "all.csv").open() as file:
        every = list(csv.DictReader(file))
    assert len(every) == 66
    ratios = sorted(abs(float(r["drawn_less_measured_mm"])) / float(r["half_width_95_mm"]) for r in every)[::-1]
    assert [abs(d) / U for _, U, _, d in shown] == pytest.approx(ratios[:20], rel=0.02)


@pytest.mark.usefixtures("unread")
def test_what_was_measured_is_kept_even_if_nobody_reads_the_tables(cadcam: Cadcam, folder: Path) -> None:
    ran = cadcam(*MEASURE, *BOTH, "--log", "unread.jsonl", "--store", "unread.sqlite", "--block", "B1")
    assert ran.code != 0
    assert len((folder / "unread.jsonl").read_text().splitlines()) == 12
    with open_store(folder / "unread.sqlite") as store:
        assert len(store.query(serial="B1")) == 12


def test_each_rule_can_be_asked_for_and_explains_itself(cadcam: Cadcam, folder: Path) -> None:
    for rule in ("smooth", "b4"):
        ran = cadcam(*MEASURE, *BOTH, "--rule", rule, "--explain")
        assert ran.code == 0
        assert "Mark mark01: estimates of the calibrations" in ran.out


def test_the_map_is_printed_and_drawn(cadcam: Cadcam, folder: Path) -> None:
    pytest.importorskip("matplotlib")
    ran = cadcam("station", "map", "station_6.json", "station_12.json", "--pairs", "--plot", "map.svg")
    assert ran.code == 0
    assert "Every calibration at every position" in ran.out
    drawn = (folder / "map.svg").read_text()
    assert drawn.startswith("<?xml")
    assert drawn.count("<image ") == 3  # the maps in x and in y, and their scale
    assert "feComposite" not in drawn  # shaded triangles, which viewers mix to other colours than the scale's
    said = cadcam("station", "map", "station_6.json", "--reference", "plate_6_03.pgm", "--json").json
    assert said["maps"][0]["positions"][2]["deviation_mm"] == pytest.approx([0, 0])
    for plot, relative in (("mean.svg", ()), ("third.svg", ("--reference", "plate_6_03.pgm"))):
        assert cadcam("station", "map", "station_6.json", "--plot", plot, *relative).code == 0
    scales = [re.findall(r"<!-- (\S+) -->", (folder / plot).read_text()) for plot in ("mean.svg", "third.svg")]
    assert scales[0] != scales[1]  # the plot's scale is that of what the table says


@pytest.mark.usefixtures("unread")
def test_what_was_calibrated_and_drawn_is_kept_even_if_nobody_reads_the_tables(cadcam: Cadcam, folder: Path) -> None:
    pytest.importorskip("matplotlib")
    assert cadcam(*CALIBRATE, "-o", "unread.json").code != 0
    assert read_station(folder / "unread.json").camera == "6"
    assert cadcam("station", "map", "unread.json", "--plot", "unread.svg").code != 0
    assert (folder / "unread.svg").exists()
    one = _one_mark(folder)
    x, y = cadcam("station", "measure", *one, "--station-file", "station_6.json", "--json").json["measured"][0][
        "point_mm"
    ]
    known = ("--known", f"{x!r},{y + 200!r}")
    assert cadcam("station", "recalibrate", "station_6.json", *one, *known, "-o", "today.json").code != 0
    assert read_station(folder / "today.json").camera == "6"


def _one_mark(folder: Path) -> tuple[str, ...]:
    """Return the options that give one mark, seen by camera 6."""
    pixels = (folder / "day_pixels.csv").read_text().splitlines()
    positions = {line.split(",")[0]: line for line in (folder / "day_positions.csv").read_text().splitlines()[1:]}
    row = next(line for line in pixels[1:] if positions[line.split(",")[1]].split(",")[1] == "6")
    (folder / "one.csv").write_text(f"{pixels[0]}\n{row}\n")
    return ("--pixels", "one.csv", "--positions", "day_positions.csv")


def test_a_known_mark_recalibrates(cadcam: Cadcam, folder: Path) -> None:
    given = _one_mark(folder)
    x, y = cadcam("station", "measure", *given, "--station-file", "station_6.json", "--json").json["measured"][0][
        "point_mm"
    ]
    known = ("--known", f"{x + 300!r},{y - 200!r}")
    ran = cadcam("station", "recalibrate", "station_6.json", *given, *known, "-o", "new.json")
    assert ran.code == 0
    assert "taken off everywhere" in ran.out
    again = cadcam("station", "measure", *given, "--station-file", "new.json", "--json").json
    assert again["measured"][0]["point_mm"] == pytest.approx([x + 300, y - 200], abs=1e-6)
    assert "give -o FILE to take it off" in cadcam("station", "recalibrate", "station_6.json", *given, *known).out
    metres = f"{x / 1000!r},{y / 1000!r}"
    ran = cadcam("station", "recalibrate", "station_6.json", *given, "--known", metres, "-o", "wrong.json")
    assert (ran.code, ran.out) == (2, "")
    assert "mm from where the mark is measured; expected X,Y of this mark, in mm" in ran.err
    assert not (folder / "wrong.json").exists()


def test_the_report_stands_by_itself(cadcam: Cadcam, folder: Path) -> None:
    assert cadcam(*MEASURE, *BOTH, "--log", "log.jsonl").code == 0
    ran = cadcam(
        *("station", "report", "station_6.json", "station_12.json", "--log", "log.jsonl"),
        *("--drawing", "day_truth.csv", "-o", "report.html"),
    )
    assert ran.code == 0
    page = (folder / "report.html").read_text()
    assert not re.findall(r'(?:src|href)="(?!data:|#)', page)
    for text in ("Camera 6", "Camera 12", "12 measurements", "differences together", "<svg"):
        assert text in page
    headings = re.findall(r"<h([23])>(.*?)</h", page)
    assert [text for level, text in headings if level == "2"] == [
        "How the mechanics deviate over the work area",
        *("Camera 6", "Camera 12", "Against the drawing", "Log"),
    ]
    assert not [text for level, text in headings if level == "3" and text.startswith("Camera")]
    caption = page.partition("</svg>")[2].partition("</section>")[0]
    assert re.search(r"the longest is \d+\.\d mm\. Ellipses at the tips: one sigma, 10 times", caption)
    assert "camera 6: x 4." in caption
    assert page.count("<table>") == page.count('<div class="wide"><table>') > 0  # each scrolls alone on a phone


def test_the_page_on_stations_runs_as_printed(cadcam: Cadcam, folder: Path) -> None:
    pytest.importorskip("matplotlib")
    shell, python = (re.search(rf"```{kind}\n(.*?)```", PAGE, re.DOTALL) for kind in ("sh", "python"))
    assert shell is not None
    assert python is not None
    lines = shell[1].replace("\\\n", " ").splitlines()
    commands = [shlex.split(line, comments=True) for line in lines if line.startswith("cadcam")]
    assert [command[2] for command in commands] == ["simulate", "calibrate", "map", "measure", "report"]
    for command in commands[1:]:
        ran = cadcam(*command[1:])
        assert ran.code == 0, ran.err
    exec(python[1], {})


def other_camera(folder: Path) -> None:
    text = (folder / "day_positions.csv").read_text()
    (folder / "day_positions.csv").write_text(text.replace(",6,", ",7,"))


def far_away(folder: Path) -> None:
    lines = (folder / "day_positions.csv").read_text().splitlines()
    cells = lines[1].split(",")
    lines[1] = ",".join([*cells[:2], "90000.0", *cells[3:]])
    (folder / "day_positions.csv").write_text("\n".join(lines) + "\n")


def wrong_plan(folder: Path) -> None:
    replaced(folder / "plate.json", "[460.0, 280.0]", "[460.0, 180.0]")


def mixed_cameras(folder: Path) -> None:
    replaced(folder / "positions_6.csv", "pgm,6,", "pgm,12,")


def swapped_reflectors(folder: Path) -> None:
    text = (folder / "survey_6.csv").read_text()
    (folder / "survey_6.csv").write_text(text.replace(",a,", ",x,").replace(",b,", ",a,").replace(",x,", ",b,"))


def no_survey(folder: Path) -> None:
    replaced(folder / "survey_6.csv", "plate_6_01.pgm,a", "plate_6_99.pgm,a")


def unknown_mark(folder: Path) -> None:
    replaced(folder / "plate_6_pixels.csv", "\n1,", "\nnine,")


def positions_in_metres(folder: Path) -> None:
    head, *rows = csv.reader((folder / "positions_6.csv").read_text().splitlines())
    metres = [[*row[:2], *(repr(float(v) / 1000) for v in row[2:4]), *row[4:]] for row in rows]
    (folder / "positions_6.csv").write_text("\n".join(map(",".join, [head, *metres])))


def marks_in_metres(folder: Path) -> None:
    plate = json.loads((folder / "plate.json").read_text())
    plate["marks_mm"] = {name: [x / 1000 for x in p] for name, p in plate["marks_mm"].items()}
    (folder / "plate.json").write_text(json.dumps(plate))


CASES = {
    "positions in metres": (CALIBRATE, positions_in_metres, "give the positions in mm, along the axes of the survey"),
    "a plate whose marks are in metres": (CALIBRATE, marks_in_metres, "one of them seems to be in another unit"),
    "a camera without a calibration": ((*MEASURE, *BOTH), other_camera, "it has no calibration"),
    "a position outside the grid": ((*MEASURE, *BOTH), far_away, "extrapolation has to be asked for"),
    "the wrong plan": (CALIBRATE, wrong_plan, "do not fit the plate: residual"),
    "two cameras in one calibration": (CALIBRATE, mixed_cameras, "expected pictures of one camera"),
    "reflectors in a wrong order": (CALIBRATE, swapped_reflectors, "they would fit in the order"),
    "a plate that was not surveyed": (CALIBRATE, no_survey, "plate_6_99.pgm"),
    "a mark that the plate has not": (CALIBRATE, unknown_mark, "unknown mark of the plate 'nine'"),
    "another camera's name": ((*CALIBRATE, "--camera-name", "7"), None, "--camera-name is '7'; expected '6'"),
    "no pictures at all": (("station", "measure", *BOTH), None, "pictures is none given"),
    "no station": ((*MEASURE, "--station-file", "none.json"), None, "none.json: no such file"),
    "a drawing without the mark": ((*MEASURE, *BOTH, "--drawing", "day_truth.csv", "--between", "A,B"), None, "'A'"),
    "a distance without a drawing": ((*MEASURE, *BOTH, "--between", "A,B"), None, "--between"),
    "an unknown reference": (("station", "map", "station_6.json", "--reference", "x"), None, "unknown position 'x'"),
    "a reference for two stations": (
        ("station", "map", "station_6.json", "station_12.json", "--reference", "plate_6_01.pgm"),
        None,
        "--reference is given with 2 stations",
    ),
    "too few marks to simulate": (("station", "simulate", "--marks", "1"), None, "--marks is 1"),
    "no robot": (("station", "simulate", "--robots", ","), None, "robots of the hall is none"),
    "a survey of negative noise": (("station", "simulate", "--survey-sigma", "-1"), None, "-sigma is -1.0; exp"),
    "a negative deflection": (("station", "simulate", "--deflection", "-5"), None, "deflection is -5.0; expected 0"),
    "a look of marks that are listed": ((*MEASURE, *BOTH, "--mark", "dot:40mm"), None, "mark is given beside --pixels"),
    "a radius of marks that are listed": ((*CALIBRATE, "--radius", "8"), None, "--radius is given beside --pixels"),
    "a table of no distances": ((*MEASURE, *BOTH, "--csv", "d.csv"), None, "--csv is given without --drawing"),
    "a block that nobody keeps": ((*MEASURE, *BOTH, "--block", "B1"), None, "--block is given where nothing is kept"),
    "a sensor without a picture": (("station", "simulate", "--sensor", "phone"), None, "--sensor"),
    "an unknown sensor": (
        ("station", "simulate", "x", "--render", "--sensor", "fone"),
        None,
        "did you mean 'phone'?",
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_wrong_input_is_one_clear_error(cadcam: Cadcam, folder: Path, name: str) -> None:
    words, spoil, says = CASES[name]
    if spoil is not None:
        spoil(folder)
    before = sorted(folder.iterdir())
    ran = cadcam(*words)
    assert ran.code == 2
    assert says in ran.err
    assert ran.err.count(f"{' '.join(['cadcam', *words[:2]])}: ") == 1
    assert "Traceback" not in ran.err
    assert sorted(folder.iterdir()) == before


def test_a_mark_of_the_plate_that_was_found_wrongly_is_named(cadcam: Cadcam, folder: Path) -> None:
    """5 px make a residual of 0.8 px, which --limit allows; the stated sigmas would hide them."""
    given = (*CALIBRATE, "--sigma", "0.03")
    assert "px from where the others have it" not in cadcam(*given).out
    file = folder / "plate_6_pixels.csv"
    lines = file.read_text().splitlines()
    name, view, x, y = lines[4].split(",")
    lines[4] = f"{name},{view},{float(x) + 5},{y}"
    file.write_text("\n".join(lines))
    told = " ".join(cadcam(*given).out.split())
    assert re.search(rf"{view}: mark '{name}' is [45]\.\d\d px from where the others have it", told)


@pytest.fixture(scope="session")
def pictured(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with pictures of the plate at four positions and of one mark, half the usual size."""
    folder = tmp_path_factory.mktemp("pictured")
    rng = np.random.default_rng(3)
    hall = make_hall(rng, robots=("6",), camera=Camera.from_focal((384, 288), 2325.0, fy=2535.0))
    surveyed = {}
    for k, at in enumerate(np.array([[6000.0, 15000.0], [9000.0, 15000.0], [6000.0, 17000.0], [9000.0, 17000.0]])):
        middle = hall.plate.marks.mean(axis=0)
        marks, reflectors = hall.survey(0.02, hall.view_centre("6", at) - turn(0.02) @ middle, rng)
        name = f"p{k + 1}.pgm"
        surveyed[name] = reflectors
        write_pgm(
            folder / name,
            hall_picture(hall, "6", at, marks, hall.visit(rng), rng),
            ShotPosition(*at.tolist(), "6"),
        )
    at = np.array([7400.0, 16100.0])
    mark = hall.view_centre("6", at)[None] + 40.0
    write_pgm(folder / "A.pgm", hall_picture(hall, "6", at, mark, Visit(), rng), ShotPosition(*at.tolist(), "6"))
    write_plate(folder / "plate.json", hall.plate)
    write_survey(folder / "survey.csv", hall.plate, surveyed)
    (folder / "truth.json").write_text(json.dumps(mark[0].tolist()))
    return folder


def test_pictures_are_enough(cadcam: Cadcam, pictured: Path, tmp_path: Path) -> None:
    pictures = sorted(pictured.glob("p*.pgm"))
    given = ("--plate", pictured / "plate.json", "--survey", pictured / "survey.csv", "--survey-sigma", "0.1")
    ran = cadcam("station", "calibrate", *pictures, *given, "--repeatability", "0.2", "-o", tmp_path / "s.json")
    assert ran.code == 0, ran.err
    measured = cadcam("station", "measure", pictured / "A.pgm", "--station-file", tmp_path / "s.json", "--json")
    assert measured.code == 0, measured.err
    entry = measured.json["measured"][0]
    off = np.array(entry["point_mm"]) - json.loads((pictured / "truth.json").read_text())
    assert (np.abs(off) < 4 * np.array(entry["sigma_mm"])).all()
    assert entry["mark"] == "A"


def test_a_position_file_that_disagrees_with_the_header_is_refused(
    cadcam: Cadcam, pictured: Path, tmp_path: Path
) -> None:
    (tmp_path / "positions.csv").write_text("picture,camera,x_mm,y_mm\np1.pgm,6,6001.0,15000.0\n")
    given = ("--plate", pictured / "plate.json", "--survey", pictured / "survey.csv")
    ran = cadcam("station", "calibrate", pictured / "p1.pgm", *given, "--positions", tmp_path / "positions.csv")
    assert ran.code == 2
    assert "has for p1.pgm the camera at (6001.00, 15000.00) mm" in ran.err


def test_a_noise_of_zero_is_refused_and_not_taken_for_none_given(
    cadcam: Cadcam, pictured: Path, tmp_path: Path
) -> None:
    given = ("--plate", pictured / "plate.json", "--survey", pictured / "survey.csv", "--survey-sigma", "0.1")
    calibrate = ("station", "calibrate", pictured / "p1.pgm", *given)
    assert cadcam(*calibrate, "-o", tmp_path / "s.json").code == 0
    for words in (calibrate, ("station", "measure", pictured / "A.pgm", "--station-file", tmp_path / "s.json")):
        ran = cadcam(*words, "--sigma", "0")
        assert ran.code == 2
        assert "sigma_px" in ran.err
        assert "a positive number of p" in ran.err


def test_a_plate_picture_is_no_daily_picture(cadcam: Cadcam, pictured: Path, tmp_path: Path) -> None:
    given = ("--plate", pictured / "plate.json", "--survey", pictured / "survey.csv", "--survey-sigma", "0.1")
    assert cadcam("station", "calibrate", pictured / "p1.pgm", *given, "-o", tmp_path / "s.json").code == 0
    ran = cadcam("station", "measure", pictured / "p1.pgm", "--station-file", tmp_path / "s.json")
    assert ran.code == 2
    assert "number of marks in the picture is 8" in ran.err


def test_a_file_that_is_no_log_is_not_added_to(cadcam: Cadcam, folder: Path) -> None:
    """A drawing or a station file named as the log by mistake: lines at its end would make it unreadable."""
    for name in ("day_truth.csv", "station_6.json"):
        before = (folder / name).read_bytes()
        ran = cadcam(*MEASURE, *BOTH, "--log", name)
        assert ran.code == 2
        assert f"{name}: is no log of a station, and would be spoilt" in ran.err
        assert (folder / name).read_bytes() == before
    (folder / "new.jsonl").touch()
    assert cadcam(*MEASURE, *BOTH, "--log", "new.jsonl").code == 0
    assert cadcam(*MEASURE, *BOTH, "--log", "new.jsonl").code == 0
