"""The cost of a view's labels: PNG files compared with Pillow's, visible edges with hidden-line removal in space.

    python benchmarks/dataset_labels.py          # 12 views of 640 x 480 px of the ship block, 100,000 triangles

The views are those of `benchmarks/dataset.py`. CPU ms and kB a view; how much of the edges' length is missed or added,
by more than a pixel, where the view's own depth decides.
"""

from __future__ import annotations

import argparse
import io
import time
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from PIL import Image
from scipy.spatial import cKDTree

from cadcam.cad.parts import ship_block
from cadcam.image.png import packed, packed_depth, packed_normals
from cadcam.render.lines.seen import SeenEdges
from cadcam.render.lines.visible import LineDrawer
from cadcam.render.lines.wireframe import LineOptions, Polylines
from cadcam.render.raster import RasterRenderer
from cadcam.render.view import Channel, Scene, View
from dataset import TRIANGLES, shots

WANTED = Channel.RGB | Channel.DEPTH | Channel.NORMAL
Samples = np.ndarray[Any, np.dtype[Any]]
A = TypeVar("A")
B = TypeVar("B")


def pictures(view: View) -> dict[str, Samples]:
    noise = np.random.default_rng(0).normal(0, 3, view.rgb.shape)
    return {
        "colour": view.rgb,
        "colour with a sensor's noise": np.clip(view.rgb + noise, 0, 255).astype(np.uint8),
        "depth, 16 bits": samples_of(packed_depth(view.depth, 0.5)),
        "normals": samples_of(packed_normals(view.depth, view.normal)),
        "mask": np.where(np.isfinite(view.depth), 255, 0).astype(np.uint8),
    }


def samples_of(file: bytes) -> Samples:
    with Image.open(io.BytesIO(file)) as image:
        return np.asarray(image)


def by_pillow(samples: Samples, **options: int) -> bytes:
    file = io.BytesIO()
    Image.fromarray(samples.astype(samples.dtype.newbyteorder("="))).save(file, "PNG", **options)
    return file.getvalue()


def timed(work: Callable[[A], B], things: Sequence[A]) -> tuple[float, list[B]]:
    """Return the mean CPU ms of some work on each thing, the best of three rounds, and what it returned."""
    best, out = np.inf, list[B]()
    for _ in range(3):
        start = time.process_time()
        out = [work(thing) for thing in things]
        best = min(best, time.process_time() - start)
    return 1e3 * best / len(things), out


def astray(lines: Polylines, others: Polylines) -> float:
    """Return the share of one's length that is farther than a pixel from the others."""
    (q, *_), (p, *_) = lines.points_along(0.5), others.points_along(0.5)
    return float(np.mean(cKDTree(p).query(q)[0] > 1))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--views", type=int, default=12)
    scene = Scene.of(ship_block(triangles=TRIANGLES))
    renderer = RasterRenderer(scene, threads=1)
    chosen = shots(parser.parse_args().views, 0, (0.4, 0.9))
    views = [renderer.render(shot.camera, shot.camera_from_part, channels=WANTED, look=shot.look) for shot in chosen]
    every = [pictures(view) for view in views]
    packers: dict[str, Callable[[Samples], bytes]] = {
        "Pillow": by_pillow,
        "Pillow, level 1": lambda samples: by_pillow(samples, compress_level=1),
        "ours": packed,
    }
    for name in every[0]:
        for packer, work in packers.items():
            cpu, files = timed(work, [of_view[name] for of_view in every])
            print(f"{name:30s} {packer:16s} {cpu:7.2f} ms {np.mean([len(f) for f in files]) / 1e3:7.1f} kB", flush=True)
    cpu, shown = timed(SeenEdges(scene).draw, views)
    print(f"edges by the view's depth  {cpu:7.2f} ms")
    drawer, options = LineDrawer(scene), LineOptions(margin_px=0.0)
    exact_ms, exact = timed(lambda v: drawer.draw(v.camera, v.camera_from_world, options=options).visible, views)
    missed = np.mean([astray(a, b) for a, b in zip(exact, shown, strict=True)])
    added = np.mean([astray(b, a) for a, b in zip(exact, shown, strict=True)])
    print(f"by hidden-line removal     {exact_ms:7.2f} ms; missed {missed:.2%}, added {added:.2%} of the length")


if __name__ == "__main__":
    main()
