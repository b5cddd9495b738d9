"""Are displaced and missing parts found in path-traced pictures, which cadcam has no part in: textures, soft light.

    python benchmarks/verify_traced.py PICTURES [--pictures 6] [--case NAME ...] [--seed 1]

Pictures of two blocks by Mitsuba 3 (`locate_scene.py` says which release): a corner of 0.62 x 0.42 x 0.3 m with two
angle bars and two brackets, seen from outside at 1.4 to 1.9 m, and the block of `verify.py`, seen from within at 1.55
m; 768 x 576 px, focal length 1185 px. All surfaces are mottled and scratched; light comes from a sky that is equally
bright all around and from a wide lamp, 0.4 to 1.6 times as much, each reflected twice; noise sigma 3/255, eight bits.
Whatever is drawn is drawn anew for each picture. In the pictured block a bar is 1 mm off, in half of the pictures
across its web along what it stands on, else across the line of sight and by 0.7 mm or more across its own length; or a
bracket is missing. The corner is located from up to 20 degrees, 40 px and 10 % of the distance off. Columns are those
of `verify.py`. Pictures are kept in the folder PICTURES: one takes half a minute of CPU time.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh, merge
from cadcam.cad.parts.shape import box, moved, named, prism, turned
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import State
from cadcam.verify.inspection import inspect
from locate_scene import WHITE, starts
from locate_traced import Bench
from traced_smoothly import picture
from verify import BRACKET, CAMERA, NOISE, STIFFENER, Tally, count_flagged, lights, measure, shows
from verify import block as inner_block
from verify import pose as inner_pose
from verify_blocks import across, built

GREY = (0.5, 0.5, 0.5)
SKY, LAMP_AT = 0.6, 8.5  # radiance; distance of the lamp in reaches of the block
CASES = tuple(
    f"{of}: {wrong}" for of in ("corner", "block") for wrong in ("nothing wrong", "bar 1 mm off", "bracket missing")
)
ACROSS_MM = 0.7  # of a displacement, across the bar's length in the picture


@cache
def corner() -> Mesh:
    """Return a bottom plate with two walls, angle bars on it, and brackets in the corner of bottom and floor."""
    bar = [(0, 0), (10, 0), (10, 95), (48, 95), (48, 105), (0, 105)]
    bracket = [(0, 0), (120, 0), (120, 8), (8, 120), (0, 120)]
    parts = [
        box((0, 0, -12), (620, 420, 0), name="bottom", color=GREY),
        box((0, 0, 0), (12, 408, 290), name="floor", color=GREY),
        box((0, 408, 0), (620, 420, 290), name="girder", color=GREY),
    ]
    for k, x in enumerate((210.0, 425.0), 1):
        parts.append(_at(turned(prism(bar, 0, 408, name="bar", color=GREY), "xz"), f"bar {k}", (x, 0, 0)))
    for k, y in enumerate((80.0, 230.0), 1):
        parts.append(_at(turned(prism(bracket, 0, 10, name="bracket", color=GREY), "xz"), f"bracket {k}", (12, y, 0)))
    return merge(parts)


def _at(mesh: Mesh, name: str, low: tuple[float, float, float]) -> Mesh:
    return moved(named(mesh, name), np.array(low) - mesh.bounds[0])


@cache
def part(of: str) -> Part:
    out = Part.of(corner() if of == "corner" else inner_block())
    _ = out.lines
    return out


@dataclass(frozen=True)
class Subject:
    """What is pictured, from where, and what is wrong with it: the body and its displacement (3,) mm, nan if gone."""

    of: str
    camera_from_part: Rigid
    name: str | None
    by: Array

    @property
    def mesh(self) -> Mesh:
        """The block as it should be."""
        return part(self.of).scene.mesh

    @classmethod
    def drawn(cls, case: str, number: int, rng: np.random.Generator) -> Subject:
        """Return picture `number` of a case, as chance has it."""
        of, wrong = case.split(": ")
        name = None
        if wrong != "nothing wrong":
            k = int(rng.integers(1, 3))
            inner = STIFFENER if wrong.startswith("bar") else BRACKET
            name = inner if of == "block" else f"{wrong.split()[0]} {k}"
        pose = corner_pose(rng) if of == "corner" else inner_pose(rng)
        while of == "block" and not shows(pose, name, lights(rng)):
            pose = inner_pose(rng)
        subject = cls(of, pose, name, np.full(3, np.nan))
        return subject.displaced(number, rng) if "off" in wrong else subject

    def displaced(self, number: int, rng: np.random.Generator) -> Subject:
        """Return the same with the body displaced by 1 mm, in a way that a picture can show."""
        web, long = (np.eye(3)[[0, 1]]) if self.of == "corner" else np.eye(3)[[1, 2]]
        if number % 2 == 0:
            return replace(self, by=web * rng.choice([-1.0, 1.0]))
        sight = self.mesh.subset([str(self.name)]).bounds.mean(axis=0) - self.camera_from_part.inv.translation
        side = np.cross(long, sight)
        side /= np.linalg.norm(side)
        by = across(self.camera_from_part, 1.0, rng)
        while abs(by @ side) < ACROSS_MM:
            by = across(self.camera_from_part, 1.0, rng)
        return replace(self, by=by)

    def traced(self, rng: np.random.Generator) -> Array:
        """Return the radiance (H, W) of a picture, its scene and lights drawn at random."""
        gone = self.name is not None and np.isnan(self.by).any()
        by = {} if gone or self.name is None else {self.name: self.by}
        mesh = built(self.mesh, by, (str(self.name),) if gone else ())
        centred = -np.append(self.mesh.bounds.mean(axis=0)[:2], self.mesh.bounds[0, 2])
        reach = float(np.linalg.norm(self.mesh.size_mm) / 2)
        bench = Bench(replace(mesh, vertices=mesh.vertices + centred), (), reach, int(rng.integers(1 << 30)))
        turn, rise = rng.uniform(0, 2 * np.pi), np.radians(rng.uniform(35, 75))
        towards = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
        half = rng.uniform(0.8, 2.0)
        radiance = SKY * rng.uniform(0.4, 1.6) * np.pi * LAMP_AT**2 / (2 * half) ** 2
        lamp = tuple(LAMP_AT * towards), half, radiance
        pose = self.camera_from_part @ Rigid(translation=-centred)
        return picture(bench, CAMERA, pose, lamp, SKY, seed=int(rng.integers(1 << 20)))

    def start(self, rng: np.random.Generator) -> Rigid:
        """Return a rough pose; from within the block one as in `verify.py`, as parts of it are behind the camera."""
        if self.of == "corner":
            return starts(CAMERA, self.camera_from_part, self.mesh, 1, rng)[0][0]
        return self.camera_from_part @ Rigid.exp(rng.normal(0, 1, 6) * np.repeat([2.0, 2e-3], 3))


def corner_pose(rng: np.random.Generator) -> Rigid:
    """Return camera_from_part of a camera that looks into the corner."""
    target = corner().bounds.mean(axis=0) + rng.uniform(-1, 1, 3) * [60, 40, 30]
    turn, rise = np.radians(-55 + rng.uniform(-32, 32)), np.radians(rng.uniform(25, 58))
    away = np.array([np.cos(turn) * np.cos(rise), np.sin(turn) * np.cos(rise), np.sin(rise)])
    up = np.array([0.0, 0.0, 1.0]) + rng.normal(0, 0.06, 3)
    return Rigid.look_at(target + rng.uniform(1400, 1900) * away, target, up=up)


def shots(case: str, pictures: int, seed: int, folder: Path) -> Iterator[tuple[Photo, Rigid, Subject]]:
    """Yield photos (the world is the camera), rough poses and what they show; radiances are kept in the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(pictures):
        rng = np.random.default_rng([seed, CASES.index(case), number])
        subject = Subject.drawn(case, number, rng)
        kept = folder / f"{seed} {case.replace(':', '')} {number}.npy"
        if not kept.exists():
            np.save(kept, subject.traced(rng).astype(np.float32))
        clean = np.load(kept)
        rng = np.random.default_rng([seed, CASES.index(case), number, 1])
        clean = WHITE * clean / np.quantile(clean, 0.99) + rng.normal(0, NOISE, clean.shape)
        gray = np.clip(np.round(clean * 255) / 255, 0, 1).astype(np.float32)
        yield Photo.of(gray, CAMERA, Rigid()), subject.start(rng), subject


def study(case: str, pictures: int, seed: int, folder: Path) -> Tally:
    """Return how a case came out."""
    out = Tally()
    wanted = State.MISSING if "missing" in case else State.DISPLACED
    for photo, start, subject in shots(case, pictures, seed, folder):
        located = locate_part(part(subject.of), [photo], start)
        seen = inspect(part(subject.of), [photo], located.pose.world_from_part) if located.found else None
        out.pictures += 1
        if seen is None or not seen.found:
            out.lost += 1
            print(f"{case} {out.pictures}: {located.reason if seen is None else seen.reason}", file=sys.stderr)
            continue
        count_flagged(out, case, seen, subject.name, wanted)
        for name in part(subject.of).scene.mesh.part_names if subject.name is None else (subject.name,):
            if wanted is State.DISPLACED:
                measure(out, seen, name, None if subject.name is None else subject.by)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="PICTURES", help="folder that pictures are kept in")
    parser.add_argument("--pictures", type=int, default=6, help="of each case (default %(default)s)")
    parser.add_argument("--case", action="append", choices=CASES, help="may be repeated; default all")
    parser.add_argument("--seed", type=int, default=1, help="of all that is drawn (default %(default)s)")
    a: Any = parser.parse_args()
    print("| pictured | pictures | found | no pose | alarms | error mm | z rms | U mm | in U |")
    print("|---|---|---|---|---|---|---|---|---|")
    for case in a.case or CASES:
        print(row(case, study(case, a.pictures, a.seed, a.folder)), flush=True)


def row(case: str, tally: Tally) -> str:
    n = tally.pictures
    found = "" if "nothing" in case else f"{tally.found} of {n}"
    cells = [case, str(n), found, str(tally.lost), str(tally.alarms)]
    if tally.error:
        rms = np.sqrt(np.mean(np.square(tally.z)))
        cells += [f"{np.median(tally.error):.3f}", f"{rms:.2f}", f"{np.median(tally.U):.2f}"]
        cells.append(f"{100 * np.mean(tally.within):.0f} %")
    return "| " + " | ".join(cells + [""] * (9 - len(cells))) + " |"


if __name__ == "__main__":
    main()
