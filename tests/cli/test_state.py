"""`cadcam state` keeps, lists, shows, exports, finds the scatter of a feature; a stranger's mistakes are explained."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Callable
from getpass import getuser
from pathlib import Path
from typing import Any

import pytest

from cadcam.record.export import write_records
from cadcam.record.record import Deviation, Finding, Record
from cadcam.record.rows import record_of

from .job import Ran

Cadcam = Callable[..., Ran]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, and results of three parts in it."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("CADCAM_STORE", raising=False)
    records = [
        Record("bracket", f"S{n}", verdict="FAIL" if n == 2 else "PASS", deviations=(Deviation("rib", 0.1 * n, 0.02),))
        for n in range(3)
    ]
    write_records("three.jsonl", records)
    return tmp_path


def test_results_are_kept_in_this_folder_and_listed(cadcam: Cadcam, here: Path) -> None:
    added = cadcam("state", "add", "three.jsonl", "--station", "cell 3")
    assert added.code == 0
    assert "3 records added" in added.err
    listed = cadcam("state", "list")
    assert [line.split()[4] for line in listed.out.splitlines() if "bracket" in line] == ["S0", "S1", "S2"]
    assert listed.out.count("cell 3") == 3
    assert "2 PASS, 1 FAIL" in listed.out
    assert (here / "parts.sqlite").exists()


def test_a_trend_begins_long_reasons_where_it_begins_deviations(cadcam: Cadcam, here: Path) -> None:
    rib = Deviation("rib", 0.05, 0.02)
    why = Finding(
        "rib", "position", reason="unclear: " + "its edges are off, by no more than a shadow may move them " * 2
    )
    write_records("made.jsonl", [Record("plate", "A", deviations=(rib,)), Record("plate", "B", findings=(why,))])
    cadcam("state", "add", "made.jsonl")
    lines = cadcam("state", "trend", "rib").out.partition("Over all")[0].splitlines()
    begins = [line.index(said) for line in lines for said in ("deviation  ", "0.050 +- ", "unclear: ") if said in line]
    assert len(begins) == 3
    assert len(set(begins)) == 1


def test_a_list_names_what_is_missing_before_what_is_off(cadcam: Cadcam, here: Path) -> None:
    """A part failed for want of its block: that its rib takes up 5 % of its tolerance is no reason."""
    rib = (Deviation("rib", 0.05, 0.02, lower=-1, upper=1, verdict="PASS"),)
    gone = [Finding(name, verdict="FAIL", reason="missing: 0 of 7 edges that should show are seen") for name in "ab"]
    unseen = Finding("block", "position", verdict="UNDECIDED", reason="not in view")
    made = [("A", (), "PASS"), ("B", gone[:1], "FAIL"), ("C", gone, "FAIL"), ("D", [unseen], "UNDECIDED")]
    write_records(
        "made.jsonl",
        [Record("plate", s, deviations=rib, findings=tuple(f), verdict=verdict) for s, f, verdict in made],
    )
    cadcam("state", "add", "made.jsonl")
    said = cadcam("state", "list").out.splitlines()
    worst = [re.split(r"\s{2,}", line.strip())[-1] for line in said if " plate " in line]
    assert worst == ["rib 5 %", "a missing", "a missing, and 1 more", "rib 5 %"]


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [("k", 0.0, "k of 'rib' is 0"), ("lower_mm", 1.0, "tolerance of 'rib' is 1 to 0.5; expected lower at most upper")],
)
def test_a_deviation_that_means_nothing_is_not_kept(
    cadcam: Cadcam, here: Path, key: str, value: float, said: str
) -> None:
    document = json.loads(Path("three.jsonl").read_text().splitlines()[0])
    document["deviations"][0] |= {"upper_mm": 0.5, key: value}
    Path("one.jsonl").write_text(json.dumps(document) + "\n")
    ran = cadcam("state", "add", "one.jsonl")
    assert ran.code == 2
    assert said in ran.err


def test_a_list_reads_no_more_records_than_it_prints(
    cadcam: Cadcam, here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cadcam("state", "add", "three.jsonl")
    read: list[str] = []

    def counted(row: dict[str, Any], *belonging: Any) -> Record:
        read.append(row["serial"])
        return record_of(row, *belonging)

    monkeypatch.setattr("cadcam.record.store.record_of", counted)
    listed = cadcam("state", "list", "--newest", "1", "--json").json
    assert ([r["serial"] for r in listed["records"]], listed["of"]) == (["S2"], 3)
    assert "the latest of 3" in cadcam("state", "list", "--newest", "1").out
    assert "known: S0, S1, S2" in cadcam("state", "list", "--serial", "S9").err
    assert read == ["S2", "S2"]


def test_a_record_is_shown_by_the_beginning_of_its_id(cadcam: Cadcam, here: Path) -> None:
    ids = cadcam("state", "add", "three.jsonl", "--json").json["added"]
    shown = cadcam("state", "show", ids[2][:8])
    assert shown.code == 0
    assert "rib" in shown.out
    assert "0.200 +- 0.020 mm" in shown.out
    assert cadcam("state", "show", ids[2], "--json").json["serial"] == "S2"
    wrong = cadcam("state", "show", "zzzzzz")
    assert wrong.code == 2
    assert "id is 'zzzzzz', the beginning of no ids in parts.sqlite; expected that of one record" in wrong.err


def test_a_trend_tells_mean_and_sigma(cadcam: Cadcam, here: Path) -> None:
    cadcam("state", "add", "three.jsonl")
    said = cadcam("state", "trend", "rib", "--json").json
    assert said["mean_mm"] == pytest.approx(0.1)
    assert said["sigma_mm"] == pytest.approx(0.1)
    assert said["measured_sigma_mm"] == pytest.approx(0.01)
    assert (said["verdicts"], said["without"]) == ({"": 3}, [])
    assert "sigma from part to part, mm" in cadcam("state", "trend", "rib").out
    assert cadcam("state", "trend", "rip").err.count("did you mean 'rib'") == 1


def test_a_trend_of_many_prints_the_latest_and_counts_all(cadcam: Cadcam, here: Path) -> None:
    cadcam("state", "add", "three.jsonl")
    ran = cadcam("state", "trend", "rib", "--newest", "1")
    assert "rib, 1 record, the latest of 3" in ran.out
    assert (" S1 " in ran.out, " S2 " in ran.out) == (False, True)
    assert "3 not judged" in ran.out
    assert len(cadcam("state", "trend", "rib", "--newest", "1", "--json").json["points"]) == 3
    refused = cadcam("state", "trend", "rib", "--newest", "0")
    assert (refused.code, "--newest is 0; expected 1 or more" in refused.err) == (2, True)


def test_since_when_a_part_is_missing(cadcam: Cadcam, here: Path) -> None:
    verdicts = ("PASS", "FAIL", "FAIL")
    kept = [
        Record("block", f"B{n}", findings=(Finding("rib", verdict=verdict, reason=f"as of B{n}"),))
        for n, verdict in enumerate(verdicts)
    ]
    write_records("block.jsonl", kept)
    cadcam("state", "add", "block.jsonl")
    assert "B1, 2 records" in cadcam("state", "trend", "rib").out
    said = cadcam("state", "trend", "rib", "--json").json
    assert said["at_the_end"] == {"verdict": "FAIL", "since_utc": said["points"][1]["time_utc"]}
    assert said["points"][2]["reason"] == "as of B2"
    assert not [key for key in said if key.startswith("mean")]


def test_since_when_a_part_is_missing_that_was_never_judged(cadcam: Cadcam, here: Path) -> None:
    kept: list[Record] = [Record("block", "B0", deviations=(Deviation("rib", 0.1, 0.02),))]
    kept += [Record("block", f"B{n}", findings=(Finding("rib", "position", reason="missing"),)) for n in (1, 2)]
    write_records("block.jsonl", kept)
    cadcam("state", "add", "block.jsonl")
    told = cadcam("state", "trend", "rib").out
    assert re.search(r"at the end +missing since .*B1, 2 records", told)
    assert re.search(r"could not be measured +2 of 3 records", told)
    said = cadcam("state", "trend", "rib", "--json").json
    assert said["at_the_end"] == {"verdict": "", "reason": "missing", "since_utc": said["points"][1]["time_utc"]}
    assert cadcam("state", "list").out.count("not found") == 3  # records without a pose


def test_a_file_that_breaks_off_adds_nothing(cadcam: Cadcam, here: Path) -> None:
    cadcam("state", "add", "three.jsonl")
    many = Path("three.jsonl").read_text().splitlines()[0]
    lines = [many.replace('"id": "', f'"id": "{n} ') for n in range(700)]
    Path("cut.jsonl").write_text("\n".join([*lines, '{"part": ']))
    ran = cadcam("state", "add", "cut.jsonl")
    assert (ran.code, ran.out) == (2, "")
    assert "cut.jsonl: line 701 is not JSON" in ran.err
    assert cadcam("state", "list", "--json").json["of"] == 3


def test_where_nothing_fits_it_is_said_why(cadcam: Cadcam, here: Path) -> None:
    """A list may well be empty; a trend of nothing is none."""
    cadcam("state", "add", "three.jsonl")
    unknown = "store parts.sqlite: unknown part 'brackets'; did you mean 'bracket'? (known: bracket)"
    listed = cadcam("state", "list", "--part", "brackets")
    assert (listed.code, listed.out, listed.err) == (0, "0 records\n\n", f"{unknown}\n")
    trend = cadcam("state", "trend", "rib", "--part", "brackets")
    assert (trend.code, trend.err) == (2, f"cadcam state trend: {unknown}\n")
    both = ("--serial", "S0", "--verdict", "FAIL")
    exported = cadcam("state", "export", "-o", "none.csv", *both).err
    assert exported.startswith("store parts.sqlite: no record fits --serial, --verdict (3 records in all)\n")
    assert "known: S0, S1, S2" in cadcam("state", "trend", "rib", "--serial", "S9").err


def test_an_export_is_csv_for_people_and_json_for_another_store(cadcam: Cadcam, here: Path) -> None:
    cadcam("state", "add", "three.jsonl")
    assert cadcam("state", "export", "-o", "fail.csv", "--verdict", "FAIL").code == 0
    with (here / "fail.csv").open() as file:
        assert [row["serial"] for row in csv.DictReader(file)] == ["S2"]
    cadcam("state", "export", "-o", "all.json")
    assert cadcam("state", "add", "all.json", "--store", "other.sqlite").code == 0
    assert cadcam("state", "list", "--store", "other.sqlite", "--json").json["of"] == 3


def test_the_environment_names_the_store(cadcam: Cadcam, here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CADCAM_STORE", "yard.sqlite")
    cadcam("state", "add", "three.jsonl")
    assert (here / "yard.sqlite").exists()
    assert not (here / "parts.sqlite").exists()


def test_the_last_day_counts_to_its_end(cadcam: Cadcam, here: Path) -> None:
    (here / "one.json").write_text('{"part": "p", "time_utc": "2026-03-01T18:00:00Z", "deviations": []}')
    cadcam("state", "add", "one.json")
    days = (("2026-03-01", "2026-03-01", 1), ("20260301", "20260301", 1), ("2026-03-02", "2026-03-03", 0))
    for since, until, count in (*days, ("2026-03-01T17", "2026-03-01T17:59", 0)):
        assert cadcam("state", "list", "--since", since, "--until", until, "--json").json["of"] == count


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("list",), "parts.sqlite: no such file; check the path; `cadcam state add` begins a store"),
        (("list", "--store", "three.jsonl"), "not an SQLite file"),
        (("list", "--store", "mysql://localhost/x"), "unknown kind of store 'mysql'"),
        (("list", "--store", "postgresql://u:secret@127.0.0.1:1/x"), "store postgresql+pg8000://u:***@127.0.0.1:1/x"),
        (("list", "--store", "postgresql://127.0.0.1:1/x"), f"postgresql+pg8000://{getuser()}@127.0.0.1:1/x: Can't"),
        (("list", "--store", "postgresql+nodriver://u@127.0.0.1:1/x"), "no driver is called 'nodriver'"),
        (
            ("list", "--store", "postgresql://u:secret@127.0.0.1:1/x?sslmode=require"),
            "'sslmode'); leave it out, or name",
        ),
        (("list", "--since", "2026-03-02", "--until", "2026-03-01"), "after --until; expected a time before it"),
        (("add", "three.jsonl", "--store", "no/such/folder.sqlite"), "mkdir -p"),
        (("add", "nothing.json"), "no such file"),
        (("add", "empty.json"), "is neither an export nor the JSON of `cadcam verify`"),
        (("add", "table.csv"), "table.csv: is a table for spreadsheets; give the export as .json or .jsonl"),
    ],
)
def test_a_mistake_is_explained(cadcam: Cadcam, here: Path, words: tuple[str, ...], says: str) -> None:
    (here / "empty.json").write_text(json.dumps({}))
    (here / "table.csv").write_text("part,serial\n")
    ran = cadcam("state", *words)
    assert ran.code == 2
    assert says in ran.err
    assert "secret" not in ran.err


def test_a_file_that_cannot_be_read_begins_no_store(cadcam: Cadcam, here: Path) -> None:
    (here / "cut.json").write_text('{"part": ')
    ran = cadcam("state", "add", "cut.json", "--store", "new.sqlite")
    assert (ran.code, ran.out) == (2, "")
    assert "cut.json: is not JSON" in ran.err
    assert not (here / "new.sqlite").exists()
