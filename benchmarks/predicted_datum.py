"""The uncertainty predicted for features that are judged from a datum, compared with what `cadcam verify` finds.

    python benchmarks/predicted_datum.py [--trials 24] [--places 12] [--only three,two,few,fixture]

three: three cameras some 2.4 m from a block of a ship's double bottom; two floors and a longitudinal are the datum.
two: two of these, calibrated less well; few: three, and the datum is two small bodies only. fixture: two cameras 0.6 m
from a plate with two ribs, a block and a pin; nothing of its prediction was read from pictures: the contrast is that of
its faces as painted and lit, the common error of edges the one that a scene has which states none.

Predicted (`cadcam.plan`, with a `datum`): from cameras, the noise of grey levels, the contrast and the common error of
edges, and the calibration. Found: each trial draws the cameras' errors anew, takes pictures of the block, which is as
drawn, through lens and sensor (fresh noise on pictures rendered with the block in `places` positions, some pixels
apart), and verifies it, from a pose some pixels off. Whatever displacement is found is error. Printed for each feature:
over X, Y, Z the standard deviation predicted, the error found (rms) and what `verify` stated (rms), the ratio of found
to predicted, how many trials measured it in all three directions, and the mean error; last the rms of all ratios.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shipblock import ship_block
from cadcam.camera.aperture import Aperture
from cadcam.camera.extended_pinhole import camera_of, internals_of
from cadcam.camera.sensor_format import sensor_format
from cadcam.camera.viewpoint import Viewpoint
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.image.picture import to_gray
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.plan.layout import CandidateSurvey, survey
from cadcam.plan.scene.feature import LayoutFeature
from cadcam.plan.scene.layout_scene import CalibratedFrom, CameraType, LayoutScene, Mount
from cadcam.plan.sight.candidate import Candidate
from cadcam.plan.sight.datum import USUAL_PX
from cadcam.plan.uncertainty.finding import Finder
from cadcam.render.photograph import Photographer, behind, blur_before
from cadcam.render.view import Scene
from cadcam.verify.inspection import Inspection, inspect
from cadcam.verify.tolerances.tolerance import Feature, Limit, Quantity, Selection, Tolerances
from predicted import LIGHT, SENSOR, SHORT, STEEL
from verify_parts import fixture

SAMPLES, BACKGROUND = 16, (0.5, 0.5, 0.5)
AXES = tuple(Limit(Quantity.POSITION, 1.0, direction=axis) for axis in np.eye(3))
JUDGED = ("bar 1.1 port", "bar 2.1 port", "bracket 2.1 port", "longitudinal 2 port")

EYES = ((300.0, 1400.0, 2500.0), (1700.0, 1500.0, 2500.0), (850.0, 900.0, 2300.0))
AIM = (1000.0, 700.0, 200.0)
BODIES = (
    "tank top", "bottom shell", "floor 1 port", "floor 2 port", "longitudinal 1 port", "longitudinal 2 port",
    "bar 1.1 port", "bar 2.1 port", "bracket 2.1 port",
)  # fmt: skip
DARK, PAINT = 0.25, 0.5  # reflectances of the fixture's plate, and of what stands on it
WELL = CalibratedFrom(40, 0.05, 0.05)


@cache
def block() -> Mesh:
    """Return the bodies of the block that the cameras see."""
    return ship_block(triangles=29_000, size=(2400.0, 2400.0, 1200.0)).subset(BODIES)


@cache
def painted() -> Mesh:
    """Return a fixture of grey steel, the bodies on its plate painted lighter."""
    made = fixture()
    shade = np.where(np.array(made.part_names) == "plate", DARK, PAINT)
    return replace(made, part_colors=np.repeat(shade[:, None], 3, axis=1).astype(np.float32))


@dataclass(frozen=True)
class Case:
    """A layout, and the datum and features that are judged in it; shift_mm: of the part between its places.

    contrast, common_px: None where they are not read from pictures.
    """

    eyes: tuple[tuple[float, float, float], ...]
    datum: tuple[str, ...]
    judged: tuple[str, ...] = JUDGED
    calibration: CalibratedFrom = WELL
    mesh: Callable[[], Mesh] = block
    aim: tuple[float, float, float] = AIM
    focal_mm: float = 8.0
    shift_mm: float = 4.0
    contrast: float | None = 0.14  # of most edges of grey steel by a ring light
    common_px: float | None = 0.018  # as `verify` estimates it in such pictures


FLOORS = ("floor 1 port", "floor 2 port", "longitudinal 1 port")
CASES = {
    "three": Case(EYES, FLOORS),
    "two": Case(EYES[:2], FLOORS, calibration=CalibratedFrom(20, 0.1, 0.2)),
    "few": Case(EYES, ("bar 1.1 port", "bracket 2.1 port"), ("floor 1 port", "bar 2.1 port", "longitudinal 2 port")),
    "fixture": Case(
        eyes=((-150.0, -200.0, 480.0), (330.0, -150.0, 500.0)),
        datum=("plate", "rib 1"),
        judged=("rib 2", "block", "pin"),
        calibration=CalibratedFrom(30, 0.05, 0.02),
        mesh=painted,
        aim=(80.0, 55.0, 15.0),
        focal_mm=16.0,
        shift_mm=0.5,
        contrast=None,
        common_px=None,
    ),
}


def gray(case: Case) -> float:
    """Return the noise of grey levels of a part's darkest paint, as lit."""
    assert SENSOR.noise is not None
    level = SHORT * (STEEL if case.contrast is not None else DARK) * 0.7
    return float(np.hypot(SENSOR.noise.sigma(level) / SHORT, 1 / 255 / np.sqrt(12)))


def shaded(case: Case) -> float:
    """Return the usual contrast of upright bodies on a plate: of plate, top and sides, as painted and lit, the median.

    Over all pairs of these, and over the cameras.
    """
    found: list[float] = []
    for eye in case.eyes:
        cosine = np.abs(np.subtract(eye, case.aim)) / np.linalg.norm(np.subtract(eye, case.aim))
        lit = LIGHT.ambient + LIGHT.flash * cosine
        shades = [DARK * lit[2], *PAINT * lit]
        found += [abs(a - b) for a, b in combinations(shades, 2)]
    return float(np.median(found))


def finder(case: Case) -> Finder:
    """Return how well edges are found, as a user would state it."""
    contrast = shaded(case) if case.contrast is None else case.contrast
    return Finder(gray=gray(case), contrast=contrast, floor_px=case.common_px or 0.0)


def planned(case: Case) -> CandidateSurvey:
    """Return the layout's survey."""
    drawn = Scene.of(case.mesh())
    mount = Mount("m", np.array(case.eyes), np.tile(case.aim, (len(case.eyes), 1)), ("c",), fixed=True)
    return survey(
        LayoutScene(
            part=case.mesh(),
            poses={"here": Rigid()},
            cameras={"c": CameraType("c", sensor_format("IMX273").with_pixels((720, 540)), case.focal_mm, 5.6)},
            mounts=(mount,),
            features=tuple(LayoutFeature.selected(name, Selection(name), drawn, AXES) for name in case.judged),
            finder=finder(case),
            calibration=case.calibration,
            datum=tuple(Selection(name) for name in case.datum),
        )
    )


def off(camera: Candidate, rng: np.random.Generator) -> Viewpoint:
    """Return the viewpoint as a calibration gives it whose errors are drawn."""
    view = camera.viewpoint
    d = sum((D @ source.root @ rng.normal(size=len(source.covariance)) for source, D in view.errors), np.zeros(11))
    F, R = view.camera_from_world.origin + d[:3], view.camera_from_world.rotation @ exp(d[3:6])
    camera_ = camera_of(internals_of(view.camera.K) + d[6:11], view.camera.size)
    return replace(view, camera=camera_, camera_from_world=Rigid(R, -R @ F))


def radiances(seen: CandidateSurvey, pose: Rigid, photographer: Photographer) -> list[Picture]:
    """Return what falls on the sensors, without noise."""
    out = []
    for c in seen.candidates:
        assert c.optics is not None
        aperture = Aperture.of(c.optics)
        blur = blur_before(SENSOR, c.camera, aperture)
        cutout = photographer.radiance(
            c.camera,
            c.viewpoint.camera_from_world @ pose,
            light=LIGHT,
            aperture=aperture,
            blur_px=blur,
            samples=SAMPLES,
        )
        out.append(to_gray(cutout.over(BACKGROUND)))
    return out


def run(name: str, trials: int, places: int, seed: int) -> None:
    """Predict, try, print."""
    case = CASES[name]
    part = Part.of(case.mesh())
    seen = planned(case)
    predicted = seen.assess(range(len(seen.candidates))).sigma[0].reshape(-1, 3)
    asked = Tolerances(
        tuple(Feature(n, Selection(n), AXES[:1]) for n in case.judged), tuple(Selection(n) for n in case.datum)
    )
    rng, photographer = np.random.default_rng(seed), Photographer(part.scene)
    found: list[Inspection] = []
    for place in range(places):
        pose = Rigid.exp(rng.normal(0, 1, 6) * np.repeat([case.shift_mm, 1e-3], 3))
        clean = radiances(seen, pose, photographer)
        for _ in range(place, trials, places):
            pictures = [behind(SENSOR, c.camera).apply(r, rng=rng) for c, r in zip(seen.candidates, clean, strict=True)]
            photos = [Photo(p, off(c, rng)) for p, c in zip(pictures, seen.candidates, strict=True)]
            start = pose @ Rigid.exp(rng.normal(0, 1, 6) * np.repeat([case.shift_mm / 2, 1e-3], 3))
            told = inspect(part, photos, start, tolerances=asked)
            if not told.found:
                print(f"{name}: not found", file=sys.stderr)
                continue
            found.append(told)
    report(name, case, predicted, found)


def report(name: str, case: Case, predicted: Array, found: Sequence[Inspection]) -> None:
    """Print one layout's rows."""
    tau, noise = (float(np.median([getattr(f, n) for f in found])) for n in ("tau_px", "noise_scale"))
    print(f"\n**{name}: {len(found)} trials, datum {', '.join(case.datum)}; tau {tau:.4f} px, noise x {noise:.2f}**\n")
    stated = finder(case)
    print(f"gray {stated.gray:.4f}, contrast {stated.contrast:.3f}, common error {stated.floor_px or USUAL_PX:g} px\n")
    print("| feature | predicted mm | found mm | stated mm | found by predicted | measured | mean error mm |")
    print("|---|---|---|---|---|---|---|")
    ratios = []
    for n, sigma in zip(case.judged, predicted, strict=True):
        whole = [f for f in (i.feature(n) for i in found) if f.displacement is not None and f.seen.shape[1] == 3]
        if not whole:
            print(f"| {n} | {_each(sigma)} | | | | 0 | |")
            continue
        error = np.array([f.vector for f in whole])
        of = [np.diag(f.seen @ f.displacement.covariance @ f.seen.T) for f in whole if f.displacement is not None]
        rms, stated = np.sqrt(np.mean(error**2, axis=0)), np.sqrt(np.mean(of, axis=0))
        ratios.append(rms / sigma)
        cells = [
            _each(sigma),
            _each(rms),
            _each(stated),
            _each(rms / sigma, 2),
            str(len(whole)),
            _each(error.mean(axis=0)),
        ]
        print(f"| {n} | {' | '.join(cells)} |")
    print(f"\nall: {np.sqrt(np.mean(np.square(ratios))):.2f}")


def _each(values: Array, digits: int = 3) -> str:
    return " ".join(f"{v:.{digits}f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=24)
    parser.add_argument("--places", type=int, default=12, help="positions of the part among the trials")
    parser.add_argument("--only", default=",".join(CASES))
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    for name in arguments.only.split(","):
        run(name, arguments.trials, arguments.places, arguments.seed)


if __name__ == "__main__":
    main()
