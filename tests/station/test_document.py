"""Station, plate, survey and drawing files, logs and records: what was written comes back, what is wrong is named."""

from __future__ import annotations

import json

import numpy as np
import pytest

from cadcam.errors import BadValue, UnreadableFile, UnwritableFile
from cadcam.record.store import open_store
from cadcam.station.document import read_plate, read_station, read_stations, write_plate, write_station
from cadcam.station.log import append_log, log_entries, read_log, records
from cadcam.station.measure import measure_marks
from cadcam.station.plate import Plate
from cadcam.station.simulate import day, sight
from cadcam.station.survey import read_drawing, read_survey, write_drawing, write_survey


@pytest.fixture
def work(hall, rng):
    return day(hall, rng, marks=4)


def test_a_station_measures_the_same_after_it_was_written_and_read(tmp_path, hall, stations, work, rng):
    at = stations["6"].grid[7]
    known = hall.view_centre("6", at)
    again = stations["6"].recalibrated(sight(hall, "known", "6", at, known, rng), known, sigma_mm=0.1)
    write_station(tmp_path / "s.json", again)
    back = {**stations, "6": read_station(tmp_path / "s.json")}
    one, other = (measure_marks({**stations, "6": s["6"]}, work.sightings) for s in ({"6": again}, back))
    assert np.array_equal(one.points, other.points)
    assert other.joint_covariance() == pytest.approx(one.joint_covariance(), rel=1e-6, abs=1e-9)


def spoiled(path, *keys, value):
    document = json.loads(path.read_text())
    inner = document
    for key in keys[:-1]:
        inner = inner[key]
    if value is None:
        del inner[keys[-1]]
    else:
        inner[keys[-1]] = value
    path.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("keys", "value", "says"),
    [
        (("format",), "x", "says its format is 'x'; only 'cadcam station' is read here"),
        (("version",), 9, "version 9"),
        (("positions", 3, "position_mm"), [1.0], "positions.3.position_mm"),
        (("positions", 0, "survey_mm", "a"), None, "has no 'a'"),
        (("positions", 0, "survey_mm", "a"), [0.0, 0.0], "positions.0 is refused: the surveyed reflectors"),
        (("positions", 0, "pixels_px", "9"), [1.0, 2.0], "names the mark '9'"),
        (("positions",), {}, "is not a list"),
        (("positions",), [], "at least 1 position; 0 given"),
        (("repeatability", "covariance_mm2"), [[1.0]], "repeatability"),
        (("plate", "colour"), "red", "unknown key 'colour'"),
    ],
)
def test_what_is_wrong_in_a_station_file_is_named(tmp_path, stations, keys, value, says):
    path = tmp_path / "s.json"
    write_station(path, stations["6"])
    spoiled(path, *keys, value=value)
    with pytest.raises(UnreadableFile, match=says):
        read_station(path)


def test_a_camera_has_one_calibration(tmp_path, stations):
    write_station(tmp_path / "a.json", stations["6"])
    with pytest.raises(UnreadableFile, match="a second calibration of camera '6'"):
        read_stations([tmp_path / "a.json"] * 2)
    with pytest.raises(BadValue, match="station files"):
        read_stations([])


def test_a_plate_comes_back(tmp_path):
    write_plate(tmp_path / "plate.json", Plate.b4())
    back = read_plate(tmp_path / "plate.json")
    assert np.array_equal(back.points, Plate.b4().points)
    assert (back.sigma_mm, back.mark, back.reflector_names) == (0.2, Plate.b4().mark, ("a", "b", "c", "d"))


def test_surveys_and_drawings_come_back(tmp_path, rng):
    b4 = Plate.b4()
    plate = Plate(b4.marks, b4.reflectors, reflector_names=("a", "b, left", 'c "inner"', "d"))
    places = {"p1.pgm": rng.normal(size=(4, 2)), "p, 2.pgm": rng.normal(size=(4, 2))}
    write_survey(tmp_path / "survey.csv", plate, places)
    back = read_survey(tmp_path / "survey.csv", plate)
    assert all(np.array_equal(back[name], places[name]) for name in places)
    write_drawing(tmp_path / "drawing.csv", {"A, upper": np.array([1.5, 2.0])})
    assert read_drawing(tmp_path / "drawing.csv")["A, upper"].tolist() == [1.5, 2.0]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("picture,reflector,x_mm\np,a,1\n", "has no column y_mm"),
        ("picture,reflector,x_mm,y_mm\n", "no lines below"),
        ("picture,reflector,x_mm,y_mm\np,z,1,2\n", "line 2 names the reflector 'z'"),
        ("picture,reflector,x_mm,y_mm\np,a,1,2\np,a,1,2\n", "gives reflector 'a' of p again"),
        ("picture,reflector,x_mm,y_mm\np,a,1,2\n", "has no reflector 'b' for p"),
        ("picture,reflector,x_mm,y_mm\np,a,1\n", "line 2 has 3 cells"),
        ("picture,reflector,x_mm,y_mm\np,a,one,2\n", "column x_mm is 'one'"),
    ],
)
def test_what_is_wrong_in_a_survey_is_named(tmp_path, text, says):
    (tmp_path / "survey.csv").write_text(text)
    with pytest.raises(UnreadableFile, match=says):
        read_survey(tmp_path / "survey.csv", Plate.b4())


def test_entries_that_the_disk_does_not_hold_leave_the_log_as_it_was(tmp_path, stations, work):
    """A disk that takes a part of a write reports no error until the next one: half a line would spoil the log."""
    resource = pytest.importorskip("resource")
    log, entries = tmp_path / "log.jsonl", log_entries(measure_marks(stations, work.sightings), work.sightings)
    append_log(log, entries[:1])
    before = log.read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 40, hard))
    try:
        with pytest.raises(UnwritableFile, match=r"log\.jsonl: cannot be written"):
            append_log(log, entries[1:])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert log.read_bytes() == before
    append_log(log, entries[1:])
    assert read_log(log) == json.loads(json.dumps(entries))


def test_a_log_grows_and_is_never_rewritten(tmp_path, stations, work):
    separated = "B\u20281"  # a separator of lines, for Python; not for JSON lines
    entries = log_entries(measure_marks(stations, work.sightings), work.sightings, block=separated)
    append_log(tmp_path / "log.jsonl", entries[:1])
    before = (tmp_path / "log.jsonl").read_bytes()
    append_log(tmp_path / "log.jsonl", entries[1:])
    assert (tmp_path / "log.jsonl").read_bytes().startswith(before)
    assert read_log(tmp_path / "log.jsonl") == json.loads(json.dumps(entries))
    with (tmp_path / "log.jsonl").open("a") as file:
        file.write('{"mark": ')
    with pytest.raises(UnreadableFile, match="line 5 is not JSON"):
        read_log(tmp_path / "log.jsonl")


@pytest.mark.parametrize(
    "line",
    [
        '{"mark": "A", "point_mm": "abc"}',
        '{"mark": "A", "point_mm": [1, null]}',
        '{"mark": "A", "point_mm": [NaN, 3]}',
        '{"mark": 3, "point_mm": [1, 3]}',
        '{"mark": "A", "point_mm": [1, 3], "half_width_95_mm": "x"}',
    ],
)
def test_a_line_of_the_log_that_is_no_measurement_is_named(tmp_path, line):
    """A place that is none crashed the report, or made its statistics NaN."""
    (tmp_path / "log.jsonl").write_text('{"mark": "B", "point_mm": [0, 1]}\n' + line + "\n")
    with pytest.raises(UnreadableFile, match="line 2"):
        read_log(tmp_path / "log.jsonl")


def test_records_keep_the_place_with_its_covariance_and_the_deviation_from_the_drawing(tmp_path, stations, work):
    found = measure_marks(stations, work.sightings)
    kept = records(found, work.sightings, drawn={"mark01": work.points[0]}, serial="B1")
    with open_store(tmp_path / "parts.sqlite") as store:
        store.add(*kept)
        back = store.query(part="mark", serial="B1")
    assert len(back) == 4
    one = next(r for r in back if r.deviations)
    assert one.pose is not None
    assert one.pose.world_from_part.translation == pytest.approx(found.points[0])
    assert one.pose.covariance[:2, :2] == pytest.approx(found.covariance[0, :2, :2])
    assert [d.deviation for d in one.deviations] == pytest.approx(found.points[0, :2] - work.points[0])
    assert [d.expanded_uncertainty for d in one.deviations] == pytest.approx(2 * found.sigma[0, :2])
