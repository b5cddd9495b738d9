"""Whether a part is found without a start: the right pose first, how fast, and all of a symmetry reported.

    python benchmarks/locate_no_start.py ../shared/data/shipblock_clean --views 40 --noise 3
    python benchmarks/locate_no_start.py ../shared/data/shipblock_clean --views 10 --bodies bracket box --lying told

Renders the ship block, the machined bracket and symmetric bodies from places drawn evenly from the whole declared range
(from above, up to 75 degrees off the vertical, any azimuth, upright within 30 degrees, distances within 1 : 1.5), on a
mottled ground, with noise. A pose is right if no corner is 5 px off. Symmetric bodies, looked for over the whole
sphere, have several right poses: the first may be any, and the share of them among the answer and its alternatives is
told. With --lying all bodies lie on a plane, seen from above and turned anyhow, and the plane is told instead of the
range, or not told beside it.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket
from cadcam.cad.parts.shape import box, circle, prism
from cadcam.cad.read import read_model
from cadcam.camera.camera import Camera
from cadcam.geometry.plane import Plane
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.image.picture import write_picture
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import FOUND
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.views.resting import OnPlane
from cadcam.locate.views.view_range import ViewRange
from cadcam.render import open_renderer
from cadcam.render.view import Channel, Look, Renderer

CAMERA = Camera.from_focal((768, 576), 1185.0)
WITHIN_DEG, ROLL_DEG, SPREAD = 75.0, 30.0, 1.225  # distances from 1 / SPREAD to SPREAD times that of a filling view
RIGHT_PX = 5.0


@dataclass(frozen=True)
class Body:
    """A part, and the rotations (3, 3) about its middle after which it looks the same."""

    name: str
    mesh: Mesh
    symmetry: tuple[Array, ...]
    round: bool = False  # any turn about z looks the same


def bodies(folder: Path) -> list[Body]:
    one = (np.eye(3),)
    halves = tuple(np.diag(d) for d in ([1.0, 1, 1], [1.0, -1, -1], [-1.0, 1, -1], [-1.0, -1, 1]))
    quarter, third = exp(np.array([0, 0, np.pi / 2])), exp(np.full(3, 2 * np.pi / 3 / np.sqrt(3)))
    hexagon = [np.linalg.matrix_power(exp(np.array([0, 0, np.pi / 3])), k) for k in range(6)]
    return [
        Body("ship block", read_model(folder / "model.obj", unit="m"), one),
        Body("bracket", machined_bracket(), one),
        Body("box 100 x 60 x 40", box((0, 0, 0), (100, 60, 40), name="box"), halves),
        Body("cube", box((0, 0, 0), (80, 80, 80), name="cube"), closed([quarter, third])),
        Body(
            "hexagonal prism",
            prism(circle((0, 0), 40, 6), 0, 60, name="prism"),
            (*hexagon, *(h @ halves[1] for h in hexagon)),
        ),
        Body("cylinder", prism(circle((0, 0), 30, 96), 0, 90, name="cylinder"), halves[:2], round=True),
    ]


def closed(generators: Sequence[Array]) -> tuple[Array, ...]:
    """Return the group that rotations generate."""
    group: list[Array] = [np.eye(3)]
    for g in group:  # grows as it goes
        group += [h @ g for h in generators if not any(np.allclose(h @ g, k, atol=1e-6) for k in group)]
    return tuple(group)


@dataclass(frozen=True)
class Asked:
    """What views are drawn and declared: all around or from above, turned by so much, how much farther than filling."""

    within_deg: float
    roll_deg: float
    farther: float = 1.0
    told: bool = False  # the plane that the part lies on, not the range

    def views(self, mesh: Mesh, truth: Rigid) -> ViewRange:
        """Return what is declared of a picture."""
        if self.told:
            base = np.array([0.0, 0.0, mesh.bounds[0, 2]])
            return ViewRange(on=OnPlane(Plane.through(truth @ base, truth.rotation[:, 2])))
        far = self.farther * filling(mesh)
        reach = (far / SPREAD, far * SPREAD)
        return ViewRange(half_angle_deg=self.within_deg, roll_deg=self.roll_deg, distance_mm=reach)


def filling(mesh: Mesh) -> float:
    """Return the distance from which the part's diagonal takes 0.7 of the picture's shorter side."""
    return float(np.linalg.norm(mesh.size_mm)) * CAMERA.fx / (0.7 * CAMERA.height)


def places(mesh: Mesh, n: int, rng: np.random.Generator, asked: Asked) -> Iterator[Rigid]:
    """Yield n poses camera_from_part, even over the range."""
    lowest, turn = np.cos(np.radians(asked.within_deg)), np.radians(asked.roll_deg)
    middle = mesh.bounds.mean(axis=0)
    for _ in range(n):
        z, azimuth = rng.uniform(lowest, 1), rng.uniform(0, 2 * np.pi)
        away = np.array([np.cos(azimuth) * np.sqrt(1 - z * z), np.sin(azimuth) * np.sqrt(1 - z * z), z])
        distance = asked.farther * filling(mesh) * SPREAD ** rng.uniform(-1, 1)
        look = Rigid.exp(np.array([0, 0, 0, 0, 0, rng.uniform(-turn, turn)])) @ Rigid.look_at(
            middle + distance * away, middle
        )
        aside = np.append(rng.uniform(-0.1, 0.1, 2) * CAMERA.height / CAMERA.fx * distance, 0.0)
        yield Rigid(translation=aside) @ look


def picture(
    renderer: Renderer, pose: Rigid, noise: float, rng: np.random.Generator, *, camera: Camera = CAMERA
) -> Picture:
    """Return the part before a mottled ground, with noise of so many grey levels."""
    from scipy.ndimage import gaussian_filter

    view = renderer.render(camera, pose, channels=Channel.IMAGE, look=Look(background=(0.0, 0.0, 0.0), supersampling=4))
    cover = np.asarray(view.coverage, float)
    shade = np.asarray(view.image, float).mean(axis=-1)
    ground = sum(s * gaussian_filter(rng.standard_normal(shade.shape), s) for s in (2, 8, 32))
    gray = 0.8 * shade + (1 - cover) * (0.3 + 0.06 * ground)
    gray = gaussian_filter(gray, 0.6) + noise / 255 * rng.standard_normal(gray.shape)
    return np.asarray(np.round(255 * np.clip(gray, 0, 1)) / 255, np.float32)


def off(body: Body, pose: Rigid, truth: Rigid) -> float:
    """Return the largest distance of a corner's picture in px; on round bodies, to the nearest corner's."""
    vertices = body.mesh.vertices
    p, q = CAMERA.project(pose @ vertices), CAMERA.project(truth @ vertices)
    if not np.isfinite(p).all():
        return np.inf
    if body.round:
        return float(np.linalg.norm(p[:, None] - q, axis=2).min(axis=1).max())
    return float(np.linalg.norm(p - q, axis=1).max())


def same(body: Body, truth: Rigid) -> list[Rigid]:
    """Return all poses that look like the true one."""
    middle = Rigid(translation=body.mesh.bounds.mean(axis=0))
    return [truth @ middle @ Rigid(g, np.zeros(3)) @ middle.inv for g in body.symmetry]


def row(body: Body, n: int, noise: float, seed: int, save: Path | None, asked: Asked) -> str:
    rng, part = np.random.default_rng(seed), Part.of(body.mesh)
    renderer = open_renderer(part.scene)
    complete: list[float] = []
    wall: list[float] = []
    cpu: list[float] = []
    good: list[float] = []
    bad: list[float] = []
    prepared = 0.0
    for k, truth in enumerate(places(body.mesh, n + 1, rng, asked)):
        gray = picture(renderer, truth, noise, rng)
        if save is not None:
            write_picture(save / f"{body.name}_{k:02d}.png", gray)
        began = time.perf_counter(), time.process_time()
        location = locate_part(part, [Photo.of(gray, CAMERA)], views=asked.views(body.mesh, truth))
        if k == 0:
            prepared = time.process_time() - began[1]
            continue  # the part's aspects are made at the first call
        wall.append(time.perf_counter() - began[0])
        cpu.append(time.process_time() - began[1])
        allowed = same(body, truth)
        error = min(off(body, location.pose.world_from_part, t) for t in allowed)
        poses = [a.pose.world_from_part for a in (location, *location.alternatives)]
        complete.append(float(np.mean([min(off(body, p, t) for p in poses) < RIGHT_PX for t in allowed])))
        (good if error < RIGHT_PX else bad).append(location.quality)
        if error >= RIGHT_PX:
            print(f"  {body.name} {k}: {error:.0f} px off, quality {location.quality:.2f}", flush=True)
    lows = f"{min(good, default=np.nan):.2f} / {max(bad, default=np.nan):.2f}"
    found = sum(q >= FOUND for q in good) / n
    poses_right = f"{len(body.symmetry)}{' and any turn' if body.round else ''}"
    return (
        f"| {body.name} | {len(good) / n:.0%} | {found:.0%} | {poses_right} | {np.mean(complete):.0%} | {lows}"
        f" | {np.median(cpu):.2f} / {max(cpu):.2f} | {np.median(wall):.2f} | {prepared:.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder with the ship block's model.obj")
    parser.add_argument("--views", type=int, default=40, help="pictures of each body (default %(default)s)")
    parser.add_argument("--noise", type=float, default=3.0, help="grey levels (default %(default)s)")
    parser.add_argument("--seed", type=int, default=7, help="of places, ground and noise (default %(default)s)")
    parser.add_argument("--bodies", nargs="+", help="names, or beginnings of names (default: all)")
    parser.add_argument("--whole", action="store_true", help="search the whole sphere for all of them")
    parser.add_argument("--lying", choices=("told", "untold"), help="all lie on a plane, which is told or not")
    parser.add_argument("--farther", type=float, default=1.0, help="times the distance (default %(default)s)")
    parser.add_argument("--save", type=Path, help="write the pictures into this folder")
    a = parser.parse_args()
    print("| body | right first | and found | right poses | of them reported", end="")
    print(" | quality, lowest right / highest wrong | CPU median / most, s | wall, s | preparation CPU, s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for body in bodies(a.scene):
        if not a.bodies or body.name.startswith(tuple(a.bodies)):
            around = (180.0, 180.0) if a.whole or len(body.symmetry) > 1 else (WITHIN_DEG, ROLL_DEG)
            asked = Asked(*((WITHIN_DEG, 180.0) if a.lying else around), a.farther, told=a.lying == "told")
            print(row(body, a.views, a.noise, a.seed, a.save, asked), flush=True)


if __name__ == "__main__":
    main()
