"""`cadcam inspect`: parts one after the other are judged, kept and reported; nothing is lost, nothing done twice."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import unquote

import numpy as np
import pytest

from cadcam.cli.verbs import inspect
from cadcam.files.camera import write_camera
from cadcam.image.picture import read_picture, write_picture
from cadcam.record.store import open_store
from cadcam.verify import judge

from ..verify.scene import CAMERA, POSE, photographed, plate
from .cell import SIDE, TOLERANCES, Cadcam, inspected, put_like, with_rib_off


def never(*given: object, **named: object) -> None:
    raise AssertionError("it was judged once more")


def test_each_part_gets_a_verdict_a_record_and_a_report_and_all_of_them_a_page(cadcam: Cadcam, cell: Path) -> None:
    ran = inspected(cadcam, "--station", "cell 3")
    assert ran.code == 1  # one FAILs
    told = [re.split(r"  +", line.strip())[:3] for line in ran.out.splitlines()[:2]]
    assert told == [["1/2", "A 9", "PASS"], ["2/2", "A 10", "FAIL"]]
    assert "2 parts: 1 PASS, 1 FAIL; kept in parts.sqlite" in ran.err
    with open_store("parts.sqlite", create=False) as store:
        records = store.query()
    assert [(r.part, r.serial, r.station, r.verdict) for r in records] == [
        ("plate", "A 9", "cell 3", "PASS"),
        ("plate", "A 10", "cell 3", "FAIL"),
    ]
    assert sorted(source.role for source in records[0].sources) == ["cad", "camera", "photo", "start", "tolerances"]
    assert "FAIL" in (cell / "out/parts/A 10.html").read_text()
    page = (cell / "out/index.html").read_text()
    assert 'href="parts/A%2010.html"' in page
    assert "rib" in page


def test_what_was_judged_is_not_judged_again_but_by_other_limits_it_is(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (first,) = [part for part in inspected(cadcam, "--json").json["parts"] if part["serial"] == "A 10"]
    with monkeypatch.context() as patch:
        patch.setattr(judge, "verify_part", never)
        again = inspected(cadcam, "--json")
        assert again.code == 1
        assert [part["judged_before"] for part in again.json["parts"]] == [True, True]
        assert first["id"] in {part["id"] for part in again.json["parts"]}
    Path("tolerances.yaml").write_text(TOLERANCES.replace("0.5", "3"))
    other = inspected(cadcam, "--json")
    assert other.code == 0
    assert [(part["verdict"], part["judged_before"]) for part in other.json["parts"]] == [("PASS", False)] * 2


def test_many_are_asked_for_at_once_and_none_is_taken_for_another(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Three parts, two of them judged; asked for two at a time, and one photo cannot be read."""
    monkeypatch.setattr(inspect, "_ASKED_AT_ONCE", 2)
    (cell / "in/A 10.png").unlink()
    put_like(cell / "in/A 9.png", cell / "B.png", cell / "AA.png")
    (cell / "B.png").rename(cell / "in/B.png")
    inspected(cadcam)
    (cell / "AA.png").rename(cell / "in/AA.png")
    (cell / "in/A.png").mkdir()
    ran = inspected(cadcam, "--json")
    assert [(part["serial"], part["judged_before"]) for part in ran.json["parts"]] == [
        ("A 9", True),
        ("AA", False),
        ("B", True),
    ]
    assert list(ran.json["errors"]) == ["A"]


def test_another_start_or_again_judges_what_was_judged_before(cadcam: Cadcam, cell: Path) -> None:
    """Where the start was wrong nothing was found: by a right one it is looked for anew."""
    (cell / "in/A 10.png").unlink()
    start = Path("pose.txt").read_text()
    Path("pose.txt").write_text(f"{start}\n")
    before = [inspected(cadcam, "--json", *more).json["parts"][0]["judged_before"] for more in ((), ())]
    Path("pose.txt").write_text(start)
    after = [inspected(cadcam, "--json", *more).json["parts"][0]["judged_before"] for more in ((), ("--again",), ())]
    assert (before, after) == ([False, True], [False, False, True])


def test_a_photo_that_cannot_be_judged_is_named_and_the_others_are_judged(cadcam: Cadcam, cell: Path) -> None:
    whole = (cell / "in/A 9.png").read_bytes()
    (cell / "in/A 9.png").write_bytes(whole[:2000])
    write_picture("in/B.png", np.zeros((40, 50)))
    ran = inspected(cadcam, "--json")
    assert ran.code == 2
    assert {part["serial"] for part in ran.json["parts"]} == {"A 10"}
    assert "cut off or damaged" in ran.json["errors"]["A 9"]
    assert "50 x 40" in ran.json["errors"]["B"]
    (cell / "in/B.png").unlink()
    (cell / "in/A 9.png").write_bytes(whole)
    mended = inspected(cadcam, "--json")
    assert mended.code == 1
    assert mended.json["errors"] == {}


def test_a_part_that_is_not_in_the_picture_is_kept_as_not_found(cadcam: Cadcam, cell: Path) -> None:
    rng = np.random.default_rng(3)
    write_picture("in/A 9.png", np.clip(0.5 + rng.normal(scale=0.01, size=CAMERA.size[::-1]), 0, 1))
    (cell / "in/A 10.png").unlink()
    ran = inspected(cadcam, "--json")
    assert ran.code == 3
    assert [(part["verdict"], part["found"]) for part in ran.json["parts"]] == [("UNDECIDED", False)]
    assert "not found in 1 picture" in (cell / "out/index.html").read_text()


def test_interrupted_it_keeps_what_was_judged_and_goes_on_there(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged, calls = judge.verify_part, []

    def once(*given: Any, **how: Any) -> judge.Verification:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return judged(*given, **how)

    monkeypatch.setattr(judge, "verify_part", once)
    broken = inspected(cadcam)
    assert broken.code == 130
    assert "the same command goes on where it was" in broken.err
    assert "A 9" in (cell / "out/index.html").read_text()
    assert [part["judged_before"] for part in inspected(cadcam, "--json").json["parts"]] == [True, False]
    assert len(calls) == 3


def test_it_watches_until_it_is_stopped(cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is there at first; a photo arrives in two pieces; the folder is away for a while."""
    whole = {path.name: path.read_bytes() for path in (cell / "in").iterdir()}
    for name in whole:
        (cell / "in" / name).unlink()
    steps = iter(
        [
            lambda: (cell / "in/A 9.png").write_bytes(whole["A 9.png"][:500]),
            lambda: (cell / "in/A 9.png").write_bytes(whole["A 9.png"]),
            lambda: None,
            lambda: (cell / "in").rename(cell / "away"),
            lambda: (cell / "away").rename(cell / "in"),
            lambda: (cell / "in/A 10.png").write_bytes(whole["A 10.png"]),
            lambda: None,
        ]
    )

    def sleep(seconds: float) -> None:
        if seconds < 0.5:  # before the first look
            return
        step = next(steps, None)
        if step is None:
            raise KeyboardInterrupt
        step()

    monkeypatch.setattr(time, "sleep", sleep)
    ran = inspected(cadcam, "--watch", "--json")
    assert ran.code == 1
    assert [(part["serial"], part["verdict"]) for part in ran.lines] == [("A 9", "PASS"), ("A 10", "FAIL")]
    assert "2 parts: 1 PASS, 1 FAIL; kept in parts.sqlite" in ran.err
    assert "in: No such file or directory" in ran.err


def test_a_program_reads_each_part_as_it_is_judged_and_sigterm_ends_it_as_ctrl_c_does(
    cadcam: Cadcam, cell: Path
) -> None:
    """Meanwhile another `inspect` of the same photos is refused, however they are named, and one of others is not."""
    (cell / "in/A 10.png").rename(cell / "A 10.png")
    (cell / "link").symlink_to("in")
    (cell / "others").mkdir()
    shutil.copy(cell / "in/A 9.png", cell / "others")
    words = ["inspect", "in", "plate.glb", "--camera", "camera.json", "--start", "pose.txt", "--reports", "out"]
    first = subprocess.Popen(
        [sys.executable, "-m", "cadcam", *words, "--tolerances", "tolerances.yaml", "--watch", "--json"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert first.stdout is not None
    try:
        assert json.loads(first.stdout.readline())["verdict"] == "PASS"
        at_work = f"{cell}/in on {socket.gethostname()} is at work already: process {first.pid}, since"
        for photos in ("in", "in/*.png", "in/A*", "link"):
            second = inspected(cadcam, photos=(photos,))
            assert second.code == 2
            assert at_work in second.err
        assert inspected(cadcam, photos=("others",)).code == 0
        write_picture("in/B.png", np.zeros((40, 50)))
        assert "50 x 40" in json.loads(first.stdout.readline())["error"]
        (cell / "A 10.png").rename(cell / "in/A 10.png")
        assert json.loads(first.stdout.readline())["verdict"] == "FAIL"
        first.terminate()
        rest, said = first.communicate()
    finally:
        first.kill()
        first.wait()
    assert (rest, first.returncode) == ("", 2)  # by the photo that could not be judged
    assert "3 parts: 1 PASS, 1 FAIL, 1 could not be judged" in said
    assert "A 10" in (cell / "out/index.html").read_text()
    assert sorted(path.name for path in cell.glob("parts.sqlite*")) == ["parts.sqlite"]
    assert inspected(cadcam, "--json").json["parts"][0]["judged_before"]


def test_a_sigterm_before_the_end_is_told_as_an_interruption(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(judge, "verify_part", lambda *_, **__: signal.raise_signal(signal.SIGTERM))
    assert inspected(cadcam).code == 130
    assert signal.getsignal(signal.SIGTERM) == before


def test_a_part_that_lacks_a_photo_is_told_while_it_waits(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is told once, after a while, and judged as soon as the photo is there."""
    write_camera("front.json", CAMERA, camera_from_world=POSE)
    Path("pose.txt").write_text("# world_from_part, mm\n1 0 0 0\n0 1 0 0\n0 0 1 0\n")
    (cell / "in/A 9.png").unlink()
    photo = np.clip(read_picture(cell / "in/A 10.png") + 1 / 255, 0, 1)
    (cell / "in/A 10.png").rename(cell / "in/1_L.png")
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 14:
            write_picture(cell / "in/1_R.png", photo)
        if len(slept) == 30:
            raise KeyboardInterrupt

    monkeypatch.setattr(inspect, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 100.0 + sum(slept)))
    two = {"photos": ("in/*_L.png", "in/*_R.png"), "camera": "front.json"}
    ran = inspected(cadcam, "--camera", "front.json", "--watch", "--json", **two)
    told, judged = ran.lines
    assert told == {"serial": "1", "incomplete": "waits for in/1_R.png"}
    assert (judged["serial"], judged["verdict"]) == ("1", "FAIL")
    assert ran.err.count("1: waits for in/1_R.png") == 1


def test_reports_of_long_and_of_unreadable_names_are_linked(cadcam: Cadcam, cell: Path) -> None:
    """Serial numbers as long as a name may be, alike but for their ends, and one of bytes that are no UTF-8."""
    serials = ["\u00fc" * 125 + "A", "\u00fc" * 125 + "B", os.fsdecode(b"gr\xfcn")]
    put_like(cell / "in/A 9.png", *(cell / f"in/{serial}.png" for serial in serials))
    ran = inspected(cadcam, "--json")
    assert ran.json["errors"] == {}
    link = re.compile(r'<td[^>]*><a href="([^"]*)"><span[^>]*>([^<]*)')
    links = {serial: unquote(to) for to, serial in link.findall((cell / "out/index.html").read_text())}
    assert set(links) == {"A 9", "A 10", *serials[:2], r"gr\udcfcn"}
    assert len(set(links.values())) == 5
    for serial, to in links.items():
        assert serial in (cell / "out" / to).read_text()
    (cell / "out/index.html").unlink()
    assert inspected(cadcam, "--again", "--json").code == 1
    again = link.findall((cell / "out/index.html").read_text())
    assert {serial: unquote(to) for to, serial in again} == links


def test_while_it_waits_the_page_has_all_parts_and_looks_are_apart(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second of two parts, judged a moment after the page was written; no two looks are made at once."""
    slept: list[float] = []
    pages: list[str] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        if len(slept) == 5:
            pages.append((cell / "out/index.html").read_text())
            raise KeyboardInterrupt

    inspected(cadcam)  # what is judged already takes no time
    (cell / "out/index.html").unlink()
    monkeypatch.setattr(inspect, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 100.0 + sum(slept)))
    inspected(cadcam, "--watch")
    assert "A 9" in pages[0]
    assert "A 10" in pages[0]
    assert slept[1:] == [1.0] * 4


def test_of_a_part_that_is_photographed_anew_the_last_verdict_counts(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    good = (cell / "in/A 9.png").read_bytes()
    (cell / "in/A 9.png").unlink()
    steps = iter(
        [lambda: None, lambda: None, lambda: (cell / "in/A 10.png").write_bytes(good), lambda: None, lambda: None]
    )
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        step = next(steps, None)
        if step is None:
            raise KeyboardInterrupt
        step()

    monkeypatch.setattr(inspect, "time", SimpleNamespace(sleep=sleep, monotonic=lambda: 100.0 + sum(slept)))
    ran = inspected(cadcam, "--watch", "--json")
    assert ran.code == 0
    assert [(part["serial"], part["verdict"]) for part in ran.lines] == [("A 10", "FAIL"), ("A 10", "PASS")]
    assert "1 part: 1 PASS" in ran.err
    with open_store("parts.sqlite", create=False) as store:
        assert [record.verdict for record in store.query()] == ["FAIL", "PASS"]
    page = (cell / "out/index.html").read_text()
    assert "<b>1</b> PASS" in page
    assert "</b> FAIL" not in page


def test_the_page_says_what_the_run_says_where_limits_are_changed_back(cadcam: Cadcam, cell: Path) -> None:
    """What was judged by the other limits is later, but not what holds now: a bad part stood there as good."""
    inspected(cadcam)
    Path("tolerances.yaml").write_text(TOLERANCES.replace("0.5", "3"))
    inspected(cadcam)
    Path("tolerances.yaml").write_text(TOLERANCES)
    assert inspected(cadcam).code == 1
    assert re.search(r"<b>1</b> FAIL.*<b>1</b> PASS", (cell / "out/index.html").read_text())


def test_parts_whose_photos_are_gone_stay_on_the_page(cadcam: Cadcam, cell: Path) -> None:
    """Photos were put away into an archive, and the command started anew."""
    inspected(cadcam)
    (cell / "in/A 10.png").unlink()
    put_like(cell / "in/A 9.png", cell / "in/A 11.png")
    assert inspected(cadcam).code == 0
    page = (cell / "out/index.html").read_text()
    for serial in ("A 9", "A 10", "A 11"):
        assert f'href="parts/{serial.replace(" ", "%20")}.html"' in page
    assert re.search(r"<b>1</b> FAIL.*<b>2</b> PASS", page)


def test_limits_that_are_changed_meanwhile_are_not_those_that_were_judged_by(
    cadcam: Cadcam, cell: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    judged = judge.verify_part

    def change(*given: Any, **how: Any) -> judge.Verification:
        Path("tolerances.yaml").write_text(TOLERANCES.replace("0.5", "3"))
        return judged(*given, **how)

    monkeypatch.setattr(judge, "verify_part", change)
    inspected(cadcam)
    monkeypatch.undo()
    monkeypatch.chdir(cell)
    assert [part["judged_before"] for part in inspected(cadcam, "--json").json["parts"]] == [False, False]


def test_photos_of_two_cameras_are_paired_by_serial(cadcam: Cadcam, cell: Path) -> None:
    write_camera("front.json", CAMERA, camera_from_world=POSE)
    write_camera("side.json", CAMERA, camera_from_world=SIDE)
    Path("pose.txt").write_text("# world_from_part, mm\n1 0 0 0\n0 1 0 0\n0 0 1 0\n")
    rng = np.random.default_rng(8)
    for name, mesh in (("1", plate()), ("2", with_rib_off())):
        write_picture(f"in/{name}_F.png", photographed(mesh, rng))
        write_picture(f"in/{name}_S.png", photographed(mesh, rng, SIDE))
    write_picture("in/3_F.png", photographed(plate(), rng))
    ran = inspected(cadcam, "--camera", "side.json", "--json", photos=("in/*_F.png", "in/*_S.png"), camera="front.json")
    assert [(part["serial"], part["verdict"]) for part in ran.json["parts"]] == [("1", "PASS"), ("2", "FAIL")]
    assert ran.json["incomplete"] == ["3"]
    assert ran.code == 2  # one was not judged
    assert "waits for in/3_S.png" in Path("out/index.html").read_text()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (("in/A 9.png", "plate.glb"), "`cadcam verify` judges one part"),
        (("empty", "plate.glb"), "number of parts in empty is 0; expected pictures"),
        (("in", "plate.glb", "--reports", "in"), "holds the pictures that are read"),
        (("in", "in", "plate.glb"), "--camera is given once for 2 photos"),
        (("plate.glb", "in"), "the model last"),
    ],
)
def test_a_mistake_is_explained(cadcam: Cadcam, cell: Path, words: tuple[str, ...], says: str) -> None:
    Path("empty").mkdir()
    ran = cadcam("inspect", *words, "--camera", "camera.json")
    assert ran.code == 2
    assert says in ran.err
    assert not Path("parts.sqlite").exists()


def test_records_can_be_asked_for_by_the_file_they_came_from(cadcam: Cadcam, cell: Path) -> None:
    inspected(cadcam)
    assert json.loads(cadcam("state", "list", "--source", "camera.json", "--json").out)["of"] == 2
    listed = json.loads(cadcam("state", "list", "--source", "in/A 10.png", "--json").out)
    assert [record["serial"] for record in listed["records"]] == ["A 10"]
    Path("other.txt").write_text("of nothing")
    assert "no record fits --source" in cadcam("state", "list", "--source", "other.txt").err
