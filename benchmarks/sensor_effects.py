"""The influence of each effect of a sensor on the sub-pixel position of marks and edges.

    python benchmarks/sensor_effects.py --pictures 6 [--only effects,rings,kinds,depth] [--rows "gamma,JPEG 75"]

effects:
Boards are seen from the front, turned by 7 degrees, at a random place of the pixel grid, through a sensor with nothing
but a blur of 0.7 px and the noise of 10500 electrons; then with one effect more. Found are chessboard corners and discs
(`target.boards.detect`, photometric fits) and a straight step edge (`image.profile`, cells of 17 x 17 px). Printed: rms
distance to the truth of corners and of discs; how much too large the discs' radius is, black on white; how far the edge
lies on its dark side, and how much that varies between cells. "common" is the shift of all marks of a picture alike,
which a calibration takes up, and is taken off the rms beside it.

rings: the same with single marks, discs in rings, found by `find_marks` through the camera; "predicted" is the rms by
their covariances.

kinds: four kinds of marks, upright and tilted by 45 degrees, fitted through the camera and without it.

depth: chessboard and rings tilted by 40 degrees and photographed (`Photographer`) through openings focused on their
middle: blur that grows to both sides, and within each mark.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh, merge
from cadcam.camera.aperture import Aperture
from cadcam.camera.camera import Camera
from cadcam.errors import CadcamError
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.image.profile import blur_of, step_sums
from cadcam.image.sensor.charge import Blooming, Exposure, Noise, Smear
from cadcam.image.sensor.light import Blur, Interlace, Motion, Vignetting
from cadcam.image.sensor.presets import PRESETS
from cadcam.image.sensor.sensor import Sensor
from cadcam.image.sensor.video import EdgeEnhancement, Gain, Gamma, Jitter, Jpeg, Quantization
from cadcam.native.profiles import StepCells
from cadcam.render.light import LIGHTS
from cadcam.render.photograph import Photographer, behind, blur_before
from cadcam.render.view import Scene
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.detect import detect
from cadcam.target.boards.pattern import parse_pattern
from cadcam.target.marks.find import find_marks
from cadcam.target.marks.fit import fit_marks
from cadcam.target.marks.ideal import board_picture, marks_picture
from cadcam.target.marks.mark import Mark, bulls_eye, dot, dot_and_ring, ring
from cadcam.target.marks.pose_ambiguity import fit_both_tilts

CAMERA = Camera.from_focal((480, 360), 500.0)
RING = dot_and_ring(7.0, 14.0, 21.0)
KINDS = (dot(21.0), ring(10.5, 21.0), RING, bulls_eye(5.0, 9.0, 13.0, 17.0, 21.0))
RINGS = [((i - 2.5) * 40.0, (j - 1.5) * 40.0) for j in range(4) for i in range(6)]
TILT = np.radians(40.0)
DEPTH_SAMPLES = 128
SHEET = np.array([[0, 2, 1], [0, 3, 2]])
CORNERS, DISCS = parse_pattern("chessboard:9x6:25mm"), parse_pattern("circles:9x6:25mm:14mm")
DISTANCE = 340.0  # mm: a cell is 37 px
DARK, LIGHT = 0.1, 0.8  # radiance of ink and paper
BASE = Sensor(name="blur and noise alone", blur=Blur(sigma_px=0.7), noise=Noise(10500.0, 2.3))
EDGE_SIZE, EDGE_TURN = 260, np.radians(5.0)


@dataclass(frozen=True)
class Row:
    """One sensor, and whether its gamma is undone before measuring."""

    name: str
    sensor: Sensor
    undone: bool = False

    def seen(self, radiance: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture that is measured."""
        picture = self.sensor.apply(radiance, rng=rng)
        gamma = self.sensor.gamma
        return gamma.undo(picture) if self.undone and gamma is not None else picture


def rows() -> Iterator[Row]:
    """Yield the sensors of the table."""
    yield Row(BASE.name, BASE)
    for gamma in (0.6, 1 / 2.2):
        bent = replace(BASE, gamma=Gamma(gamma))
        yield Row(f"gamma {gamma:.2g}", bent)
        yield Row(f"gamma {gamma:.2g}, undone", bent, undone=True)
    for strength in (0.4, 1.0):
        yield Row(
            f"edge enhancement {strength:g} along lines", replace(BASE, edge_enhancement=EdgeEnhancement(strength))
        )
    sharp = EdgeEnhancement(0.8, vertical=True)
    yield Row("edge enhancement 0.8 both ways", replace(BASE, edge_enhancement=sharp))
    yield Row("... and gamma 0.6, undone", replace(BASE, edge_enhancement=sharp, gamma=Gamma(0.6)), undone=True)
    for ns in (1.0, 5.0, 10.0):
        yield Row(f"jitter {ns:g} ns", replace(BASE, jitter=Jitter(ns)))
    for bits in (8, 6, 4):
        yield Row(f"{bits} bits", replace(BASE, quantization=Quantization(bits)))
    for quality in (95, 75, 50):
        yield Row(f"JPEG {quality}", replace(BASE, jpeg=Jpeg(quality)))
    yield Row("a quarter of the light, gain 4", replace(BASE, exposure=Exposure(0.25), gain=Gain(4.0)))
    yield Row("1/16 of the light, gain 16", replace(BASE, exposure=Exposure(1 / 16), gain=Gain(16.0)))
    yield Row("overexposed 1.6 times", replace(BASE, exposure=Exposure(1.6)))
    drained = Blooming(drained=0.95)
    yield Row(
        "overexposed 1.6 times, blooming, 5 % not drained", replace(BASE, exposure=Exposure(1.6), blooming=drained)
    )
    for sigma in (0.4, 1.4, 2.8):
        yield Row(f"blur {sigma:g} px", replace(BASE, blur=Blur(sigma)))
    yield Row("defocus by a disc of radius 4 px", replace(BASE, blur=Blur(0.7, 4.0)))
    for length in (2.0, 6.0):
        yield Row(f"motion of {length:g} px along lines", replace(BASE, motion=Motion((length, 0.0))))
    for shift in (0.2, 1.0):
        yield Row(f"field lag, {shift:g} px along lines", replace(BASE, interlace=Interlace((shift, 0.0))))
    yield Row("smear 1 %", replace(BASE, smear=Smear(0.01)))
    yield Row("vignetting, half at the corners", replace(BASE, vignetting=Vignetting(a2=-0.5)))
    for name, sensor in PRESETS.items():
        yield Row(f"preset {name}", sensor)
    yield Row("preset ccir-1996, gamma undone", PRESETS["ccir-1996"], undone=True)


def pose(pattern: Pattern, rng: np.random.Generator) -> Rigid:
    """Return camera_from_board: in front, turned, the middle anywhere within a pixel of the centre."""
    return pose_about((np.array(pattern.outline[:2]) + np.array(pattern.outline[2:])) / 2, rng)


def pose_about(middle: Array, rng: np.random.Generator, tilt: float = 0.0) -> Rigid:
    """Return camera_from_board with the board's `middle` (2,) mm on the axis, tilted about the picture's vertical."""
    aside = (rng.uniform(-0.5, 0.5, 2)) * DISTANCE / CAMERA.fx
    turned = Rigid.exp([0, 0, 0, 0, tilt, 0]) @ Rigid.exp([0, 0, 0, 0, 0, np.radians(7.0)])
    return Rigid(translation=np.array([*aside, DISTANCE])) @ turned @ Rigid(translation=-np.append(middle, 0.0))


def marks(row: Row, pattern: Pattern, pictures: int, seed: int) -> tuple[str, str, str]:
    """Return rms, the common shift and the radius' error, all in px as texts."""
    off, common, radius = [], [], []
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        at = pose(pattern, rng)
        radiance = board_picture(pattern, CAMERA, at, paper=LIGHT, ink=DARK, background=LIGHT)
        try:
            found = detect(row.seen(radiance, rng), pattern)
        except CadcamError:
            return "lost", "", ""
        error = found.q - CAMERA.project(at @ pattern.points)[found.points]
        common.append(error.mean(axis=0))
        off.append(error - common[-1])
        if found.radius_mm is not None:
            radius.append((found.radius_mm - 7.0) * CAMERA.fx / DISTANCE)
    rms = float(np.sqrt(np.mean(np.sum(np.concatenate(off) ** 2, axis=1))))
    shift = np.mean(common, axis=0)
    return f"{rms:.4f}", "{:+.3f} {:+.3f}".format(*shift), f"{np.mean(radius):+.3f}" if radius else ""


def rings(row: Row, pictures: int, seed: int) -> tuple[str, str, str]:
    """Return rms, the common shift and the predicted rms of single marks found by `find_marks`, px."""
    errors, told = [], []
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        at = pose_about(np.zeros(2), rng)
        poses = [at @ Rigid(translation=np.array([*place, 0.0])) for place in RINGS]
        radiance = marks_picture([RING] * len(poses), CAMERA, poses, paper=LIGHT, ink=DARK, background=LIGHT)
        seen, size = row.seen(radiance, rng), RING.radius * CAMERA.fx / DISTANCE
        try:
            found = find_marks(seen, RING, radius_px=size, count=len(RINGS), camera=CAMERA, normal=at.rotation[:, 2])
        except CadcamError:
            return "lost", "", ""
        truth = CAMERA.project(np.array([p.translation for p in poses]))
        errors.append(np.array([f.pixel - truth[np.argmin(np.sum((truth - f.pixel) ** 2, axis=1))] for f in found]))
        told += [np.trace(f.covariance) for f in found]
    return *scattered(errors), f"{np.sqrt(np.mean(told)):.4f}"


def kinds(row: Row, mark: Mark, tilt: float, pictures: int, seed: int) -> list[str]:
    """Return cells of fits through the camera and without it: rms error and, in brackets, what they tell, px.

    Each starts half a pixel off; errors count from the shift that the marks of a picture share.
    """
    errors: list[list[Array]] = [[], []]
    told: list[list[Array]] = [[], []]
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        at = pose_about(np.zeros(2), rng, tilt)
        poses = [at @ Rigid(translation=np.array([*place, 0.0])) for place in RINGS]
        sharp = marks_picture([mark] * len(poses), CAMERA, poses, paper=LIGHT, ink=DARK, background=LIGHT)
        seen = row.seen(sharp, rng)
        truth, J = CAMERA.project_with_jacobian(np.array([p.translation for p in poses]))
        shapes = J @ np.array([p.rotation for p in poses])[..., :2]
        plain = fit_marks(seen, mark, truth + np.array([0.4, -0.3]), shapes)
        for i, fit in enumerate((fit_both_tilts(seen, mark, CAMERA, plain, normal=at.rotation[:, 2]), plain)):
            off = fit.q - truth
            errors[i].append(off - off.mean(axis=0))
            told[i].append(np.trace(fit.covariance, axis1=1, axis2=2))
    off2 = [np.sum(np.concatenate(e) ** 2, axis=1) for e in errors]
    return [f"{np.sqrt(e.mean()):.4f} ({np.sqrt(np.mean(t)):.4f})" for e, t in zip(off2, told, strict=True)]


def chess_scene() -> Scene:
    """Return the chessboard as a mesh: black squares just before a sheet of paper."""
    side = 25.0
    ij = np.array([(i, j) for j in range(-1, CORNERS.rows) for i in range(-1, CORNERS.columns)])
    black = ij[CORNERS.black(side * (ij + 0.5))]
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.0]])
    return inked([(side * (square + np.array([i, j, 0])), SHEET) for i, j in black], CORNERS.outline)


def ring_scene() -> Scene:
    """Return the rings as a mesh: discs and rings of 96 sides just before a sheet of paper."""
    turn = np.linspace(0, 2 * np.pi, 97)[:-1]
    circle = np.stack([np.cos(turn), np.sin(turn), np.zeros(96)], axis=1) / np.sinc(1 / 96)  # as large as a true circle
    k, n = np.arange(96), np.roll(np.arange(96), -1)
    fan = np.stack([np.full(96, 96), n, k], axis=1)
    band = np.concatenate([np.stack([k, n, n + 96], axis=1), np.stack([k, n + 96, k + 96], axis=1)])
    disc = np.concatenate([3.5 * circle, np.zeros((1, 3))])
    ring = np.concatenate([10.5 * circle, 7.0 * circle])
    places = [np.array([x, y, 0.0]) for x, y in RINGS]
    shapes = [(vertices + p, faces) for p in places for vertices, faces in ((disc, fan), (ring, band))]
    return inked(shapes, (-140.0, -100.0, 140.0, 100.0))


def inked(shapes: list[tuple[Array, npt.NDArray[np.int64]]], outline: tuple[float, float, float, float]) -> Scene:
    """Return black shapes, counter-clockwise as the camera sees them, before a sheet of paper."""
    left, top, right, bottom = outline
    sheet = np.array([[left, top, 0.01], [right, top, 0.01], [right, bottom, 0.01], [left, bottom, 0.01]])
    meshes = [Mesh.single(sheet, SHEET, name="paper")]
    meshes += [Mesh.single(v, f, name=f"ink {k}") for k, (v, f) in enumerate(shapes)]
    grey = np.array([LIGHT] + [DARK] * len(shapes))
    return Scene.of(merge(meshes), colors=np.repeat(grey[:, None], 3, axis=1))


def depth(pictures: int, seed: int) -> None:
    """Print the table of tilted boards through openings."""
    print("| opening | blur on the near and far side, px | corners rms | common x y | rings rms | common x y |")
    print("|---|---|---|---|---|---|")
    chess, plate = Photographer(chess_scene()), Photographer(ring_scene())
    for diameter in (None, 4.0, 8.0, 16.0):
        aperture = None if diameter is None else Aperture(diameter, DISTANCE)
        reach = 100.0 * np.sin(TILT)
        blur = [0.0 if aperture is None else float(aperture.defocus_px(CAMERA, DISTANCE + s * reach)) for s in (-1, 1)]
        cells = [*tilted_corners(chess, aperture, pictures, seed), *tilted_rings(plate, aperture, pictures, seed)]
        name = "pinhole" if diameter is None else f"{diameter:g} mm"
        print(f"| {name} | {blur[0]:.1f} {blur[1]:.1f} | {' | '.join(cells)} |", flush=True)


def tilted_corners(photographer: Photographer, aperture: Aperture | None, pictures: int, seed: int) -> tuple[str, str]:
    """Return rms and common shift of corners on a tilted chessboard."""
    errors = []
    middle = (np.array(CORNERS.outline[:2]) + np.array(CORNERS.outline[2:])) / 2
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        at = pose_about(middle, rng, TILT)
        found = detect(photographed(photographer, at, aperture, rng), CORNERS)
        errors.append(found.q - CAMERA.project(at @ CORNERS.points)[found.points])
    return scattered(errors)


def tilted_rings(photographer: Photographer, aperture: Aperture | None, pictures: int, seed: int) -> tuple[str, str]:
    """Return rms and common shift of single marks on a tilted plate."""
    errors = []
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        at = pose_about(np.zeros(2), rng, TILT)
        seen = photographed(photographer, at, aperture, rng)
        truth = CAMERA.project(at @ np.array([[*place, 0.0] for place in RINGS]))
        size = (8.0, 22.0)
        found = find_marks(seen, RING, radius_px=size, count=len(RINGS), camera=CAMERA, normal=at.rotation[:, 2])
        errors.append(np.array([f.pixel - truth[np.argmin(np.sum((truth - f.pixel) ** 2, axis=1))] for f in found]))
    return scattered(errors)


def photographed(photographer: Photographer, at: Rigid, aperture: Aperture | None, rng: np.random.Generator) -> Picture:
    """Return the grey picture of a board through an opening, with the base sensor's blur and noise."""
    blur = blur_before(BASE, CAMERA, aperture)
    cutout = photographer.radiance(
        CAMERA, at, light=LIGHTS["even"], aperture=aperture, blur_px=blur, samples=DEPTH_SAMPLES
    )
    return behind(BASE, CAMERA).apply(to_gray(cutout.over((LIGHT, LIGHT, LIGHT))), rng=rng)


def scattered(errors: list[Array]) -> tuple[str, str]:
    """Return the rms of errors (N, 2) of each picture about their common shift, and that shift, px."""
    common = [e.mean(axis=0) for e in errors]
    off = np.concatenate([e - c for e, c in zip(errors, common, strict=True)])
    return f"{np.sqrt(np.mean(np.sum(off**2, axis=1))):.4f}", "{:+.3f} {:+.3f}".format(*np.mean(common, axis=0))


def edge_picture(offset: float) -> tuple[Picture, Array, Array]:
    """Return a step edge without blur, each pixel the mean over its area; places on it, and its normal to the light."""
    fine = (np.arange(EDGE_SIZE * 8) + 0.5) / 8 - 0.5
    normal = np.array([np.cos(EDGE_TURN), np.sin(EDGE_TURN)])
    middle = EDGE_SIZE / 2 + offset
    d = (fine - middle) * normal[0] + ((np.arange(EDGE_SIZE * 8) + 0.5) / 8 - 0.5 - middle)[:, None] * normal[1]
    # the mean of a straight edge over a sample of 1/8 px is a ramp as wide as that
    share = np.clip(d * 8 + 0.5, 0.0, 1.0).reshape(EDGE_SIZE, 8, EDGE_SIZE, 8).mean(axis=(1, 3))
    along = np.array([-normal[1], normal[0]])
    places = middle + np.arange(-100, 101, 20)[:, None] * along
    return (DARK + (LIGHT - DARK) * share).astype(np.float32), places, normal


def edges(row: Row, pictures: int, seed: int) -> tuple[str, str]:
    """Return how far the edge lies on its dark side, and the spread of that between cells, px."""
    shifts = []
    for k in range(pictures):
        rng = np.random.default_rng([seed, k])
        radiance, q, normal = edge_picture(rng.uniform(-0.5, 0.5))
        seen = row.seen(radiance, rng)
        n, reach = np.broadcast_to(normal, q.shape), np.full(len(q), 8.0)
        told = replace(row, sensor=replace(row.sensor, exposure=None)).seen(radiance, rng)  # as fainter edges tell it
        blur = blur_of(told, q, n, reach=reach, half_length=8.0)
        level = np.full((len(q), 2), np.inf)  # both sides of this edge are: slopes left free only let noise in
        found = step_sums(seen, StepCells(q, n, reach, reach, 8.0, blur)).solved(level)
        shifts.append(found.moment / found.contrast)
    return f"{np.mean(shifts):+.3f}", f"{np.std(shifts):.4f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--pictures", type=int, default=6, help="pictures a row")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", default="effects,rings,depth")
    parser.add_argument("--rows", default="", help="sensors to look at: parts of their names, with commas between")
    arguments = parser.parse_args()
    wanted = arguments.rows.split(",")
    chosen = [row for row in rows() if any(part in row.name for part in wanted)]
    if "effects" in arguments.only:
        effects(chosen, arguments.pictures, arguments.seed)
    if "rings" in arguments.only:
        print("| sensor | rings rms | common x y | predicted |")
        print("|---|---|---|---|")
        for row in chosen:
            print(f"| {row.name} | {' | '.join(rings(row, arguments.pictures, arguments.seed))} |", flush=True)
    if "kinds" in arguments.only:
        print("| sensor | mark | tilt | camera (predicted) | none (predicted) |")
        for row in chosen:
            for mark in KINDS:
                for tilt in (0.0, 45.0):
                    cells = kinds(row, mark, np.radians(tilt), arguments.pictures, arguments.seed)
                    print(f"| {row.name} | {mark} | {tilt:.0f} | {' | '.join(cells)} |", flush=True)
    if "depth" in arguments.only:
        depth(arguments.pictures, arguments.seed)


def effects(chosen: list[Row], pictures: int, seed: int) -> None:
    """Print the table of effects on boards and edges."""
    print("| sensor | corners rms | common x y | discs rms | common x y | disc radius | edge to dark | edge spread |")
    print("|---|---|---|---|---|---|---|---|")
    for row in chosen:
        corner, disc = marks(row, CORNERS, pictures, seed), marks(row, DISCS, pictures, seed)
        print(f"| {row.name} | {' | '.join((*corner[:2], *disc, *edges(row, pictures, seed)))} |", flush=True)


if __name__ == "__main__":
    main()
