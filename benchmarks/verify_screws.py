"""Are screws told present or gone, those flush with their plate too, whatever they are made of.

    python benchmarks/verify_screws.py PICTURES [--pictures 20] [--seed 77]

Path-traced pictures by Mitsuba 3, 2048 x 1536 px: a plate of 180 x 120 x 16 mm with nine screws and pins, 5 to 13 mm
wide, 40 to 110 px: countersunk, in counterbores, pins level with the plate, and heads on it. A third is missing; their
holes go through to a block below. Plate and screws are each painted (mottled), plain, of rough or nearly bright
metal, or black, as chance has it; the CAD is all of one grey, or has darker screws. One to three lamps, an even sky,
noise sigma 2/255, eight bits. The part is located from a pixel or so off, and inspected.

PASS and missing: the verdict on presence, and the state; `flush`: bodies none of whose edges is far enough from others
to be counted. Pictures are kept in the folder PICTURES: one takes two minutes of CPU time.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import Piece, between, box, circle, filled, joined, level
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import State
from cadcam.verify.inspection import inspect
from locate_traced import _paint, _plain, _shape
from render_peers import module

SIZE, FOCAL = (2048, 1536), 3000.0
CAMERA = Camera.from_focal(SIZE, FOCAL, fy=FOCAL, cx=(SIZE[0] - 1) / 2, cy=(SIZE[1] - 1) / 2)
SPAN = np.array([180.0, 120.0, 16.0])
KINDS = ("countersunk",) * 4 + ("counterbored",) * 2 + ("pin",) * 2 + ("head",)
SIDES, SAMPLES, GONE, NOISE = 40, 35, 0.3, 2.0 / 255
# Radius in radii of the screw, depth below the plate in radii; of heads above it, negative.
HOLE = {
    "countersunk": [(1.0, 0.0), (0.52, 0.48), (0.52, None)],
    "counterbored": [(1.1, 0.0), (1.1, 1.15), (0.6, 1.15), (0.6, None)],
    "pin": [(1.0, 0.0), (1.0, None)],
    "head": [(0.55, 0.0), (0.55, None)],
}
SCREW = {
    "countersunk": [(0.98, 0.01), (0.5, 0.48), (0.5, 2.0)],
    "counterbored": [(0.97, 0.1), (1.0, 0.17), (1.0, 1.15), (0.55, 1.15), (0.55, 2.2)],
    "pin": [(0.9, 0.0), (1.0, 0.1), (1.0, 2.0)],
    "head": [(0.6, -0.62), (0.9, -0.35), (1.0, 0.0), (0.5, 0.0), (0.5, 1.5)],
}
SOCKET = {"countersunk": (0.5, 0.5), "counterbored": (0.58, 0.55), "head": (0.5, 0.4)}  # radius and depth in radii


@dataclass(frozen=True)
class Fastener:
    """A screw or pin in the plate: kind, place and radius mm."""

    kind: str
    at: tuple[float, float]
    radius: float

    def rings(self, profile: Sequence[tuple[float, float | None]]) -> list[Array]:
        """Return the circles (SIDES, 3) of a profile; None is the plate's lower side."""
        flat = [circle(self.at, r * self.radius, SIDES) for r, _ in profile]
        heights = [0.0 if depth is None else SPAN[2] - depth * self.radius for _, depth in profile]
        return [np.column_stack([c, np.full(SIDES, z)]) for c, z in zip(flat, heights, strict=True)]

    def mesh(self, name: str, color: tuple[float, float, float]) -> Mesh:
        """Return the screw or pin."""
        rings = self.rings(SCREW[self.kind])
        top, end = rings[0], rings[-1]
        pieces: list[Piece] = [between(low, high, 3 + k) for k, (high, low) in enumerate(pairwise(rings))]
        pieces.append(level(filled(end[:, :2]), end[0, 2], 2, down=True))
        if self.kind not in SOCKET:
            pieces.append(level(filled(top[:, :2]), top[0, 2], 1))
            return joined(pieces, name=name, color=color)
        radius, depth = (x * self.radius for x in SOCKET[self.kind])
        hexagon = np.column_stack([circle(self.at, radius, 6), np.full(6, top[0, 2])])
        bottom = hexagon - [0, 0, depth]
        pieces += [level(filled(top[:, :2], [hexagon[:, :2]]), top[0, 2], 1)]
        pieces += [level(filled(bottom[:, :2]), bottom[0, 2], 20)]
        for k in range(6):
            side = [k, (k + 1) % 6]
            pieces.append(_inside(between(bottom[side], hexagon[side], 21 + k, closed=False)))
        return joined(pieces, name=name, color=color)


def _inside(piece: Piece) -> Piece:
    points, triangles, surface = piece
    return points, triangles[:, ::-1], surface


def drawn(rng: np.random.Generator) -> Mesh:
    """Return a plate with its screws and the block below, drawn by chance."""
    kinds = list(KINDS)
    rng.shuffle(kinds)
    screws = []
    for k, kind in enumerate(kinds):
        x, y = (np.array([30 + k % 3 * 60, 20 + k // 3 * 40]) + rng.uniform(-1, 1, 2) * [9, 6]).tolist()
        screws.append(Fastener(kind, (x, y), rng.uniform(2.5, 4.5) if kind == "pin" else rng.uniform(3.2, 6.5)))
    steel = (0.6, 0.6, 0.6)
    dark = (0.2, 0.2, 0.2) if rng.random() < 0.5 else steel
    parts = [s.mesh(f"{s.kind} {k}", dark) for k, s in enumerate(screws)]
    below = box((10, 10, -20), (SPAN[0] - 10, SPAN[1] - 10, 0), name="block", color=steel)
    return merge([_plate(screws, steel), *parts, below])


def _plate(screws: Sequence[Fastener], color: tuple[float, float, float]) -> Mesh:
    corners = np.array([(0, 0), (SPAN[0], 0), (SPAN[0], SPAN[1]), (0, SPAN[1])], float)
    holes = [s.rings(HOLE[s.kind]) for s in screws]
    pieces: list[Piece] = [level(filled(corners, [h[0][:, :2] for h in holes]), SPAN[2], 1)]
    pieces.append(level(filled(corners, [h[-1][:, :2] for h in holes]), 0, 2, down=True))
    for hole in holes:
        for high, low in pairwise(hole):
            pieces.append(_inside(between(low, high, len(pieces) + 10)))
    low = np.column_stack([corners, np.zeros(4)])
    for k in range(4):
        side = [k, (k + 1) % 4]
        pieces.append(between(low[side], low[side] + [0, 0, SPAN[2]], 3 + k, closed=False))
    return joined(pieces, name="plate", color=color)


def viewed(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera above the plate, 40 to 85 degrees steep."""
    turn, rise, far = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(40, 85)), rng.uniform(380, 560)
    away = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    return Rigid.look_at(SPAN / 2 + far * away, SPAN / 2)


def traced(mesh: Mesh, gone: Sequence[str], pose: Rigid, rng: np.random.Generator) -> tuple[Array, str]:
    """Return the radiance (H, W) of a picture without the bodies `gone`, and what plate and screws are made of."""
    mi = module("mitsuba")
    mi.set_variant("llvm_ad_mono")
    of_plate = str(rng.choice(["paint", "plain", "metal"]))
    of_screws = str(rng.choice(["paint", "plain", "metal", "bright", "black"]))
    rest = ["plate", "block"]
    screws = [name for name in mesh.part_names if name not in rest and name not in gone]
    reach = float(SPAN[0]) / 2
    scene: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sky": {"type": "constant", "radiance": float(rng.uniform(0.1, 0.5))},
        "plate": _shape(mi, mesh.subset(rest), _made_of(mi, rng, of_plate), reach),
        "screws": _shape(mi, mesh.subset(screws), _made_of(mi, rng, of_screws), reach),
        "table": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -20]).scale([2000, 2000, 1]),
            "bsdf": _paint(mi, rng, 0.3, 0.16, 0.5),
        },
        "sensor": _sensor(mi, pose),
    }
    for k in range(int(rng.integers(1, 4))):
        scene[f"lamp {k}"] = _lamp(mi, rng)
    picture = mi.render(mi.load_dict(scene), seed=int(rng.integers(1 << 20)))
    return np.array(picture, np.float64)[..., 0], f"{of_screws} in {of_plate}"


def _sensor(mi: Any, pose: Rigid) -> dict[str, Any]:
    return {
        "type": "perspective",
        "fov": float(np.degrees(2 * np.arctan(SIZE[0] / 2 / FOCAL))),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(pose.inv.matrix @ np.diag([-1.0, -1.0, 1.0, 1.0])),
        "film": {
            "type": "hdrfilm",
            "width": SIZE[0],
            "height": SIZE[1],
            "pixel_format": "luminance",
            "rfilter": {"type": "gaussian", "stddev": 0.5},
        },
        "sampler": {"type": "multijitter", "sample_count": SAMPLES},
    }


def _lamp(mi: Any, rng: np.random.Generator) -> dict[str, Any]:
    turn, rise, half, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 1.4), rng.uniform(60, 250), 700.0
    away = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    middle = [*(SPAN[:2] / 2).tolist(), 0.0]
    look = mi.ScalarTransform4f().look_at(origin=(middle + far * away).tolist(), target=middle, up=[0.1, 0.2, 1])
    emitter = {"type": "area", "radiance": float(rng.uniform(0.5, 2) * (far / half) ** 2 / 3)}
    return {"type": "rectangle", "to_world": look @ mi.ScalarTransform4f().scale(half), "emitter": emitter}


def _made_of(mi: Any, rng: np.random.Generator, what: str) -> dict[str, Any]:
    if what == "paint":
        return _paint(mi, rng, rng.uniform(0.25, 0.7), 0.08, 0.4)
    if what == "plain":
        return _plain(mi, rng.uniform(0.2, 0.7))
    if what == "black":
        inner = {"type": "roughplastic", "diffuse_reflectance": {"type": "rgb", "value": 0.05}, "alpha": 0.25}
        return {"type": "twosided", "inner": inner}
    rough = rng.uniform(0.12, 0.3) if what == "metal" else rng.uniform(0.05, 0.12)
    reflects = {"type": "rgb", "value": float(rng.uniform(0.4, 0.9))}
    inner = {"type": "roughconductor", "material": "Al", "alpha": float(rough), "specular_reflectance": reflects}
    return {"type": "twosided", "inner": inner}


def pictured(number: int, seed: int, folder: Path) -> tuple[Photo, Mesh, Rigid, list[str], str]:
    """Return a picture, its CAD, its pose, what is missing in it, and what it is made of; kept in the folder."""
    rng = np.random.default_rng([seed, number])
    mesh, pose = drawn(rng), viewed(rng)
    gone = [name for name in mesh.part_names if name not in ("plate", "block") and rng.random() < GONE]
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / f"{seed} {number}.npz"
    if not kept.exists():
        radiance, made_of = traced(mesh, gone, pose, rng)
        np.savez_compressed(kept, radiance=radiance.astype(np.float32), made_of=made_of)
    with np.load(kept) as file:
        clean, made_of = file["radiance"].astype(np.float64), str(file["made_of"])
    noise = np.random.default_rng([seed, number, 1]).normal(0, NOISE, clean.shape)
    gray = np.round(np.clip(0.8 * clean / np.quantile(clean, 0.98) + noise, 0, 1) * 255) / 255
    return Photo.of(gray.astype(np.float32), CAMERA), mesh, pose, gone, made_of


def study(number: int, seed: int, folder: Path, counts: Counter[tuple[bool, bool, str]]) -> None:
    """Count how the bodies of a picture come out: by whether they are there, whether flush, and what is said."""
    photo, mesh, pose, gone, made_of = pictured(number, seed, folder)
    part = Part.of(mesh)
    beside = Rigid.exp(np.array([1.0, 1.0, 0, 0, 0, 0])) @ pose @ Rigid.exp(np.array([0, 0, 0, 5e-3, -4e-3, 6e-3]))
    located = locate_part(part, [photo], beside)
    seen = inspect(part, [photo], located.pose.world_from_part)
    if not (located.found and seen.found):
        print(f"picture {number} ({made_of}): {seen.reason or located.reason}")
        return
    for f in seen.features:
        if f.name in ("plate", "block"):
            continue
        there, flush = f.name not in gone, f.presence.expected == 0
        passes, missing, moved = (
            f.presence.log_ratio >= seen.passable,
            f.state is State.MISSING,
            f.state is State.DISPLACED,
        )
        said = "missing" if missing else "PASS" if passes else "undecided"
        counts[there, flush, said] += 1
        counts[there, flush, "displaced"] += moved
        if moved or (missing if there else passes):
            is_ = f"{'there' if there else 'gone'}, is {f.state.value}, L {f.presence.log_ratio:.1f}"
            print(f"picture {number} ({made_of}): {f.name}, {is_}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="PICTURES", help="folder that pictures are kept in")
    parser.add_argument("--pictures", type=int, default=20, help="how many (default %(default)s)")
    parser.add_argument("--seed", type=int, default=77, help="of all that is drawn (default %(default)s)")
    a: Any = parser.parse_args()
    counts: Counter[tuple[bool, bool, str]] = Counter()
    for number in range(a.pictures):
        study(number, a.seed, a.folder, counts)
    print("| bodies | | PASS | missing | undecided | displaced |")
    print("|---|---|---|---|---|---|")
    for there in (True, False):
        for flush in (False, True):
            row = [counts[there, flush, said] for said in ("PASS", "missing", "undecided", "displaced")]
            print(
                f"| {'there' if there else 'missing'} | {'flush' if flush else 'edges'} | {' | '.join(map(str, row))} |"
            )


if __name__ == "__main__":
    main()
