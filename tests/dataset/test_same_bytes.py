"""A data set's bytes depend on plan, part and seed: not on workers, order, interruptions, dead workers or a cluster."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from cadcam import whole
from cadcam.dataset import processes
from cadcam.dataset.cluster import on_cluster
from cadcam.dataset.layout import DatasetFiles
from cadcam.dataset.make import make_dataset
from cadcam.dataset.plan import Occluders
from cadcam.dataset.worker import Job, Task
from cadcam.errors import BadValue, MissingExtra, UnreachableCluster, UnreadableFile, UnwritableFile, WorkerDied
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import read_picture, write_picture
from cadcam.render.lines.seen import drawable_edges
from cadcam.render.view import Scene

from .sets import contents, inputs_and_sampler, plan, same, scene

HERE = Path(__file__).parent
RUN = "import sys; sys.path.insert(0, {here!r}); from sets import *; from cadcam.dataset.make import make_dataset; "
RUN += "make_dataset({folder!r}, scene(), plan({views}), workers=2)"


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a data set of eight views made in one go by one process."""
    folder = tmp_path_factory.mktemp("straight") / "set"
    assert make_dataset(folder, scene(), plan(), workers=1).new == 8
    return folder


def test_two_workers_write_what_one_writes_and_a_second_run_changes_nothing(straight: Path, tmp_path: Path) -> None:
    steps: list[int] = []
    made = make_dataset(tmp_path / "set", scene(), plan(), workers=2, on_view=lambda: steps.append(1))
    assert (made.new, len(steps)) == (8, 8)
    same(tmp_path / "set", straight)
    assert make_dataset(tmp_path / "set", scene(), plan(), workers=2).new == 0
    same(tmp_path / "set", straight)


def test_a_run_killed_in_the_middle_and_started_again_writes_the_same(tmp_path: Path) -> None:
    """SIGKILL at whatever moment four records are there; its workers end too."""
    folder = tmp_path / "set"
    views = 24
    command = [sys.executable, "-c", RUN.format(here=str(HERE), folder=str(folder), views=views)]
    running = subprocess.Popen(command)
    records = folder / "train/000000/view"
    while len(list(records.glob("[0-9]*.json"))) < 4:
        assert running.poll() is None
        time.sleep(0.005)
    workers = _children(running.pid)
    running.kill()
    running.wait()
    (records / ".000007.json.abcdefgh").write_bytes(b'{"half')  # what a write that was cut off leaves
    there = len(list(records.glob("[0-9]*.json")))
    assert 4 <= there < views
    _see_the_end_of(workers)
    assert make_dataset(folder, scene(), plan(views), workers=2).new == views - there
    make_dataset(tmp_path / "other", scene(), plan(views), workers=1)
    same(folder, tmp_path / "other")


def test_a_worker_that_is_killed_is_replaced_and_nothing_is_lost(
    straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []
    start = processes._start

    def noted() -> subprocess.Popen[bytes]:
        process = start()
        started.append(process.pid)
        return process

    monkeypatch.setattr(processes, "_start", noted)
    seen: list[int] = []

    def kill_at_the_second() -> None:
        seen.append(1)
        if len(seen) == 2:
            for pid in started:
                os.kill(pid, signal.SIGKILL)

    make_dataset(tmp_path / "set", scene(), plan(), workers=2, on_view=kill_at_the_second)
    assert len(started) > 2
    same(tmp_path / "set", straight)


def test_ctrl_c_is_told_once(tmp_path: Path) -> None:
    """To the whole group, as a terminal sends it, while the workers import: they end with whoever started them."""
    listens = "import signal; signal.signal(signal.SIGINT, signal.default_int_handler); "  # background jobs do not
    run = listens + RUN.format(here=str(HERE), folder=str(tmp_path / "set"), views=400)
    command = [sys.executable, "-c", run]
    running = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    while len(workers := _children(running.pid)) < 2:
        assert running.poll() is None
        time.sleep(0.005)
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate()
    assert said.count("Traceback") == 1
    assert said.endswith("KeyboardInterrupt\n")
    _see_the_end_of(workers)


def test_a_view_that_kills_every_worker_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(processes, "_COMMAND", (sys.executable, "-c", "raise SystemExit(3)"))
    with pytest.raises(WorkerDied, match=r"view 0: 3 processes one after the other died over it .the last with 3"):
        make_dataset(tmp_path / "set", scene(), plan(), workers=1)


def test_a_mistake_of_ours_in_a_worker_is_told_with_its_traceback(tmp_path: Path) -> None:
    """It is no error of the caller's: the command line prints it as a bug."""
    broken = plan(1)
    object.__setattr__(broken, "sensor", "no sensor")  # past the gate that a caller's mistake is told by
    inputs, sampler = inputs_and_sampler(broken)
    job = Job(inputs, drawable_edges(inputs.scene), DatasetFiles("train", "rgb"))
    with pytest.raises(RuntimeError, match=r"in a worker:\nTraceback(.|\n)*has no attribute 'apply'"):
        list(processes.on_processes(lambda: job, [Task(sampler.shot(0))], 1))


def test_a_full_disk_is_one_error_and_the_run_goes_on_when_there_is_room(
    straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace, written = whole._replace, []

    def full(target: Path, data: bytes, durable: bool) -> None:
        written.append(target)
        if len(written) > 25:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        replace(target, data, durable)

    with monkeypatch.context() as disk:
        disk.setattr(whole, "_replace", full)
        with pytest.raises(UnwritableFile, match="No space left on device; free some space, then run it again"):
            make_dataset(tmp_path / "set", scene(), plan(), workers=2)
    assert 0 < make_dataset(tmp_path / "set", scene(), plan(), workers=2).new < 8
    same(tmp_path / "set", straight)


def test_photos_travel_to_workers_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    photo = tmp_path / "hall.png"
    write_picture(photo, np.full((90, 200, 3), (0.2, 0.4, 0.6)))
    made = plan(1, backgrounds=(photo,), occluders=Occluders())
    make_dataset(tmp_path / "set", scene(), made, workers=1)
    picture = read_picture(tmp_path / "set/train/000000/rgb/000000.png")
    assert picture[0, 0] == pytest.approx((0.2, 0.4, 0.6))
    photo.write_bytes(photo.read_bytes()[:60])
    with pytest.raises(UnreadableFile, match=r"hall.png: is cut off or damaged"):
        make_dataset(tmp_path / "other", scene(), made, workers=1)


def test_more_views_are_added_to_those_there(straight: Path, tmp_path: Path) -> None:
    assert make_dataset(tmp_path / "set", scene(), plan(3), workers=1).new == 3
    assert make_dataset(tmp_path / "set", scene(), plan(8), workers=1).new == 5
    same(tmp_path / "set", straight)


def test_a_file_that_was_taken_away_is_made_again(straight: Path, tmp_path: Path) -> None:
    make_dataset(tmp_path / "set", scene(), plan(3), workers=1)
    (tmp_path / "set/train/000000/depth/000001.png").unlink()
    assert make_dataset(tmp_path / "set", scene(), plan(3), workers=1).new == 1
    assert contents(tmp_path / "set").keys() <= contents(straight).keys()


def test_a_file_that_a_power_cut_left_empty_is_made_again(straight: Path, tmp_path: Path) -> None:
    make_dataset(tmp_path / "set", scene(), plan(3), workers=1)
    whole_set = contents(tmp_path / "set")
    (tmp_path / "set/train/000000/depth/000001.png").write_bytes(b"")
    assert make_dataset(tmp_path / "set", scene(), plan(3), workers=1).new == 1
    assert contents(tmp_path / "set") == whole_set


def test_another_plan_part_or_fewer_views_are_refused_by_name(tmp_path: Path) -> None:
    make_dataset(tmp_path / "set", scene(), plan(2), workers=1)
    before = contents(tmp_path / "set")
    seed = (
        r"the data set in .* is begun with another seed \(5, now 6\); expected the same as at first, or another folder"
    )
    with pytest.raises(BadValue, match=seed):
        make_dataset(tmp_path / "set", scene(), plan(2, seed=6), workers=1)
    with pytest.raises(BadValue, match="views is 1; expected at least 2"):
        make_dataset(tmp_path / "set", scene(), plan(1), workers=1)
    with pytest.raises(BadValue, match=r"another lights.head"):
        make_dataset(tmp_path / "set", scene(), plan(2, lights=_brighter()), workers=1)
    mesh = scene().mesh
    moved = Scene.of(mesh.transformed(Rigid(np.eye(3), [1.0, 0, 0])))
    painted = Scene.of(replace(mesh, face_colors=np.tile(np.float32([1, 0, 0]), (mesh.n_faces, 1))))
    fewer = Scene.of(mesh, edges=scene().edges.select(np.arange(6)))
    for other in (moved, painted, fewer):
        with pytest.raises(BadValue, match=r"another part, unit, crease angle or colour \(\w{8}, now \w{8}\)"):
            make_dataset(tmp_path / "set", other, plan(2), workers=1)
    assert contents(tmp_path / "set") == before
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/thesis.txt").write_text("keep")
    with pytest.raises(BadValue, match="not empty, and no data set"):
        make_dataset(tmp_path / "mine", scene(), plan(2), workers=1)
    assert contents(tmp_path / "mine") == {"thesis.txt": b"keep"}


def test_another_seed_gives_other_pictures(straight: Path, tmp_path: Path) -> None:
    make_dataset(tmp_path / "set", scene(), plan(1, seed=6), workers=1)
    name = "train/000000/rgb/000000.png"
    assert contents(tmp_path / "set")[name] != contents(straight)[name]


def test_a_cluster_writes_what_this_machine_writes(straight: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed", reason='needs the extra: pip install "cadcam[cluster]"')
    how = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": None, "silence_logs": 50}
    with distributed.LocalCluster(**how) as cluster:
        made = make_dataset(tmp_path / "set", scene(), plan(), cluster=cluster.scheduler_address)
    assert made.new == 8
    same(tmp_path / "set", straight)


def test_a_cluster_that_is_not_there_or_no_dask_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from cadcam.dataset import cluster

    monkeypatch.setattr(cluster, "_PATIENCE_S", 0.2)
    if "distributed" in sys.modules or _installed("distributed"):
        with pytest.raises(UnreachableCluster, match=r"no work can be done at 'tcp://127.0.0.1:1'"):
            make_dataset(tmp_path / "one", scene(), plan(1), cluster="tcp://127.0.0.1:1")
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra, match=r"cadcam\[cluster\]"):
        make_dataset(tmp_path / "two", scene(), plan(1), cluster="tcp://127.0.0.1:1")
    assert not (tmp_path / "two").exists(), "a folder was begun that nothing could be put into"


def _brighter() -> object:
    from cadcam.dataset.plan import Lights

    return Lights(head=(1.0, 1.0))


def _installed(name: str) -> bool:
    from importlib.util import find_spec

    return find_spec(name) is not None


def _children(pid: int) -> list[int]:
    path = Path(f"/proc/{pid}/task/{pid}/children")
    if not path.exists():
        return []
    found: list[int] = []
    for task in Path(f"/proc/{pid}/task").iterdir():
        found += [int(child) for child in (task / "children").read_text().split()]
    return found


def _see_the_end_of(workers: list[int]) -> None:
    for _ in range(2000):
        if not any(_alive(pid) for pid in workers):
            return
        time.sleep(0.005)
    pytest.fail(f"of the workers {workers} some are still there")


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().split()[2] != "Z"
    except OSError:
        return False


def test_an_address_without_its_port_is_refused_before_there_is_a_client(monkeypatch: pytest.MonkeyPatch) -> None:
    """A client of an address that cannot be parsed is never opened, and complains for 40 s when it is thrown away."""
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(distributed, "Client", None)
    for address in ("127.0.0.1", "tcp://127.0.0.1"):
        with pytest.raises(UnreachableCluster, match=f"no work can be done at '{address}'"):
            next(on_cluster(None, (), address))  # type: ignore[arg-type]  # the job is not reached
