"""Which way a part is followed: the cheapest that finds it; what is lost is looked for; a break changes nothing."""

from __future__ import annotations

import errno
import io
import json
import os
import re
import tracemalloc
from collections.abc import Callable
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cadcam.camera.viewpoint import Viewpoint
from cadcam.errors import BadValue, NothingInView, UnreadableFile, UnwritableFile
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from cadcam.locate.freedom import Freedom
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.track import tracker as module
from cadcam.locate.track.frames import Frame, Frames
from cadcam.locate.track.log import COLUMNS, TrackLog, head_of, read_track_log, track_part_to_log
from cadcam.locate.track.tracker import LoggedFrame, track_part
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

from .moving import CAMERA, FIRST, STEP, Sighting, block, frames, location, measured, truth

PART = block()
Install = Callable[..., Sighting]


@pytest.fixture
def sighting(monkeypatch: pytest.MonkeyPatch) -> Install:
    """Return a function that puts a stand-in in the place of what locates."""

    def install(n: int, **given: Any) -> Sighting:
        made = Sighting(truth(n), **given)
        monkeypatch.setattr(module, "refine_pose", made.refine)
        monkeypatch.setattr(module, "locate_part", made.locate)
        return made

    return install


def test_even_motion_is_predicted_and_costs_one_look_a_frame(sighting: Install) -> None:
    """The block moves 5 mm a frame, refinement reaches 1 mm: only the prediction is near enough."""
    seen = sighting(8)
    tracked = list(track_part(PART, frames(8), FIRST))
    assert [t.how for t in tracked] == ["recovered", "recovered", *["predicted"] * 6]
    assert seen.calls[-6:] == [("refine", i) for i in range(2, 8)]
    for one, pose in zip(tracked, truth(8), strict=True):
        np.testing.assert_array_equal(one.location.pose.world_from_part.matrix, pose.matrix)


def test_rounding_does_not_grow_from_frame_to_frame(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refinement here returns the prediction itself, a product of the poses before it, for 200 frames.

    Without care each frame triples the defect: 3^200 eps. With it each is that of one product, some eps.
    """
    monkeypatch.setattr(module, "refine_pose", lambda part, photos, start, **_: location(start))
    still = [frame for _ in range(200) for frame in frames(1)]
    numbered = [replace(frame, index=i) for i, frame in enumerate(still)]
    history = [LoggedFrame(-2, measured(FIRST)), LoggedFrame(-1, measured(FIRST @ STEP))]
    *_, last = track_part(PART, numbered, history=history)
    R = last.location.pose.world_from_part.rotation
    assert np.abs(R @ R.T - np.eye(3)).max() < 20 * np.finfo(float).eps


def test_without_velocity_the_part_is_expected_where_it_was(sighting: Install) -> None:
    """It moves 5 mm a frame and refinement reaches 4 mm: never where it was, at last where it was going."""
    sighting(5, near_mm=4.0)
    assert [t.how for t in track_part(PART, frames(5), FIRST, velocity=False)] == ["recovered"] * 5
    assert [t.how for t in track_part(PART, frames(5), FIRST)] == ["recovered"] * 2 + ["predicted"] * 3


def test_without_a_start_the_part_is_searched_for(sighting: Install) -> None:
    sighting(3)
    assert [t.how for t in track_part(PART, frames(3))] == ["searched", "recovered", "predicted"]


def test_it_is_searched_for_within_the_range_of_views_that_was_declared(sighting: Install) -> None:
    """Before it was found, and once it has been lost for long."""
    above, seen = ViewRange.above(within_deg=50.0), sighting(12, hidden={0, *range(4, 11)})
    list(track_part(PART, frames(12), views=above))
    searched = [index for how, index in seen.calls if how == "search"]
    assert (searched[:2], max(searched) > 4, seen.views) == ([0, 1], True, [above] * len(searched))


def test_a_short_loss_is_recovered_around_the_last_pose(sighting: Install) -> None:
    """Gone for two frames the block is 15 mm away: in reach of a search around the last pose, no motion is made up."""
    seen = sighting(8, hidden={3, 4})
    tracked = list(track_part(PART, frames(8), FIRST))
    ways = [t.how for t in tracked]
    assert ways == ["recovered", "recovered", "predicted", "lost", "lost", "recovered", "recovered", "predicted"]
    assert [t.found for t in tracked] == [t.how != "lost" for t in tracked]
    assert ("refine", 5) not in seen.calls


def test_a_long_loss_is_searched_for_without_a_start_but_rarely(sighting: Install) -> None:
    """Hidden from frame 2 to 39, then 190 mm away: found at the next search, never more than eight frames late."""
    seen = sighting(60, hidden=set(range(2, 40)))
    tracked = list(track_part(PART, frames(60), FIRST))
    searched = [i for how, i in seen.calls if how == "search"]
    assert searched == [4, 6, 10, 18, 26, 34, 42]
    first = next(t for t in tracked[40:] if t.found)
    assert (first.frame.index, first.how) == (42, "searched")
    assert all(t.found for t in tracked[42:])


@pytest.mark.parametrize(("quality", "found"), [(0.6, False), (0.8, True)])
def test_a_part_that_jumped_must_be_clear_to_be_found(
    monkeypatch: pytest.MonkeyPatch, quality: float, found: bool
) -> None:
    """30 px aside in one frame; what is near its last place needs no more than what any pose needs."""
    aside = Rigid(translation=[30 * 400 / CAMERA.fx, 0, 0]) @ FIRST
    where = {0: FIRST, 1: FIRST, 2: aside}
    monkeypatch.setattr(module, "refine_pose", lambda *_, **__: location(FIRST, 0.1))

    def locate(part: Part, photos: tuple[Photo, ...], start: Rigid | None = None, **_: Freedom) -> Location:
        return location(where[round(float(photos[0].gray[0, 0]) * 255)], quality)

    monkeypatch.setattr(module, "locate_part", locate)
    tracked = list(track_part(PART, frames(3), FIRST))
    assert [t.found for t in tracked] == [True, True, found]
    assert found or "far from where the part was" in tracked[2].location.reason


def test_a_motion_out_of_the_pictures_is_a_loss_but_a_start_outside_is_an_error(
    sighting: Install, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = sighting(4)
    blind: list[int] = [2]

    def refine(part: Part, photos: tuple[Photo, ...], start: Rigid, **how: Freedom) -> Location:
        if round(float(photos[0].gray[0, 0]) * 255) in blind:
            raise NothingInView("outside of every photo")
        return seen.refine(part, photos, start, **how)

    monkeypatch.setattr(module, "refine_pose", refine)
    assert [t.how for t in track_part(PART, frames(4), FIRST)] == ["recovered", "recovered", "recovered", "predicted"]

    def locate(*_: object, **__: object) -> Location:
        raise NothingInView("outside of every photo")

    monkeypatch.setattr(module, "locate_part", locate)
    with pytest.raises(NothingInView):
        next(track_part(PART, frames(1), FIRST))
    blind += [0, 1]
    (lost,) = track_part(
        PART, frames(3)[2:], history=[LoggedFrame(0, measured(FIRST)), LoggedFrame(1, measured(FIRST))]
    )
    assert (lost.how, lost.location.quality, len(lost.location.matches)) == ("lost", 0.0, 0)


def test_a_frame_without_contrast_is_a_loss_that_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Real pictures of nothing: both of what locates are the real ones."""
    blank = [Frame.of(i, Photo.of(np.full((48, 64), 0.4, np.float32), CAMERA)) for i in range(2)]
    for tracked in track_part(PART, blank, FIRST):
        assert (tracked.how, tracked.found) == ("lost", False)
        assert tracked.location.reason.startswith(f"photo '{tracked.frame.names[0]}' is empty")
        assert (tracked.location.pose.sigma_mm > 100).all()  # no uncertainty would look certain


def test_a_restricted_motion_is_searched_for_only_around_its_start(sighting: Install) -> None:
    """A search without a start would find poses that the restriction does not allow."""
    seen = sighting(6, hidden={2, 3, 4, 5})
    list(track_part(PART, frames(6), FIRST, freedom=Freedom.planar([0, 0, 1])))
    assert not [call for call in seen.calls if call[0] == "search"]
    with pytest.raises(BadValue, match="a start to move from"):
        next(track_part(PART, frames(1), freedom=Freedom.planar([0, 0, 1])))


def test_of_symmetric_poses_the_one_nearest_to_the_last_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    turned = FIRST @ Rigid.exp([0, 0, 0, 0, 0, np.pi])
    both = location(turned, 0.95, (location(FIRST, 0.9), location(Rigid(), 0.2)))
    monkeypatch.setattr(module, "locate_part", lambda *_, **__: both)
    (one,) = track_part(PART, frames(1), FIRST)
    np.testing.assert_array_equal(one.location.pose.world_from_part.matrix, FIRST.matrix)


def test_a_run_that_goes_on_is_one_that_never_stopped(sighting: Install) -> None:
    """Cut anywhere, also within a loss: the same ways, the same poses."""
    sighting(30, hidden={4, 5, 9, 10, 11, 12, 13, 14, 15, 16, 17})
    whole = list(track_part(PART, frames(30), FIRST))
    for cut in range(1, 30):
        history = [LoggedFrame(t.frame.index, t.location.pose if t.found else None) for t in whole[:cut]]
        rest = list(track_part(PART, frames(30)[cut:], FIRST, history=history))
        assert [t.how for t in rest] == [t.how for t in whole[cut:]], cut
        for one, other in zip(rest, whole[cut:], strict=True):
            assert (one.filtered is None) == (other.filtered is None)
            if one.filtered is not None and other.filtered is not None:
                np.testing.assert_array_equal(one.filtered.covariance, other.filtered.covariance)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of twelve pictures, the numbers in their names not padded."""
    for i in range(12):
        write_picture(tmp_path / "in" / f"shot{i}.png", np.full((48, 64), i / 255, np.float32))
    return tmp_path / "in"


def opened(folder: Path) -> Frames:
    return Frames([folder], [Viewpoint.exact("camera", CAMERA, Rigid(), sigma_px=0.1)])


def run(folder: Path, log: Path, n: int | None = None, start: Rigid = FIRST) -> list[str]:
    """Track into a log, the first n frames; return how each was found."""
    pictures = opened(folder)
    with TrackLog.open(log, head_of(PART, pictures.viewpoints, start), table=log.with_suffix(".csv")) as open_log:
        lines = track_part_to_log(open_log, PART, pictures, start)
        return [line["how"] for _, line in islice(lines, n)]


def test_pictures_come_in_the_order_of_their_numbers(folder: Path) -> None:
    assert [frame.names[0] for frame in opened(folder)] == [str(folder / f"shot{i}.png") for i in range(12)]


def test_a_path_does_for_a_log(sighting: Install, folder: Path, tmp_path: Path) -> None:
    """Stopped after five frames, and gone on with: the lines of a log that was opened by hand."""
    seen = sighting(12, hidden={3})
    run(folder, tmp_path / "whole.jsonl")
    lines = track_part_to_log(tmp_path / "log.jsonl", PART, opened(folder), FIRST)
    assert [line["frame"] for _, line in islice(lines, 5)] == [0, 1, 2, 3, 4]
    lines.close()  # type: ignore[attr-defined]
    seen.calls.clear()
    assert len(list(track_part_to_log(tmp_path / "log.jsonl", PART, opened(folder), FIRST))) == 12
    assert min(index for _, index in seen.calls) == 5
    assert (tmp_path / "log.jsonl").read_bytes() == (tmp_path / "whole.jsonl").read_bytes()
    with pytest.raises(BadValue, match="log is None"):
        next(track_part_to_log(None, PART, opened(folder), FIRST))  # type: ignore[arg-type]


@pytest.mark.parametrize("torn", [b"", b'{"frame": 5, "files', b"\xc3"])
def test_a_killed_run_goes_on_after_its_last_whole_line(
    sighting: Install, folder: Path, tmp_path: Path, torn: bytes
) -> None:
    """Stopped after five frames, in the midst of a line: in the end the files are those of a run without a break."""
    seen = sighting(12, hidden={3})
    run(folder, tmp_path / "whole.jsonl")
    run(folder, tmp_path / "log.jsonl", 5)
    with (tmp_path / "log.jsonl").open("ab") as file:
        file.write(torn)
    seen.calls.clear()
    assert len(run(folder, tmp_path / "log.jsonl")) == 12
    assert min(index for _, index in seen.calls) == 5
    for suffix in (".jsonl", ".csv"):
        assert (tmp_path / f"log{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


def test_a_log_is_only_continued_with_the_same_inputs(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12)
    log = tmp_path / "log.jsonl"
    run(folder, log, 5)
    before = log.read_bytes()
    with pytest.raises(UnreadableFile, match="begun with another start"):
        run(folder, log, start=FIRST @ Rigid.exp([1e-9, 0, 0, 0, 0, 0]))
    write_picture(folder / "shot2.png", np.full((48, 64), 0.5, np.float32))
    with pytest.raises(UnreadableFile, match=r"shot2.png: is not the picture of frame 2"):
        run(folder, log)
    assert log.read_bytes() == before
    for i in range(2, 12):
        (folder / f"shot{i}.png").unlink()
    with pytest.raises(UnreadableFile, match="has 5 frames, more than there are pictures"):
        run(folder, log)
    (tmp_path / "other.jsonl").write_text('{"format": "something else"}\n')
    with pytest.raises(UnreadableFile, match="not a log of tracked frames"):
        run(folder, tmp_path / "other.jsonl")


def test_a_log_is_only_continued_with_the_same_range_of_views(sighting: Install, folder: Path, tmp_path: Path) -> None:
    """A log of before there was any to declare says nothing of it."""
    _, log, above = sighting(12), tmp_path / "log.jsonl", ViewRange.above(within_deg=50.0)

    def entries(path: Path, views: ViewRange = WHOLE_SPHERE) -> list[dict[str, Any]]:
        return [entry for _, entry in track_part_to_log(path, PART, opened(folder), views=views)]

    assert entries(log, above) == entries(log, ViewRange.above(within_deg=50.0))
    with pytest.raises(UnreadableFile, match="begun with another --seen-from, --roll, --distance, --on or --lying"):
        entries(log)
    _, written = log.unlink(), entries(log)
    log.write_text(log.read_text().replace(', "views": null', "", 1))
    assert (entries(log), "views" in log.read_text()) == (written, False)


def test_a_log_is_written_by_one_run_at_a_time(sighting: Install, folder: Path, tmp_path: Path) -> None:
    pytest.importorskip("fcntl")
    sighting(12)
    log, pictures = tmp_path / "log.jsonl", opened(folder)
    head = head_of(PART, pictures.viewpoints, FIRST)
    with TrackLog.open(log, head) as first:
        lines = track_part_to_log(first, PART, pictures, FIRST)
        next(lines)
        for overwrite in (False, True):
            with pytest.raises(UnwritableFile, match="another run is writing to it; wait for its end"):
                TrackLog.open(log, head, overwrite=overwrite)
        assert len(list(lines)) == 11
    assert [entry["frame"] for entry in read_track_log(log)] == [*range(12)]
    assert len(run(folder, log)) == 12


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda entry: entry.clear(), "has no 'files'; keys are none"),
        (lambda entry: entry.pop("sha256"), "has no 'sha256'"),
        (lambda entry: entry.update(quality=float("nan")), "line 3.quality is not finite"),
        (lambda entry: entry.update(found="yes"), 'line 3.found is "yes"; true or false is expected'),
        (lambda entry: entry.update(filtered=None), "line 3.filtered is null; an object {...} is expected"),
        (lambda entry: entry["pose"].pop("world_from_part"), "line 3.pose has no 'world_from_part'"),
    ],
)
def test_a_line_that_was_changed_is_told(
    sighting: Install, folder: Path, tmp_path: Path, change: Callable[[dict[str, Any]], object], says: str
) -> None:
    sighting(12)
    log = tmp_path / "log.jsonl"
    run(folder, log, 4)
    lines = log.read_text().splitlines()
    entry = json.loads(lines[2])
    change(entry)
    log.write_text("\n".join([*lines[:2], json.dumps(entry), *lines[3:]]) + "\n")
    for read in (lambda: read_track_log(log), lambda: run(folder, log)):
        with pytest.raises(UnreadableFile, match=re.escape(says)):
            read()


def test_only_a_log_is_overwritten(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12)
    log, head = tmp_path / "log.jsonl", head_of(PART, opened(folder).viewpoints, FIRST)
    run(folder, log, 5)
    log.write_text(log.read_text().replace('"version": 2', '"version": 1'))
    with TrackLog.open(log, head, overwrite=True) as anew:
        assert list(anew.entries) == []
    assert log.read_text() == json.dumps(head) + "\n"
    for other in ('{"part": "bracket"}\n', "serial 4711\n"):
        log.write_text(other)
        with pytest.raises(UnreadableFile, match=r"(not a log|line 1 is not JSON).*; what is no track log is kept"):
            TrackLog.open(log, head, overwrite=True)
        assert log.read_text() == other


def test_a_log_holds_every_bit_and_a_table_beside_it_the_same(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12, hidden={7})
    run(folder, tmp_path / "log.jsonl")
    entries = read_track_log(tmp_path / "log.jsonl")
    rows = [line.split(",") for line in (tmp_path / "log.csv").read_text().splitlines()]
    assert tuple(rows[0]) == COLUMNS
    for entry, row, pose in zip(entries, rows[1:], truth(12), strict=True):
        if entry["frame"] == 7:
            assert not entry["found"]
            assert row[COLUMNS.index("x_mm")] == ""
            continue
        np.testing.assert_array_equal(entry["pose"].world_from_part.matrix, pose.matrix)
        at = COLUMNS.index("x_mm")
        assert [float(v) for v in row[at : at + 3]] == pose.translation.tolist()


def test_a_picture_s_name_may_hold_a_separator_of_lines(sighting: Install, folder: Path, tmp_path: Path) -> None:
    """One for Python, not for JSON lines: the log is continued, and read."""
    sighting(12)
    named = folder.rename(tmp_path / "in\u2028")
    run(named, tmp_path / "log.jsonl", 2)
    run(named, tmp_path / "log.jsonl")
    assert len(read_track_log(tmp_path / "log.jsonl")) == 12


def test_pictures_whose_names_are_no_text_are_logged(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12)
    try:
        folder = folder.rename(tmp_path / os.fsdecode(b"gr\xfcn"))
    except OSError:
        pytest.skip("this disk takes no such names")
    run(folder, tmp_path / "log.jsonl", 5)
    run(folder, tmp_path / "log.jsonl")
    assert len(read_track_log(tmp_path / "log.jsonl")) == 12
    for suffix in (".jsonl", ".csv"):
        assert "udcfcn/shot11.png" in (tmp_path / f"log{suffix}").read_text()


def test_a_log_is_plain_json_lines(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12)
    run(folder, tmp_path / "log.jsonl", 2)
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert lines[0]["format"] == "cadcam track"
    assert [line["frame"] for line in lines[1:]] == [0, 1]


def test_the_memory_of_a_run_does_not_grow_with_its_film(sighting: Install, folder: Path, tmp_path: Path) -> None:
    """Of what is on the disk a fiftieth at most: where a line begins are 8 bytes of some thousand."""
    sighting(12)
    head = head_of(PART, opened(folder).viewpoints, FIRST)
    one = next(iter(track_part(PART, frames(12), FIRST)))
    with TrackLog.open(tmp_path / "log.jsonl", head) as log:
        log.append(one)
        tracemalloc.start()
        for _ in range(300):
            log.append(one)
        grown, _ = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert grown < (tmp_path / "log.jsonl").stat().st_size / 50
        assert (len(log.entries), len(list(log.entries)), len(log.entries[-3:])) == (301, 301, 3)
        assert log.entries[300] == log.entries[0]


def test_a_full_disk_leaves_whole_lines_and_a_run_that_goes_on(
    sighting: Install, folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half a line is taken, then no more: the file is named, and ends with the line before."""
    sighting(12, hidden={3})
    run(folder, tmp_path / "whole.jsonl")
    writing, log = io.FileIO.write, tmp_path / "log.jsonl"

    class Disk(io.FileIO):
        def write(self, data: Any) -> int:
            if self.tell() + len(data) > 9000:
                if len(data) > 1:
                    return writing(self, data[: len(data) // 2])
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return writing(self, data)

    with monkeypatch.context() as small:
        small.setattr("cadcam.locate.track.appending.io.FileIO", Disk)
        with pytest.raises(UnwritableFile, match=r"log\.jsonl: cannot be written: .*; free some space.* it goes on"):
            run(folder, log)
    kept = len(read_track_log(log))
    assert 0 < kept < 12
    assert len(run(folder, log)) == 12
    for suffix in (".jsonl", ".csv"):
        assert (tmp_path / f"log{suffix}").read_bytes() == (tmp_path / f"whole{suffix}").read_bytes()


def test_a_run_that_was_killed_in_its_first_line_begins_anew(sighting: Install, folder: Path, tmp_path: Path) -> None:
    sighting(12)
    run(folder, tmp_path / "whole.jsonl")
    whole = (tmp_path / "whole.jsonl").read_bytes()
    (tmp_path / "log.jsonl").write_bytes(whole[:40])
    assert len(run(folder, tmp_path / "log.jsonl")) == 12
    assert (tmp_path / "log.jsonl").read_bytes() == whole
    (tmp_path / "log.jsonl").write_bytes(b'{"format": "something')
    with pytest.raises(UnreadableFile, match="is not a log of tracked frames"):
        run(folder, tmp_path / "log.jsonl")
