"""Frames of a ship block with our renderers and every other that installs, in one run.

    python benchmarks/render.py                        # all, about ten minutes
    python benchmarks/render.py --triangles 10000 --sizes 768x576 --only raster ray "trimesh + embreex"

Each renderer runs in a process of its own (VTK ends the process where libGL is missing) and hands 8-bit colour and
z-depth in mm, or z-depth alone, to numpy, from a camera that moves at every frame. Figures are medians in ms, wall
clock / CPU over all threads; the columns marked "lens" render through a Brown-Conrady lens, with renderers that do so
exactly. The last row is the best other renderer over raster, by wall clock and by CPU: on a busy machine only the
second means much.
"""

from __future__ import annotations

import argparse
import json
import resource
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.cad.parts import ship_block
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady, Lens
from cadcam.geometry.rigid import Rigid
from render_peers import Peer, peer

SECONDS, MOST_FRAMES = 2.0, 25
LENSES: dict[str, Lens | None] = {"": None, "lens ": BrownConrady(-0.2, 0.05, 1e-3, -5e-4)}
OURS = ("raster", "raster, one thread", "ray", "gl")
NAMES = (*OURS, "moderngl", "Open3D", "Mitsuba", "trimesh + embreex", "VTK", "pyvista", "pyrender")


def camera_of(size: str, lens: Lens | None) -> Camera:
    """Return a camera of 60 degrees, off centre and skewed a little."""
    width, height = (int(n) for n in size.split("x"))
    return Camera.from_focal(
        (width, height), 0.87 * width, fy=0.86 * width, cx=0.52 * width, cy=0.47 * height, skew=1.0, lens=lens
    )


def pose_of(k: int) -> Rigid:
    """Return the pose of frame k: an orbit around the block, some degrees a second."""
    angle = 0.7 + 0.004 * k
    centre = np.array([2000.0, 1500.0, 900.0])
    return Rigid.look_at(centre + 4200 * np.array([np.cos(angle), np.sin(angle), 0.55]), centre)


def measure(name: str, triangles: int, sizes: list[str]) -> dict[str, Any]:
    """Return the medians of one renderer by column, with its times of import and first frame (ms) and memory (MiB)."""
    mesh = ship_block(triangles=triangles)
    start = time.perf_counter()
    renderer = peer(name, mesh)
    result: dict[str, Any] = {"made": (1e3 * (time.perf_counter() - start),), "triangles": mesh.n_faces}
    start = time.perf_counter()
    renderer.frame(camera_of(sizes[0], None), pose_of(0), color=True)
    result["first"] = (1e3 * (time.perf_counter() - start),)
    for size in sizes:
        for label, lens in LENSES.items():
            if lens is not None and not renderer.exact_lens:
                continue
            camera = camera_of(size, lens)
            for kind in ("colour + depth", "depth"):
                result[f"{label}{kind} {size}"] = median_frame(renderer, camera, color=kind != "depth")
    result["memory, MiB"] = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,)
    return result


def median_frame(renderer: Peer, camera: Camera, *, color: bool) -> tuple[float, float]:
    """Return the median wall and CPU time of a frame in ms, after two that do not count."""
    for k in (-2, -1):
        renderer.frame(camera, pose_of(k), color=color)
    wall: list[float] = []
    cpu: list[float] = []
    while len(wall) < 3 or (len(wall) < MOST_FRAMES and sum(wall) < SECONDS):
        pose = pose_of(len(wall))
        start, busy = time.perf_counter(), time.process_time()
        renderer.frame(camera, pose, color=color)
        wall.append(time.perf_counter() - start)
        cpu.append(time.process_time() - busy)
    return 1e3 * statistics.median(wall), 1e3 * statistics.median(cpu)


def in_a_process(name: str, triangles: int, sizes: list[str]) -> dict[str, Any] | str:
    """Return what `measure` does, or the last line of what went wrong."""
    command = [sys.executable, __file__, "--measure", name, "--triangles", str(triangles), "--sizes", *sizes]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    lines = done.stdout.strip().splitlines()
    if done.returncode == 0 and lines:
        return dict(json.loads(lines[-1]))
    said = [line for line in done.stderr.strip().splitlines() if line.strip()]
    return said[-1] if said else f"ended with {done.returncode}"


def table(triangles: int, results: dict[str, dict[str, Any]]) -> str:
    """Return a Markdown table: a row a renderer, then how many times longer the best other one takes than raster."""
    columns = list(dict.fromkeys(key for result in results.values() for key in result if key != "triangles"))
    rows = [["ms", *columns], ["---", *["---:"] * len(columns)]]
    for name, result in results.items():
        rows.append([name, *("/".join(f"{v:.1f}" for v in result[c]) if c in result else "-" for c in columns)])
    if "raster" in results:
        others = [result for name, result in results.items() if name not in OURS]
        rows.append(["**best other / raster**", *(_ratios(results["raster"][c], others, c) for c in columns)])
    return f"\n### {triangles} triangles\n\n" + "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _ratios(ours: list[float], others: list[dict[str, Any]], column: str) -> str:
    rows = [o[column] for o in others if column in o]
    return "/".join(f"{min(v) / mine:.1f}x" for v, mine in zip(zip(*rows, strict=True), ours, strict=False)) or "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--sizes", nargs="+", default=["768x576", "1920x1080"])
    parser.add_argument("--only", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--json", type=Path, help="write the figures here too")
    parser.add_argument("--measure", choices=NAMES, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments.measure, arguments.triangles[0], arguments.sizes)))
        return
    everything: dict[int, dict[str, Any]] = {}
    for triangles in arguments.triangles:
        results: dict[str, dict[str, Any]] = {}
        for name in arguments.only:
            result = in_a_process(name, triangles, arguments.sizes)
            if isinstance(result, str):
                print(f"{name}: left out: {result}", flush=True)
            else:
                results[name] = result
        print(table(triangles, results), flush=True)
        everything[triangles] = results
    if arguments.json:
        arguments.json.write_text(json.dumps(everything, indent=1))


if __name__ == "__main__":
    main()
