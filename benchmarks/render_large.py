"""Pictures of 24 megapixels: time and memory of frames, drawn in strips and at once, in one run.

    python benchmarks/render_large.py                       # a minute or more; drawn at once they take up to 10 GB
    python benchmarks/render_large.py --size 4096x3000 --samples 2 3

Colour of a ship block of 10 000 triangles, n x n samples a pixel, without and with a Brown-Conrady lens. Each case runs
in a process of its own. The second frame shows what keeping the tables of the first is worth: at once they are kept, in
strips they are made again. "chosen": what the renderer does by itself (`cadcam.render.strips.WHOLE_BYTES`).
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time

from cadcam.cad.edges import NO_EDGES
from cadcam.cad.parts import ship_block
from cadcam.render import strips
from cadcam.render.raster import RasterRenderer
from cadcam.render.strips import Grids
from cadcam.render.view import Channel, Look, Scene
from render import LENSES, camera_of, pose_of

WAYS = {"in strips": 0, "at once": 1 << 62}  # bytes of tables up to which a picture is drawn at once


def measure(size: str, lens: str, n: int, way: str) -> dict[str, float]:
    """Return seconds, wall clock and CPU, of the first and the second frame, and the most memory in GB."""
    strips.WHOLE_BYTES = WAYS[way]
    renderer = RasterRenderer(Scene.of(ship_block(triangles=10_000), edges=NO_EDGES))
    result: dict[str, float] = {}
    for k, frame in enumerate(("first", "second")):
        wall, cpu = time.perf_counter(), time.process_time()
        renderer.render(camera_of(size, LENSES[lens]), pose_of(k), channels=Channel.IMAGE, look=Look(supersampling=n))
        result[f"{frame} wall"] = time.perf_counter() - wall
        result[f"{frame} cpu"] = time.process_time() - cpu
    return result | {"GB": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6}


def in_a_process(size: str, lens: str, n: int, way: str) -> dict[str, float] | None:
    """Return what `measure` does; nothing where it ran out of memory."""
    command = [sys.executable, __file__, "--size", size, "--samples", str(n), "--measure", lens, way]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return dict(json.loads(done.stdout)) if done.returncode == 0 else None


def row(size: str, lens: str, n: int, way: str) -> str:
    """Return a case as a line of the table."""
    whole = Grids.of(camera_of(size, LENSES[lens]), Channel.IMAGE, Look(supersampling=n)).whole
    chosen = "yes" if whole == (way == "at once") else ""
    case = [lens.strip() or "none", f"{n} x {n}", way, chosen]
    done = in_a_process(size, lens, n, way)
    if done is None:
        return f"| {' | '.join([*case, '-', '-', '-'])} |"
    frames = [f"{done[f'{frame} wall']:.1f}/{done[f'{frame} cpu']:.1f}" for frame in ("first", "second")]
    return f"| {' | '.join([*case, *frames, format(done['GB'], '.1f')])} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="6000x4000")
    parser.add_argument("--samples", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--measure", nargs=2, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(measure(arguments.size, arguments.measure[0], arguments.samples[0], arguments.measure[1])))
        return
    print("| distortion | samples | drawn | chosen | first frame, s | second frame, s | memory, GB |")
    print("|---|---|---|---|---:|---:|---:|")
    for n in arguments.samples:
        print(row(arguments.size, "", n, "at once"), flush=True)
        for way in WAYS:
            print(row(arguments.size, "lens ", n, way), flush=True)


if __name__ == "__main__":
    main()
