"""Labelled views per second of a ship block, compared with pyrender on the same views in the same run.

    python benchmarks/dataset.py                     # 1,000 views of 640 x 480 px, 100,000 triangles
    python benchmarks/dataset.py --views 200 --peer-views 20

The rows: pyrender, colour (4 samples a pixel) and depth into numpy, nothing labelled and nothing written, before and
after ours, by one process and by one a core; ours so (colour of 2 x 2 samples, depth); ours as `cadcam dataset` makes
it: with poses, masks, depth, normals, boxes, key points, visible edges, all written as files, from the start of the
first process to the last byte of COCO's file. Views a second by wall clock, and CPU ms a view over all processes: on a
busy machine only the second means much.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from compileall import compile_dir
from pathlib import Path

import cadcam
from cadcam.cad.edges import NO_EDGES
from cadcam.cad.parts import ship_block
from cadcam.camera.camera import Camera
from cadcam.cores import usable_cores
from cadcam.dataset.make import make_dataset
from cadcam.dataset.plan import DatasetPlan, Span
from cadcam.dataset.shot import Shot, ShotSampler
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene
from render_peers import peer

CAMERA = Camera.from_focal((640, 480), 660.0)
TRIANGLES = 100_000
Rate = tuple[float, float]  # views a second, CPU ms a view


def plan_of(views: int, fill: Span) -> DatasetPlan:
    return DatasetPlan(views, CAMERA, seed=1, fill=fill)


def shots(count: int, start: int, fill: Span) -> list[Shot]:
    sampler = ShotSampler(plan_of(10**6, fill), Scene.of(ship_block(triangles=TRIANGLES), edges=NO_EDGES), ())
    return [sampler.shot(start + index) for index in range(count)]


def rendered(name: str, views: list[Shot]) -> Rate:
    """Return the rate of a renderer that hands colour and depth to numpy."""
    frame = _frames(name)
    for shot in views[:2]:
        frame(shot)
    return timed(lambda: [frame(shot) for shot in views[2:]], len(views) - 2)


def _frames(name: str) -> Callable[[Shot], object]:
    """Return what renders the picture and depth of a shot."""
    mesh = ship_block(triangles=TRIANGLES)
    if name == "pyrender":
        other = peer(name, mesh)
        return lambda shot: other.frame(shot.camera, shot.camera_from_part, color=True)
    ours, wanted = RasterRenderer(Scene.of(mesh, edges=NO_EDGES), backs=False), Channel.RGB | Channel.DEPTH
    return lambda shot: ours.render(shot.camera, shot.camera_from_part, channels=wanted, look=shot.look)


def timed(work: Callable[[], object], count: int) -> Rate:
    """Return the rate of some work on so many views, with the CPU time of this process and of those it started."""
    before, start = _cpu(), time.perf_counter()
    work()
    return count / (time.perf_counter() - start), 1e3 * (_cpu() - before) / count


def _cpu() -> float:
    own, others = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + others.ru_utime + others.ru_stime


def by_processes(name: str, count: int, processes: int, fill: Span) -> Rate:
    """Return the rate of processes that each render `count` views of their own, all at once."""
    options = ["--peer-views", str(count), "--fill", *map(str, fill)]
    command = [sys.executable, __file__, "--measure", name, *options]
    env = {**os.environ, "PYOPENGL_PLATFORM": "egl"}
    running = [
        subprocess.Popen([*command, "--start", str(k * count)], stdout=subprocess.PIPE, text=True, env=env)
        for k in range(processes)
    ]
    rates = [json.loads(process.communicate()[0].strip().splitlines()[-1]) for process in running]
    return sum(rate for rate, _ in rates), sum(cpu for _, cpu in rates) / len(rates)


def labelled(views: int, fill: Span) -> Rate:
    """Return the rate of whole data sets, their processes' start and the reading of records included."""
    compile_dir(Path(cadcam.__file__).parent, quiet=1)  # as every installation has it, and a checkout may not
    scene = Scene.of(ship_block(triangles=TRIANGLES))
    folder = Path(tempfile.mkdtemp(prefix="cadcam-dataset-"))
    plan = plan_of(views, fill)
    try:
        return timed(lambda: make_dataset(folder / "set", scene, plan, name="ship_block"), views)
    finally:
        shutil.rmtree(folder)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=1000)
    parser.add_argument("--peer-views", type=int, default=60)
    parser.add_argument("--fill", type=float, nargs=2, default=(0.4, 0.9), help="block by the picture's shorter side")
    parser.add_argument("--measure", help=argparse.SUPPRESS)
    parser.add_argument("--start", type=int, default=0, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    fill = (arguments.fill[0], arguments.fill[1])
    if arguments.measure:
        print(json.dumps(rendered(arguments.measure, shots(arguments.peer_views, arguments.start, fill))))
        return
    count = arguments.peer_views
    rows: list[tuple[str, Rate]] = []

    def row(name: str, rate: Rate) -> None:
        rows.append((name, rate))
        print(f"{name:60s} {rate[0]:8.2f} views/s {rate[1]:8.1f} CPU ms a view", flush=True)

    there = importlib.util.find_spec("pyrender") is not None
    if not there:
        print("pyrender is not installed: left out")
    for when in ("before", "after"):
        if there:
            row(f"pyrender, rendered, one process ({when})", by_processes("pyrender", count, 1, fill))
            rate = by_processes("pyrender", count, usable_cores(), fill)
            row(f"pyrender, rendered, one process a core ({when})", rate)
        if when == "before":
            row("cadcam, rendered, one process", by_processes("raster", 4 * count, 1, fill))
            row("cadcam, labelled and written", labelled(arguments.views, fill))
    for column, best_of in ((0, max), (1, min)) if there else ():
        best = best_of(rate[column] for name, rate in rows if name.startswith("pyrender"))
        for name, rate in rows:
            if name.startswith("cadcam"):
                times = rate[0] / best if column == 0 else best / rate[1]
                print(f"{name}: {times:.1f} x pyrender's best by {('wall clock', 'CPU')[column]}")


if __name__ == "__main__":
    main()
