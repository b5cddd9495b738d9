"""Makes or continues a data set: what exists is kept, what is missing is made, then everything is combined.

A view's files are a function of plan, part and the view's number; each is written whole, its record last. So it does
not matter which worker makes a view, in what order, or how often the work was interrupted.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Generator, Iterable, Iterator
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from cadcam.camera.camera import Camera
from cadcam.cores import usable_cores
from cadcam.dataset.assembly import assemble
from cadcam.dataset.cluster import on_cluster, require_dask
from cadcam.dataset.head import begin, head_of
from cadcam.dataset.key_points import corners
from cadcam.dataset.layout import CAMERA, CONTACT, VIEWS_A_SCENE, DatasetFiles
from cadcam.dataset.model_files import write_model_files
from cadcam.dataset.plan import DatasetPlan, middle_and_radius
from cadcam.dataset.processes import on_processes
from cadcam.dataset.props import props_of
from cadcam.dataset.sheet import contact_sheet
from cadcam.dataset.shot import ShotSampler
from cadcam.dataset.view_renderer import ViewInputs
from cadcam.dataset.worker import Files, Job, Task
from cadcam.errors import BadValue, MissingCore, UnreadableFile
from cadcam.files.jsontext import as_json
from cadcam.image.png import depth_step
from cadcam.kinds import expect, expect_callable, expect_count, expect_path
from cadcam.native.core import library
from cadcam.render.lines.seen import drawable_edges
from cadcam.render.view import Scene
from cadcam.whole import write_whole

_TOGETHER = 8  # shots drawn at a time: between views the processor's caches hold other data


@dataclass(frozen=True, slots=True)
class Made:
    """The result of a run: the number of views made, the visible share of the part in each view, the depth step, mm."""

    folder: Path
    layout: DatasetFiles
    new: int
    visible: tuple[float, ...]
    depth_step: float

    @property
    def contact(self) -> Path:
        """Return the contact sheet."""
        return self.folder / CONTACT

    @property
    def scenes(self) -> list[Path]:
        """Return the folders of BOP's scenes."""
        return [self.folder / self.layout.scene(i) for i in range(-(-len(self.visible) // VIEWS_A_SCENE))]


def make_dataset(
    folder: str | Path,
    scene: Scene,
    plan: DatasetPlan,
    *,
    name: str = "part",
    split: str = "train",
    workers: int | None = None,
    cluster: str | None = None,
    on_view: Callable[[], None] | None = None,
    on_start: Callable[[int, int], None] | None = None,
) -> Made:
    """Make the data set in a folder, or continue it; the same bytes whatever `workers` and `cluster` are.

    workers: processes, by default one per core. cluster: address of a Dask scheduler, instead of processes. on_start
    gets the numbers of views to be made and of views present; on_view is called after each. Raises `BadValue` for a
    folder that holds another data set, `UnwritableFile`, `MissingExtra`, `WorkerDied`, `UnreachableCluster`.
    """
    expect(scene, "scene", Scene)
    expect(plan, "plan", DatasetPlan)
    expect_path(folder, "folder")
    expect(name, "name", str)
    expect(cluster, "cluster", str, optional=True)
    expect_callable(on_view, "on_view", optional=True)
    expect_callable(on_start, "on_start", optional=True)
    folder, layout = Path(folder), DatasetFiles(_named(split), "gray" if plan.gray else "rgb")
    _check_makers(workers, cluster)
    names, points = corners(scene) if plan.key_points is None else (plan.key_point_names, plan.key_points)
    props = props_of(plan.occluders, 2 * middle_and_radius(scene.mesh)[1], plan.seed)
    sampler = ShotSampler(plan, scene, props)
    sampler.refuse_inside()
    inputs = ViewInputs(scene, props, points, plan.sensor, plan.gray, depth_step(sampler.farthest()))
    begin(folder, head_of(plan, inputs, layout, name=name, key_point_names=names))
    write_model_files(folder, scene)
    write_whole(folder / CAMERA, _bop_camera(plan.camera, inputs))
    todo = missing(folder, layout, plan.views)
    if on_start:
        on_start(len(todo), plan.views - len(todo))
    with closing(_made(inputs, layout, sampler, todo, workers or usable_cores(), cluster)) as made:
        for files in made:
            for path, content in files.items():
                write_whole(f"{folder}/{path}", content, durable=False)
            if on_view:
                on_view()
    if todo:
        _settled()
    visible = assemble(folder, layout, plan.views, name=name, key_points=names)
    write_whole(folder / CONTACT, contact_sheet(folder, layout, plan.views))
    return Made(folder, layout, len(todo), tuple(visible), inputs.depth_step)


def _settled() -> None:
    """Have the files of all views on the disk: to wait for each would make a view take half as long again."""
    if hasattr(os, "sync"):
        os.sync()


def _check_makers(workers: int | None, cluster: str | None) -> None:
    """Raise now the errors that every worker would raise, and those that would come after the preparation."""
    if workers is not None:
        expect_count(workers, "workers")
    try:
        library()
    except MissingCore as error:
        raise MissingCore(error.why, "the renderer of data sets", "reinstall") from None
    if cluster:
        require_dask()


def missing(folder: Path, layout: DatasetFiles, views: int) -> list[int]:
    """Return the views of which a file is missing, or empty; half-written files of an interrupted run are removed.

    A power cut, which writes of views are not safe from, mostly leaves such of which only the name was on the disk.
    """
    out: list[int] = []
    for first in range(0, views, VIEWS_A_SCENE):
        scene = folder / layout.scene(first // VIEWS_A_SCENE)
        there = {kind: set(_swept(scene / kind)) for kind in layout.kinds()}
        own = range(first, min(first + VIEWS_A_SCENE, views))
        out += [i for i in own if any(Path(layout.path(kind, i)).name not in names for kind, names in there.items())]
    return out


def _swept(folder: Path) -> Iterator[str]:
    """Yield the names of files that hold something; those whose writing was interrupted are removed (see `whole`)."""
    if not folder.is_dir():
        return
    for file in folder.iterdir():
        if file.name.startswith("."):
            with suppress(OSError):
                file.unlink()
        elif file.stat().st_size:
            yield file.name


def _made(
    inputs: ViewInputs, layout: DatasetFiles, sampler: ShotSampler, todo: list[int], workers: int, cluster: str | None
) -> Generator[Files, None, None]:
    """Yield the files of views as they arrive."""

    def job() -> Job:
        return Job(inputs, drawable_edges(inputs.scene), layout)

    tasks = _tasks(sampler, todo)
    if todo and cluster:
        yield from on_cluster(job(), tasks, cluster)
    elif todo:
        yield from on_processes(job, tasks, min(workers, len(todo)))


def _tasks(sampler: ShotSampler, todo: Iterable[int]) -> Iterator[Task]:
    left = iter(todo)
    while some := [sampler.shot(index) for index in islice(left, _TOGETHER)]:
        for shot in some:
            yield Task(shot, _content(shot.backdrop.kind) if isinstance(shot.backdrop.kind, Path) else None)


def _content(photo: Path) -> bytes:
    try:
        return photo.read_bytes()
    except OSError as error:
        raise UnreadableFile(photo, error.strerror or str(error), "put the photo back, or leave it out") from None


def _named(split: str) -> str:
    expect(split, "split", str)
    if not split or set(split) & set("/\\:.\0 ") or split == "models":
        raise BadValue("split", repr(split), "a word that can be a folder's name, such as train, val or test_hall")
    return split


def _bop_camera(camera: Camera, inputs: ViewInputs) -> bytes:
    cx, cy = camera.principal_point.tolist()
    values = {"cx": cx, "cy": cy, "depth_scale": inputs.depth_step, "fx": camera.fx, "fy": camera.fy}
    return as_json(values | {"height": camera.height, "width": camera.width})
