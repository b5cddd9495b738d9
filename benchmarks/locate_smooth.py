"""Whether smooth bodies are found, of which a photo shows nothing but a contour, and how true their covariance is.

    python benchmarks/locate_smooth.py
    python benchmarks/locate_smooth.py --seeds 3 --list

Six bodies without an edge (ball, ellipsoid, torus, rounded cone, capsule, bottle), each from three sides on a ground of
patches and discs, with noise 0.03, as bright as the ground around them on average. Photos are rendered from meshes ten
times as fine as those that are located. Prints how many right poses are found, from rough starts (12 degrees, 20 px and
5 % of the distance off) and without one, and how many wrong answers: each other body looked for where one stands, and
each where there is none. A wrong answer whose whole outline lies on that of the body that is there, to 1.5 px, is
counted as a lookalike: no contour can tell it.

Then the position of balls of several finenesses in photos of the true ball, evenly bright or shaded: the normalised
error, sqrt(mean of d' C^-1 d / 3), and the error along the sight beside what is stated.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter

from cadcam.arrays import Array, Mask
from cadcam.cad.mend import mend
from cadcam.cad.mesh import Mesh
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from cadcam.render.view import PLAIN, Channel

CAMERA = Camera.from_focal((640, 480), 900.0)
VIEWS = ((1.0, 0.4, 0.5), (0.3, -1.0, 0.9), (-0.8, 0.5, -0.3))
LOOK = replace(PLAIN, background=(0.0, 0.0, 0.0), supersampling=4)
AWAY, BRIGHT, NOISE = 7.5, 0.72, 0.03  # radii from the camera; share of the rendering's brightness; sd
RIGHT_PX = 1.5  # mean distance of outlines
DROP = ((0, -40), (28, -36), (38, -22), (24, 10), (10, 36), (0, 42))
BOTTLE = ((0, -55), (22, -50), (30, -35), (30, 0), (24, 20), (12, 34), (11, 46), (0, 52))
BODIES = ("ball", "ellipsoid", "torus", "drop", "capsule", "bottle")
LEVELS, BALLS = (3, 4, 5, 6, 7), 8  # of balls: 8 x 4^level facets; photos of each


def globe(level: int) -> Array:
    """Return the triangles (F, 3, 3) of a unit ball: an octahedron cut so often, its corners pushed out."""
    p = np.array([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)], float)
    T = p[[(k, (k + 1) % 4, 4) for k in range(4)] + [((k + 1) % 4, k, 5) for k in range(4)]]
    for _ in range(level):
        a, b, c = T[:, 0], T[:, 1], T[:, 2]
        d, e, f = (a + b) / 2, (b + c) / 2, (c + a) / 2
        T = np.concatenate([np.stack(t, axis=1) for t in ((a, d, f), (d, b, e), (f, e, c), (d, e, f))])
    return np.asarray(T / np.linalg.norm(T, axis=2, keepdims=True))


def turned(r: Array, z: Array, n: int, *, closed: bool = False) -> Array:
    """Return the triangles (F, 3, 3) of a profile r, z (m,), from below to above, turned about z in n steps."""
    t = 2 * np.pi * np.arange(n) / n
    rings = np.stack([r[:, None] * np.cos(t), r[:, None] * np.sin(t), np.repeat(z[:, None], n, 1)], axis=2)
    a, b = (rings, np.roll(rings, -1, axis=0)) if closed else (rings[:-1], rings[1:])
    a1, b1 = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    T = np.concatenate(
        [np.stack([a, a1, b1], axis=2).reshape(-1, 3, 3), np.stack([a, b1, b], axis=2).reshape(-1, 3, 3)]
    )
    return np.asarray(T[np.linalg.norm(np.cross(T[:, 1] - T[:, 0], T[:, 2] - T[:, 0]), axis=1) > 1e-9])


def smooth(knots: Sequence[tuple[float, float]], n: int) -> tuple[Array, Array]:
    """Return the profile r, z (n,) of a smooth curve through knots, level at both ends."""
    p = np.array(knots, float)
    along = np.append(0, np.cumsum(np.hypot(*np.diff(p, axis=0).T)))
    curve = CubicSpline(along, p, bc_type=((1, (1.0, 0.0)), (1, (-1.0, 0.0))))
    r, z = curve(along[-1] * (1 - np.cos(np.pi * np.linspace(0, 1, n))) / 2).T
    r[[0, -1]] = 0.0
    return np.abs(r), z


def triangles(name: str, fine: bool) -> Array:
    """Return the triangles of a body, mm: those that are located, or those that are pictured."""
    ball, n = globe(7 if fine else 5), 400 if fine else 96
    if name == "torus":
        u = 2 * np.pi * np.arange(n // 2) / (n // 2)
        return turned(38 + 16 * np.cos(u), 16 * np.sin(u), n, closed=True)
    if name == "capsule":
        u = np.linspace(-np.pi / 2, 0, n // 4 + 1)
        r, z = 25 * np.cos(u), -30 + 25 * np.sin(u)
        return turned(np.append(r, r[::-1]), np.append(z, -z[::-1]), n)
    if name in ("drop", "bottle"):
        return turned(*smooth(DROP if name == "drop" else BOTTLE, n), n)
    return np.asarray(ball * (45.0 if name == "ball" else np.array([55.0, 42.0, 33.0])))


def part_of(T: Array) -> Part:
    """Return the part of loose triangles (F, 3, 3)."""
    return Part.of(mend(Mesh.single(T.reshape(-1, 3), np.arange(3 * len(T)).reshape(-1, 3)))[0])


@cache
def body(name: str, fine: bool = False) -> Part:
    return part_of(triangles(name, fine))


def ground(rng: np.random.Generator) -> Array:
    """Return a ground (H, W) of soft light, patches and discs."""
    (width, height), clutter = CAMERA.size, rng.normal(size=CAMERA.size[::-1])
    y, x = np.mgrid[:height, :width]
    gray = 0.45 + 6 * gaussian_filter(clutter, 60) + 0.06 * gaussian_filter(rng.normal(size=clutter.shape), 2)
    for k in range(18):
        at, turn = rng.uniform(0, 1, 2) * CAMERA.size, rng.uniform(0, np.pi)
        u, v = (x - at[0]) * np.cos(turn) + (y - at[1]) * np.sin(turn), (y - at[1]) * np.cos(turn)
        v = v - (x - at[0]) * np.sin(turn)
        w, h, r = rng.uniform(10, 90), rng.uniform(4, 60), rng.uniform(8, 45)
        inside = (np.abs(u) < w) & (np.abs(v) < h) if k < 14 else np.hypot(u, v) < r
        gray = np.where(inside, gray + rng.uniform(-0.22, 0.22), gray)
    return np.asarray(np.clip(gray, 0.02, 0.98))


def blurred(gray: Array, noise: float, rng: np.random.Generator) -> Photo:
    gray = np.clip(gaussian_filter(gray, 0.6) + noise * rng.normal(size=gray.shape), 0, 1)
    return Photo.of(np.asarray(np.round(gray * 255) / 255, np.float32), CAMERA)


def posed(name: str, view: int, rng: np.random.Generator) -> Rigid:
    """Return camera_from_part: a body as seen from one side, somewhat beside the middle of the picture."""
    low, high = body(name).scene.mesh.bounds
    radius = float(np.linalg.norm(high - low)) / 2
    at = Rigid.look_at(
        (low + high) / 2 + AWAY * radius * np.array(VIEWS[view]) / np.linalg.norm(VIEWS[view]), (low + high) / 2
    )
    return Rigid(translation=np.array([*rng.uniform(-0.4, 0.4, 2) * radius, 0])) @ at


def pictured(name: str | None, pose: Rigid, rng: np.random.Generator) -> Photo:
    """Return a photo of a body, or of the ground alone."""
    gray = ground(rng)
    if name is not None:
        view = open_renderer(body(name, True).scene).render(CAMERA, pose, look=LOOK, channels=Channel.IMAGE)
        gray = (1 - view.coverage) * gray + BRIGHT * view.gray
    return blurred(gray, NOISE, rng)


def middle(name: str) -> Array:
    return np.asarray(np.mean(body(name).scene.mesh.bounds, axis=0))


def rough(name: str, pose: Rigid, rng: np.random.Generator) -> Rigid:
    """Return a pose 12 degrees, 20 px and 5 % of the distance off."""
    at = Rigid(translation=middle(name))
    axis, way = rng.normal(size=3), rng.normal(size=2)
    turn = Rigid.exp([0, 0, 0, *(np.radians(12) * axis / np.linalg.norm(axis))])
    z = float((pose @ at.translation)[2])
    slide = Rigid(
        translation=np.array([*(20 * way / np.linalg.norm(way) * z / CAMERA.fx), 0.05 * z * rng.choice([-1, 1])])
    )
    return slide @ pose @ at @ turn @ at.inv


def covered(name: str, pose: Rigid) -> Mask:
    return np.isfinite(open_renderer(body(name).scene).render(CAMERA, pose, channels=Channel.DEPTH).depth)


def outlines_apart(one: Mask, other: Mask) -> float:
    """Return the mean distance (px) of the outlines of two regions."""
    border = (other ^ np.roll(other, 1, axis=0)) | (other ^ np.roll(other, 1, axis=1))
    return float((one ^ other).sum() / max(int(border.sum()), 1))


@dataclass(frozen=True)
class Answer:
    """What was looked for and shown, whether it was found, and how far (px) its outline is from the one there."""

    what: str
    location: Location
    off_px: float

    def __str__(self) -> str:
        return f"{self.what}: {self.location.quality:.2f}, outline {self.off_px:.1f} px off; {self.location.reason}"


def answered(name: str, shown: str | None, view: int, seed: int, *, start: bool = True) -> Answer:
    """Return the answer of one search; with the body itself, or another one at its place, or none."""
    number = BODIES.index(name if shown is None else shown)
    rng = np.random.default_rng([seed, number, view])
    there = posed(shown or name, view, rng)
    photo = pictured(shown, there, rng)
    own = there
    if shown not in (None, name):
        own = posed(name, view, rng)
        own = Rigid(translation=there @ middle(shown or name) - own @ middle(name)) @ own
    found = locate_part(body(name), [photo], rough(name, own, rng) if start else None)
    off = outlines_apart(covered(name, found.pose.world_from_part), covered(shown, there)) if shown else np.inf
    return Answer(f"{name} in a photo of {shown or 'no body'} from side {view + 1}", found, off)


def ball_errors(level: int, shaded: bool) -> tuple[float, float, float]:
    """Return a ball's normalised position error, and its error along the sight and that stated (rms, mm)."""
    part, true, rows = part_of(50 * globe(level)), part_of(50 * globe(8)), []
    for seed in range(BALLS):
        rng = np.random.default_rng([seed, level])
        d = rng.normal(size=3)
        pose = Rigid.look_at(rng.uniform(440, 560) * d / np.linalg.norm(d), np.zeros(3))
        view = open_renderer(true.scene).render(
            CAMERA, pose, look=replace(LOOK, supersampling=6), channels=Channel.IMAGE
        )
        bright = 0.9 * view.gray + 0.85 * (1 - view.coverage) if shaded else 0.3 + 0.4 * view.coverage
        start = pose @ Rigid.exp([*rng.normal(scale=5, size=3), *rng.normal(scale=0.2, size=3)])
        found = locate_part(part, [blurred(np.asarray(bright, np.float64), 0.01, rng)], start).pose
        off, C = (found.world_from_part.inv @ pose).translation, found.covariance[:3, :3]
        sight = found.world_from_part.rotation[2]
        rows.append((off @ np.linalg.solve(C, off) / 3, (sight @ off) ** 2, sight @ C @ sight))
    normalised, error, stated = np.sqrt(np.mean(rows, axis=0))
    return float(normalised), float(error), float(stated)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2, help="photos of each body from each side")
    parser.add_argument("--list", action="store_true", help="print what is refused, or found wrongly")
    asked = parser.parse_args()
    sides = range(len(VIEWS))
    started = [answered(n, n, k, s) for n in BODIES for k in sides for s in range(asked.seeds)]
    unaided = [answered(n, n, k, 0, start=False) for n in BODIES for k in sides]
    others = [answered(n, o, k, 0) for n in BODIES for o in BODIES for k in sides if o != n]
    absent = [answered(n, None, k, s) for n in BODIES for k in sides for s in range(2)]
    print("| asked | of | found | right | lookalikes |\n|---|---|---|---|---|")
    for what, every in (("a rough start", started), ("without a start", unaided)):
        found = [a for a in every if a.location.found]
        print(f"| {what} | {len(every)} | {len(found)} | {sum(a.off_px < RIGHT_PX for a in found)} | |")
    for what, every in (("another body there", others), ("no body there", absent)):
        found = [a for a in every if a.location.found]
        print(f"| {what} | {len(every)} | {len(found)} | | {sum(a.off_px < RIGHT_PX for a in found)} |")
    if asked.list:
        refused = [a for a in (*started, *unaided) if not a.location.found]
        print("", *refused, *(a for a in (*others, *absent) if a.location.found), sep="\n")
    print("\n| facets of a ball | photo | normalised | error in depth, stated, mm |\n|---|---|---|---|")
    for level in LEVELS:
        for shaded in (False, True):
            normalised, error, stated = ball_errors(level, shaded)
            print(
                f"| {8 * 4**level} | {'shaded' if shaded else 'even'} | {normalised:.2f} | {error:.3f}, {stated:.3f} |"
            )


if __name__ == "__main__":
    main()
