"""Path-trace a scene with exact poses for benchmarks/locate.py, by Mitsuba 3.

    python benchmarks/locate_scene.py OUT --part bracket

A machined bracket (or a small ship block) on a bench among clutter, a cable over the part, a camera with a distorting
lens. Writes into OUT what benchmarks/locate.py --scene reads: model.obj (metres), camera.json and K.txt, gt.csv
(camera_from_model, metres), n0, n3, n8/images (noise of 0, 3 and 8 grey levels of 255), starts.txt and
starts.meta.csv. The same seed gives the same scene. Mitsuba compiles by LLVM: with LLVM 14 or 15 take
`pip install mitsuba==3.6.4`; later ones ask for instructions that these do not know. A view of the bracket takes some 5
seconds of CPU time a round. Views are written one by one; called again with the same arguments, those that are there
are kept.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts import machined_bracket, ship_block
from cadcam.cad.write import write_model
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.files.camera import write_camera
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import write_picture
from locate_banded import GAP, Dressing, cover_foot, plate_print, stepped_cover, thin_plate
from locate_drawn import Lamps, drawn
from locate_traced import LAMPS, Bench, pictures

NOISES = (0, 3, 8)
WORST = (np.radians(20.0), 40.0, 0.10)  # of a start: turn, shift in px, share of the depth
WHITE = 0.92  # where the brightest hundredth of a picture begins


@dataclass(frozen=True)
class Setting:
    """A part as it is traced and as its CAD file has it, cables over it (as ways through points), and the camera."""

    traced: Callable[[], Mesh]
    model: Callable[[], Mesh]
    cables: tuple[tuple[tuple[float, float, float], ...], ...]
    camera: Camera
    distance: tuple[float, float]  # mm
    elevation_deg: tuple[float, float]
    azimuth_deg: tuple[float, float]
    dressing: Callable[[], Dressing] = tuple
    gap: float = 0.0  # mm, under the part
    lamps: Lamps = LAMPS
    albedo: tuple[float, float] = (0.52, 0.33)  # of part and bench top
    roughness: float = 0.25


SETTINGS = {
    "bracket": Setting(
        lambda: machined_bracket(sides=384),
        lambda: machined_bracket(sides=96),
        (((-150, -80, 4), (-40, 10, 30), (4, 30, 66), (60, 45, 24), (110, 60, 16), (220, 100, 4)),),
        Camera.from_focal(
            (1024, 768), 1420.0, fy=1418.0, cx=520.3, cy=377.9, lens=BrownConrady(-0.16, 0.09, 8e-4, -5e-4)
        ),
        (420.0, 560.0),
        (25.0, 60.0),
        (0.0, 330.0),
    ),
    "block": Setting(
        lambda: ship_block(triangles=30_000, size=(2400.0, 2000.0, 1200.0)),
        lambda: ship_block(triangles=30_000, size=(2400.0, 2000.0, 1200.0)),
        (((-900, 200, 40), (300, 500, 700), (900, 800, 1240), (1600, 900, 1230), (3300, 1000, 40)),),
        Camera.from_focal(
            (1280, 960), 1080.0, fy=1083.0, cx=633.1, cy=486.2, lens=BrownConrady(-0.21, 0.10, -6e-4, 9e-4)
        ),
        (4300.0, 5600.0),
        (15.0, 50.0),
        (200.0, 330.0),
    ),
    "plate": Setting(
        lambda: thin_plate(sides=384),
        lambda: thin_plate(sides=96),
        (),
        Camera.from_focal(
            (560, 448), 1100.0, fy=1098.0, cx=281.3, cy=221.9, lens=BrownConrady(-0.12, 0.07, 5e-4, -4e-4)
        ),
        (420.0, 560.0),
        (30.0, 65.0),
        (0.0, 330.0),
        lambda: plate_print(sides=384),
    ),
    "cover": Setting(
        stepped_cover,
        stepped_cover,
        (),
        Camera.from_focal(
            (560, 448), 1100.0, fy=1098.0, cx=281.3, cy=221.9, lens=BrownConrady(-0.12, 0.07, 5e-4, -4e-4)
        ),
        (420.0, 560.0),
        (20.0, 55.0),
        (0.0, 330.0),
        cover_foot,
        GAP,
    ),
}


def views(setting: Setting, mesh: Mesh, n: int, rng: np.random.Generator) -> list[Rigid]:
    """Return n poses camera_from_model around the part, its middle near the picture's."""
    middle = mesh.bounds.mean(axis=0)
    reach = np.linalg.norm(mesh.size_mm) / 2
    poses = []
    for k in range(n):
        low, high = setting.azimuth_deg
        azimuth = np.radians(low + (high - low) * (k + rng.random()) / n)
        elevation, distance = (
            rng.uniform(*np.radians(setting.elevation_deg)),
            rng.uniform(*setting.distance),
        )
        away = np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
        target = middle + rng.uniform(-0.15, 0.15, 3) * reach
        roll = Rigid.exp(np.array([0, 0, 0, 0, 0, rng.uniform(-0.12, 0.12)]))
        poses.append(roll @ Rigid.look_at(middle + distance * away, target))
    return poses


def starts(
    camera: Camera, truth: Rigid, mesh: Mesh, n: int, rng: np.random.Generator
) -> list[tuple[Rigid, float, float]]:
    """Return n rough poses with their turn (rad) and mean vertex displacement (px), from small to `WORST`."""
    p = truth @ mesh.vertices
    q = camera.project(p)
    middle = truth @ mesh.bounds.mean(axis=0)
    out: list[tuple[Rigid, float, float]] = []
    while len(out) < n:
        scale = (len(out) + 1) / n
        axis = rng.standard_normal(3)
        turn = axis / np.linalg.norm(axis) * rng.uniform(0, WORST[0]) * scale
        shift = rng.uniform(-1, 1, 2) * WORST[1] * scale / np.sqrt(2) * middle[2] / camera.fx
        depth = rng.uniform(-1, 1) * WORST[2] * scale * middle[2]
        about = Rigid(translation=middle)
        moved = Rigid(translation=np.array([*shift, depth])) @ about @ Rigid.exp(np.array([0, 0, 0, *turn])) @ about.inv
        displacement = float(np.linalg.norm(camera.project(moved @ p) - q, axis=1).mean())
        if displacement <= 46.0:  # as in the set that this follows
            out.append((moved @ truth, float(np.linalg.norm(turn)), displacement))
    return out


def way(points: tuple[tuple[float, float, float], ...]) -> Array:
    """Return a smooth line (M, 3) near the points, in the upright plane that fits them best."""
    from scipy.interpolate import make_interp_spline

    p = np.array(points)
    flat = p[:, :2] - p[:, :2].mean(axis=0)
    along = np.linalg.svd(flat)[2][0]
    s, t = flat @ along, np.linspace(0, 1, len(p))
    spline = make_interp_spline(t, np.column_stack([s, p[:, 2]]), k=3)(np.linspace(0, 1, 200))
    return np.column_stack([p[:, :2].mean(axis=0) + spline[:, :1] * along, np.maximum(spline[:, 1], p[:, 2].min())])


def row(pose: Rigid) -> str:
    return ",".join(f"{v:.12g}" for v in [*pose.rotation.ravel(), *(pose.translation / 1000)])


def setting_of(part: str, seed: int, data: Path | None) -> Setting:
    """Return the setting of a part: its own, or the one that the seed draws."""
    if part in SETTINGS:
        return SETTINGS[part]
    d = drawn(part, seed, data)
    around = (0.0, 330.0)
    return Setting(
        d.traced,
        d.model,
        (d.cable,),
        d.camera,
        d.distance,
        d.elevation_deg,
        around,
        lamps=d.lamps,
        albedo=d.albedo,
        roughness=d.roughness,
    )


def generate(out: Path, setting: Setting, *, views_n: int, starts_n: int, rounds: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    model, traced = setting.model(), setting.traced()
    poses = views(setting, model, views_n, rng)
    out.mkdir(parents=True, exist_ok=True)
    write_model(out / "model.obj", replace(model, vertices=model.vertices / 1000))
    write_camera(out / "camera.json", setting.camera)
    np.savetxt(out / "K.txt", setting.camera.K)
    head = "frame," + ",".join(f"r{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3)) + ",tx,ty,tz"
    truth = "\n".join([head, *(f"{k},{row(pose)}" for k, pose in enumerate(poses))]) + "\n"
    if (out / "gt.csv").exists() and (out / "gt.csv").read_text() != truth:
        raise SystemExit(f"{out} holds other views; give another folder")
    (out / "gt.csv").write_text(truth)
    rows: list[str] = []
    meta = ["row,frame,rot_deg,disp_px"]
    for k, pose in enumerate(poses):
        for start, turn, displacement in starts(setting.camera, pose, model, starts_n, rng):
            meta.append(f"{len(rows)},{k},{np.degrees(turn):.4f},{displacement:.3f}")
            rows.append(f"{k} " + row(start).replace(",", " "))
    (out / "starts.txt").write_text("\n".join(rows) + "\n")
    (out / "starts.meta.csv").write_text("\n".join(meta) + "\n")
    centred = -np.append(model.bounds.mean(axis=0)[:2], model.bounds[0, 2] - setting.gap)
    bench = Bench(
        replace(traced, vertices=traced.vertices + centred),
        tuple(way(cable) + centred for cable in setting.cables),
        float(np.linalg.norm(model.size_mm) / 2),
        seed,
        tuple((replace(mesh, vertices=mesh.vertices + centred), albedo) for mesh, albedo in setting.dressing()),
        setting.lamps,
        setting.albedo,
        setting.roughness,
    )
    todo = {
        k: pose @ Rigid(translation=-centred)
        for k, pose in enumerate(poses)
        if not all(photo(out, noise, k).exists() for noise in NOISES)
    }
    for k, radiance in pictures(bench, setting.camera, todo, rounds):
        rng = np.random.default_rng([seed, k])
        clean = WHITE * radiance / np.quantile(radiance, 0.99)
        for noise in NOISES:
            write_picture(photo(out, noise, k), clean + noise / 255 * rng.standard_normal(clean.shape))
        print(f"view {k} of {views_n} written", flush=True)


def photo(out: Path, noise: int, view: int) -> Path:
    return out / f"n{noise}/images/{view:04d}.png"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="folder to write the scene to")
    parser.add_argument(
        "--part",
        default="bracket",
        help=f"{', '.join(SETTINGS)}; or a part of benchmarks/locate_drawn.py, or a CAD file, in a scene drawn"
        " by the seed (default %(default)s)",
    )
    parser.add_argument("--data", type=Path, help="folder of public data, for the parts of cad_nist_ctc")
    parser.add_argument("--views", type=int, default=12, help="photos at each noise (default %(default)s)")
    parser.add_argument("--starts", type=int, default=24, help="rough poses of each photo (default %(default)s)")
    parser.add_argument(
        "--rounds",
        type=int,
        default=48,
        help="places in a pixel near the part, a third of it elsewhere (default %(default)s)",
    )
    parser.add_argument("--seed", type=int, default=1, help="of views, starts, clutter and noise (default %(default)s)")
    a = parser.parse_args()
    generate(
        a.out, setting_of(a.part, a.seed, a.data), views_n=a.views, starts_n=a.starts, rounds=a.rounds, seed=a.seed
    )


if __name__ == "__main__":
    main()
