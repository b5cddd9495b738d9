"""Whether right poses are believed, and wrong ones not, in poor pictures: few pixels, noise, blur, a small part.

    python benchmarks/locate_poor.py ../shared/data --scene BRACKET --list

Takes photos of the ship block, of scenes by benchmarks/locate_scene.py, of the real cube and tea box, and renders of
sample parts before a mottled ground, near and far. Each is made smaller by averaging, blurred (px of the small
picture), given noise (grey levels of 255) and rounded to eight bits, in all combinations asked for. In every such
picture the part is located from good, rough and bad starts, and in the inputs of benchmarks/quality.py that cannot be
right: mirrored and turned photos, other and stretched CAD models, other cameras, pictures without the part. What is
right or wrong is told in px of the small picture; between the two limits nothing counts.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from cadcam.cad.parts import machined_bracket
from cadcam.cad.parts.shape import box, circle, prism
from cadcam.geometry.rigid import Rigid
from cadcam.locate.location import FOUND
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render import open_renderer
from locate_errors import auc
from locate_no_start import CAMERA, picture
from locate_sets import Case, PhotoSet, exact_cases, real_cases
from quality import LIMITS, REAL, Answer, answer, trials

REAL_WIDTH = 640  # px of the photos that the limits of the real sets are meant for
FAR = (1.0, 2.0)  # distances of rendered parts, in units of that at which their diagonal fills 0.6 of the shorter side
SETS = ("visp_mbt_cube", "visp_teabox")
LEFT_OUT = ("overexposed", "saturated", "empty", "blurred")  # inputs of benchmarks/quality.py that say nothing new here
TURNED = ("rendered_box", "rendered_plate")  # a half turn shows them again


@dataclass(frozen=True)
class Spoilt:
    """How a picture is spoilt: width (px), blur (px of the small picture), noise (grey levels)."""

    width: int
    blur: float
    noise: float

    def of(self, case: Case, rng: np.random.Generator) -> Case:
        """Return a case with its picture spoilt."""
        camera = case.photo.camera
        size = (self.width, round(camera.height * self.width / camera.width))
        if self.width < camera.width:
            small = Image.fromarray(case.photo.gray).resize(size, Image.Resampling.BOX)
            gray, camera = np.asarray(small, float), camera.resize(size)
        else:
            gray = np.asarray(case.photo.gray, float)
        noisy = gaussian_filter(gray, self.blur) + self.noise / 255 * rng.standard_normal(gray.shape)
        pixels = np.round(255 * np.clip(noisy, 0, 1)) / 255
        return replace(case, photo=Photo.of(pixels.astype(np.float32), camera, name=case.photo.viewpoint.name))


def rendered(n: int, rng: np.random.Generator) -> list[list[Case]]:
    """Return n cases of each sample part, drawn before a mottled ground, near and far by turns."""
    out = []
    bodies = {
        "bracket": machined_bracket(),
        "box": box((0, 0, 0), (100, 60, 40), name="box"),
        "plate": prism(circle((0, 0), 50, 6), 0, 18, name="plate"),
    }
    for name, mesh in bodies.items():
        part, cases = Part.of(mesh), []
        renderer, middle = open_renderer(part.scene), mesh.bounds.mean(axis=0)
        for k in range(n):
            z, azimuth = rng.uniform(0.25, 0.85), rng.uniform(0, 2 * np.pi)
            away = np.array([np.cos(azimuth) * np.sqrt(1 - z * z), np.sin(azimuth) * np.sqrt(1 - z * z), z])
            distance = FAR[k % 2] * float(np.linalg.norm(mesh.size_mm)) * CAMERA.fx / (0.6 * CAMERA.height)
            aside = Rigid(translation=np.append(rng.uniform(-0.1, 0.1, 2) * CAMERA.height / CAMERA.fx * distance, 0.0))
            pose = aside @ Rigid.look_at(middle + distance * away, middle)
            photo = Photo.of(picture(renderer, pose, 0.0, rng), CAMERA, name=f"{name} {k}")
            cases.append(Case(f"rendered_{name}", part, photo, pose))
        out.append(cases)
    return out


def verdict(a: Answer, width: int) -> bool | None:
    """Return whether a pose is right; None between the limits."""
    real = a.set_name in REAL
    scale = width / REAL_WIDTH if real else 1.0
    right, wrong = (max(px * scale, exact) for px, exact in zip(LIMITS[real], LIMITS[False], strict=True))
    return True if a.error_px < right else False if a.error_px > wrong else None


def answers(sets: Sequence[Sequence[Case]], spoilt: Spoilt) -> Iterator[tuple[Answer, bool]]:
    """Yield what came of each input, and whether it is right."""
    rng = np.random.default_rng(5)
    poor = [[spoilt.of(case, rng) for case in cases] for cases in sets]
    for cases in poor:
        size = cases[0].part.scene.mesh.size_mm
        others = [c for more in poor for c in more if not np.allclose(c.part.scene.mesh.size_mm, size, rtol=1e-2)]
        for case in cases:
            for trial in trials(case, others, rng):
                if trial.kind in LEFT_OUT or (trial.kind == "upside down" and case.name in TURNED):
                    continue
                a = answer(case, trial)
                right = verdict(a, spoilt.width)
                if right is not None:
                    yield replace(a, kind=f"{trial.kind} [{case.photo.viewpoint.name}]"), right


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", type=Path, help="folder of the photo sets")
    parser.add_argument("--scene", type=Path, action="append", default=[], help="further scenes with exact poses")
    parser.add_argument("--photos", type=int, default=4, help="photos of each set (default %(default)s)")
    parser.add_argument("--widths", type=int, nargs="+", default=[320, 640], help="px (default %(default)s)")
    parser.add_argument("--blurs", type=float, nargs="+", default=[0.7, 1.5], help="px (default %(default)s)")
    parser.add_argument("--noises", type=float, nargs="+", default=[3, 8, 12], help="grey levels (default %(default)s)")
    parser.add_argument("--list", action="store_true", help="list wrong poses that pass and right ones that fail")
    a = parser.parse_args()
    sets = []
    for folder in (a.data / "shipblock_clean", *a.scene):
        photos = PhotoSet(folder)
        photos.noises = [0]
        sets.append(exact_cases(photos, a.photos))
    real = real_cases(a.data, a.photos)
    sets += [[replace(c, photo=replace(c.photo, chroma=None)) for c in real if c.name == name] for name in SETS]
    sets += rendered(a.photos, np.random.default_rng(11))
    print("| width | blur | noise | right | refused | their quality, median | wrong | pass | AUC | CPU mean, ms |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    every: list[tuple[Spoilt, Answer, bool]] = []
    for width in a.widths:
        for blur in a.blurs:
            for noise in a.noises:
                spoilt, began = Spoilt(width, blur, noise), time.process_time()
                some = list(answers(sets, spoilt))
                each = 1000 * (time.process_time() - began) / max(len(some), 1)
                print(row(f"{width} | {blur:g} | {noise:g}", [(b, r) for b, r in some], each), flush=True)
                every += [(spoilt, b, r) for b, r in some]
    print(row("all | | ", [(b, r) for _, b, r in every], 0.0))
    for name in dict.fromkeys(b.set_name.split()[0] for _, b, _ in every):
        print(row(f"{name} | | ", [(b, r) for _, b, r in every if b.set_name.split()[0] == name], 0.0))
    if a.list:
        for s, b, right in every:
            if right != (b.quality >= FOUND):
                what, why = "REFUSED" if right else "PASSED", b.refused or b.reason
                print(f"{what} {s} {b.set_name}: {b.kind}, {b.error_px:.1f} px, quality {b.quality:.2f}, {why}")


def row(head: str, some: Sequence[tuple[Answer, bool]], each_ms: float) -> str:
    right, wrong = ([b.quality for b, r in some if r == which] for which in (True, False))
    return (
        f"| {head} | {len(right)} | {np.mean(np.array(right) < FOUND):.0%} | {np.median(right):.2f}"
        f" | {len(wrong)} | {sum(q >= FOUND for q in wrong)} | {auc(right, wrong):.3f} | {each_ms:.0f} |"
    )


if __name__ == "__main__":
    main()
