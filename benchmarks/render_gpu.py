"""Frames per second of the renderer "gl" at 1920x1080, one by one and in a batch, compared with raster on the CPU.

    python benchmarks/render_gpu.py                      # 1 and 10 million triangles, on the first GPU that answers
    python benchmarks/render_gpu.py --anyway --triangles 100000    # also where OpenGL is drawn in software

Colour and z-depth into numpy, from a camera that moves at every frame; medians by wall clock.
"""

from __future__ import annotations

import argparse
import statistics
import time

from cadcam.cad.edges import NO_EDGES
from cadcam.cad.parts import ship_block
from cadcam.camera.camera import Camera
from cadcam.render import open_renderer
from cadcam.render.gl.context import probe
from cadcam.render.view import Channel, Renderer, Scene
from render import LENSES, camera_of, pose_of

CHANNELS = Channel.IMAGE | Channel.DEPTH
FRAMES = 20


def single(renderer: Renderer, camera: Camera) -> float:
    """Return the frames a second of one call a frame, by the median."""
    times = []
    for k in range(-2, FRAMES):
        start = time.perf_counter()
        renderer.render(camera, pose_of(k), channels=CHANNELS)
        times.append(time.perf_counter() - start)
    return 1 / statistics.median(times[2:])


def batched(renderer: Renderer, camera: Camera) -> float:
    """Return the frames a second of one batch."""
    start = time.perf_counter()
    for _ in renderer.render_batch(camera, [pose_of(k) for k in range(FRAMES)], channels=CHANNELS):
        pass
    return FRAMES / (time.perf_counter() - start)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[1_000_000, 10_000_000])
    parser.add_argument("--anyway", action="store_true", help="run where OpenGL is drawn in software, too")
    arguments = parser.parse_args()
    device = probe()
    if not device.available or (device.software and not arguments.anyway):
        said = device.reason or f"only {device.renderer}; --anyway runs on it"
        raise SystemExit(f"no GPU answers on EGL: {said}")
    print(f"{device.renderer}\n\n| triangles | renderer | camera | frames/s, single | frames/s, batch |")
    print("|---:|---|---|---:|---:|")
    for count in arguments.triangles:
        scene = Scene.of(ship_block(triangles=count), edges=NO_EDGES)
        for name in ("gl", "raster"):
            renderer = open_renderer(scene, name)
            for lens in LENSES:
                camera = camera_of("1920x1080", LENSES[lens])
                rates = f"{single(renderer, camera):.1f} | {batched(renderer, camera):.1f}"
                print(f"| {scene.mesh.n_faces:,} | {name} | {lens or 'plain'} | {rates} |", flush=True)


if __name__ == "__main__":
    main()
