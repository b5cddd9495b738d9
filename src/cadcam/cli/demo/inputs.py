"""The inputs of the demo: the dissertation's calibration table, and a synthetic photo."""

from __future__ import annotations

from itertools import product

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.edges import EdgeKind
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts import BENCH_POINTS
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.camera.observations import Observations
from cadcam.cli.wires import scene_without_edges
from cadcam.geometry.rigid import Rigid
from cadcam.render import open_renderer
from cadcam.render.lines.wireframe import Wireframe
from cadcam.render.view import Channel, Look

# Table 2.3: the pixels of the sixteen targets, U = row, V = column, px
BENCH_UV: Array = np.array(
    [
        [187.1, 159.0],
        [190.1, 287.2],
        [183.8, 463.8],
        [278.1, 218.2],
        [284.1, 368.1],
        [387.1, 307.1],
        [413.1, 177.1],
        [449.9, 468.1],
        [184.8, 253.2],
        [187.2, 345.8],
        [183.1, 468.2],
        [249.1, 295.3],
        [253.1, 401.9],
        [326.1, 358.0],
        [346.9, 263.0],
        [370.8, 471.9],
    ]
)
# Table 2.9, position 1, and its residual: mm, degrees, px, to the digits printed
PRINTED = {
    "X": "7.7",
    "Y": "416.3",
    "Z": "-210.4",
    "a": "-9.04",
    "b": "-9.44",
    "c": "-2.36",
    "aspect": "1.007",
    "focal": "805.9",
    "skew": "0.01",
    "U0": "319.7",
    "V0": "354.7",
    "residual": "0.60",
}

# The camera of the synthetic photo: unequal focal lengths, skewed axes, off-centre principal point, barrel distortion.
TRUE_CAMERA = Camera(
    (800, 600), np.array([[759.0, 3.1, 409.5], [0.0, 752.0, 288.5], [0.0, 0.0, 1.0]]), BrownConrady(k1=-0.16)
)
TRUE_POSE = Rigid.look_at([6300, -3300, 3500], [1950, 1250, 760])
PICK_SIGMA_PX = 0.3
NOISE = 0.012  # of white, per pixel


def bench_observations() -> Observations:
    """Return Table 2.3."""
    names = tuple(f"target {i + 1}" for i in range(len(BENCH_POINTS)))
    return Observations.from_uv(BENCH_POINTS, BENCH_UV, names=names, source="dissertation, Table 2.3")


def made_photo(block: Mesh, rng: np.random.Generator) -> Picture:
    """Return a grey picture of the block in a hall, by a camera with blur, vignetting and noise."""
    from scipy.ndimage import gaussian_filter

    scene = scene_without_edges(merge([block, *hall()]))
    look = Look(head=0.4, fill=0.6, back=0.0, ambient=0.25, fill_from=(-0.6, -0.7, -0.5), supersampling=2)
    light = open_renderer(scene).render(TRUE_CAMERA, TRUE_POSE, channels=Channel.IMAGE, look=look).gray
    falloff = 1 - 0.25 * np.sum(TRUE_CAMERA.normalized(TRUE_CAMERA.pixel_grid()) ** 2, axis=-1)
    grain = gaussian_filter(rng.normal(size=light.shape), 6.0)
    photo = gaussian_filter(light * falloff * (1 + 0.35 * grain), 0.6) ** 0.8
    return np.asarray(np.clip(photo + rng.normal(scale=NOISE, size=light.shape), 0, 1), np.float32)


def picked_points(block: Mesh, wireframe: Wireframe, count: int, rng: np.random.Generator) -> Observations:
    """Return `count` corners of the block that its camera sees, far from one another, picked with `PICK_SIGMA_PX`."""
    ends, seen = _visible_corners(block, wireframe)
    chosen = [int(np.argmax(np.linalg.norm(ends - ends.mean(axis=0), axis=1)))]
    for _ in range(count - 1):
        chosen.append(int(np.argmax(np.linalg.norm(ends[:, None] - ends[chosen], axis=-1).min(axis=1))))
    q = seen[chosen] + rng.normal(scale=PICK_SIGMA_PX, size=(count, 2))
    names = tuple(f"corner {i + 1}" for i in range(count))
    return Observations(np.round(ends[chosen], 3), np.round(q, 2), names)


def _visible_corners(block: Mesh, wireframe: Wireframe) -> tuple[Array, Array]:
    """Return the mesh corners (n, 3) at which visible edges end, and their pixels; not where an edge becomes hidden."""
    from scipy.spatial import KDTree

    lines = wireframe.visible
    at = np.concatenate([lines.start[:-1], lines.start[1:] - 1])
    straight = np.tile(lines.kind != EdgeKind.CONTOUR, 2)
    p, q = lines.p[at[straight]], lines.q[at[straight]]
    distance, vertex = KDTree(block.vertices).query(p)
    true = (distance < 1e-3) & wireframe.camera.sees(q)
    _, first = np.unique(np.asarray(vertex)[true], return_index=True)
    return p[true][first], q[true][first]


def hall() -> list[Mesh]:
    """Return the objects around the block that are not in its CAD model."""
    floor = _slab((-9000, -9000, -150), (13000, 12000, -120), "floor", (0.72, 0.71, 0.68))
    wall = _slab((-4200, -9000, -120), (-4000, 12000, 9000), "wall", (0.66, 0.69, 0.71))
    side = _slab((-4000, 9000, -120), (13000, 9200, 9000), "side wall", (0.6, 0.63, 0.66))
    beams = [_slab((-100, y, -120), (4100, y + 150, 0), f"support {y}", (0.3, 0.24, 0.17)) for y in (300, 2500)]
    crates = [
        _slab((4900, 1800, -120), (5700, 2600, 760), "crate", (0.62, 0.52, 0.36)),
        _slab((300, -2300, -120), (1300, -1500, 700), "box", (0.3, 0.36, 0.42)),
        _slab((-2600, 4200, -120), (-1400, 5600, 1600), "cabinet", (0.28, 0.3, 0.32)),
    ]
    return [floor, wall, side, *beams, *crates]


def _slab(low: tuple[float, ...], high: tuple[float, ...], name: str, color: tuple[float, ...]) -> Mesh:
    corners = np.array(list(product(*zip(low, high, strict=True))))
    quads = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    faces = [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))]
    return Mesh.single(corners, faces, name=name, color=color)
