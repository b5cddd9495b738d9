"""Rays a second of the C core's tree of boxes, which stands in for Embree where that has no wheels, beside Embree.

    python benchmarks/rays.py

One thread; rays from around a ship block to anywhere within. Beside each rate, its share of Embree's; then how many of
the rays meet another face: those that two faces are met by at one place, to Embree's single precision.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from cadcam.arrays import Array, Ids
from cadcam.cad.parts import ship_block
from cadcam.native.rays import NativeRays
from cadcam.render.embree import EmbreeRays

Rays = EmbreeRays | NativeRays
ROUNDS = 5


def built(kind: type[EmbreeRays] | type[NativeRays], vertices: Array, faces: Ids) -> tuple[Rays, float]:
    """Return a tree, and the seconds of CPU that it took."""
    start = time.process_time()
    rays = kind(vertices, faces)
    return rays, time.process_time() - start


def cast(rays: Rays, origins: Array, directions: Array, reach: Array) -> tuple[Ids, float]:
    """Return the faces met, and rays a second of CPU, the best of some rounds."""
    times = []
    for _ in range(ROUNDS):
        start = time.process_time()
        faces = rays.first_hit(origins, directions, reach)
        times.append(time.process_time() - start)
    return faces, len(origins) / min(times)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--triangles", type=int, nargs="+", default=[10_000, 100_000, 1_000_000])
    parser.add_argument("--rays", type=int, default=200_000)
    a = parser.parse_args()
    print("| triangles | built, s: core / Embree | rays/s, core | rays/s, Embree | Embree / core | another face |")
    print("|---:|---|---:|---:|---:|---:|")
    for count in a.triangles:
        mesh, rng = ship_block(triangles=count), np.random.default_rng(1)
        vertices = mesh.vertices - mesh.bounds.mean(axis=0)
        reach = float(np.linalg.norm(vertices, axis=1).max())
        away = rng.normal(size=(a.rays, 3))
        origins = 1.5 * reach * away / np.linalg.norm(away, axis=1, keepdims=True)
        directions = rng.uniform(vertices.min(axis=0), vertices.max(axis=0), size=(a.rays, 3)) - origins
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        core, core_s = built(NativeRays, vertices, mesh.faces)
        embree, embree_s = built(EmbreeRays, vertices, mesh.faces)
        (mine, rate), (other, peer) = (
            cast(rays, origins, directions, np.full(a.rays, 4 * reach)) for rays in (core, embree)
        )
        row = f"{mesh.n_faces:,} | {core_s:.2f} / {embree_s:.2f} | {rate:,.0f} | {peer:,.0f} | {peer / rate:.1f}"
        print(f"| {row} | {np.mean(mine != other):.1e} |", flush=True)


if __name__ == "__main__":
    main()
