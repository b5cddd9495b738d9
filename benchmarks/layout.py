"""CPU time of a layout: 100 candidates, 200 features, 10 poses of a ship block; and how close to the best set it is.

    python benchmarks/layout.py [--candidates 100] [--features 200] [--poses 10] [-k 4]

The features (a third each: circles, points, edges) lie at random on the block, where some candidate sees them.
"survey": what every candidate sees and tells; "search": the best k with one more and one less; "what if": the table.
Seconds of CPU, and by the clock. "of the best": the worst ratio found by the search, by that of all sets, for 14
candidates.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace
from typing import TypeVar

import numpy as np

from cadcam.cad.parts import ship_block
from cadcam.camera.sensor_format import sensor_format
from cadcam.errors import UnseenFeatures
from cadcam.geometry.rigid import Rigid
from cadcam.plan.choice.search import best_set, exhausted
from cadcam.plan.layout import plan_layout, survey
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, LayoutScene, Mount
from cadcam.plan.scene.zones import arc
from cadcam.plan.uncertainty.finding import Finder
from cadcam.plan.what_if import what_if
from cadcam.render.view import Scene
from cadcam.verify.tolerances.tolerance import Limit, Quantity

T = TypeVar("T")
LIMITS = (Limit(Quantity.POSITION, 1.0),)


def random_features(rng: np.random.Generator, scene: Scene, count: int) -> list[LayoutFeature]:
    mesh = scene.mesh
    face = rng.choice(mesh.n_faces, count, p=mesh.face_areas / mesh.face_areas.sum())
    p = np.einsum("nk,nkj->nj", rng.dirichlet([1, 1, 1], count), mesh.vertices[mesh.faces[face]])
    normal = mesh.face_normals[face]
    ends = mesh.vertices[scene.edges.vertices]
    long = ends[np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) > 150]
    out = []
    for i in range(count):
        if i % 3 == 0:
            out.append(LayoutFeature(f"c{i}", Kind.CIRCLE, p[i], LIMITS, normal=normal[i], diameter_mm=40.0))
        elif i % 3 == 1:
            out.append(LayoutFeature(f"p{i}", Kind.POINT, p[i], LIMITS, normal=normal[i]))
        else:
            out.append(LayoutFeature.edge(f"e{i}", long[rng.integers(len(long))], LIMITS))
    return out


def make(rng: np.random.Generator, candidates: int, count: int, poses: int) -> LayoutScene:
    mesh = ship_block(triangles=10_000)
    middle = mesh.bounds.mean(axis=0)
    eyes = [
        arc(middle + np.array([0.0, 0, h]), 6000.0, 0.0, 360.0, n, axis=np.array([0.0, 0, 1]))
        for h, n in ((500.0, candidates // 2), (3500.0, candidates - candidates // 2))
    ]
    ring = np.concatenate(eyes)
    turns = rng.normal(size=(poses, 6)) * [20, 20, 5, 0.005, 0.005, 0.03]
    made = LayoutScene(
        part=mesh,
        poses={f"pose {i}": Rigid.exp(t) for i, t in enumerate(turns)},
        cameras={"12 mm": CameraType("12 mm", sensor_format("IMX304"), 12.0, 8.0)},
        mounts=(Mount("ring", ring, np.tile(middle, (len(ring), 1)), ("12 mm",)),),
        features=tuple(random_features(rng, Scene.of(mesh), 4 * count)),
        finder=Finder(sigma_px=0.1, gray=0.01, contrast=0.3),
        calibration=CalibratedFrom(40, 0.1, 0.1),
    )
    try:
        survey(made)
    except UnseenFeatures as unseen:
        left = tuple(f for f in made.features if f.name not in unseen.names)
        return replace(made, features=left[:count])
    return replace(made, features=made.features[:count])


def timed(name: str, work: Callable[[], T]) -> T:
    cpu, clock = time.process_time(), time.perf_counter()
    out = work()
    print(f"| {name} | {time.process_time() - cpu:.2f} | {time.perf_counter() - clock:.2f} |")
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--candidates", type=int, default=100)
    parser.add_argument("--features", type=int, default=200)
    parser.add_argument("--poses", type=int, default=10)
    parser.add_argument("-k", type=int, default=4)
    arguments = parser.parse_args()
    scene = make(np.random.default_rng(1), arguments.candidates, arguments.features, arguments.poses)
    print(f"{arguments.candidates} candidates, {len(scene.features)} features, {len(scene.poses)} poses\n")
    print("| step | CPU s | clock s |\n|---|---|---|")
    seen = timed("survey", lambda: survey(scene))
    layout = timed("search", lambda: plan_layout(seen, arguments.k))
    timed("what if", lambda: what_if(layout))
    print("\n| k | of the best | sets |\n|---|---|---|")
    few = survey(make(np.random.default_rng(2), 14, 30, 2))
    for k in (3, 4, 5):
        found, best = best_set(few.problem, k, complete=False).score, exhausted(few.problem, k)
        same = (
            ""
            if found.unmeasured == best.score.unmeasured
            else f" ({found.unmeasured} not measured, not {best.score.unmeasured})"
        )
        print(f"| {k} | {found.worst / best.score.worst:.4f}{same} | {best.sets} |")


if __name__ == "__main__":
    main()
