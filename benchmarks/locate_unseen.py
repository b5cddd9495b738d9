"""Scenes that nobody has looked at, and what users do with photos of them: right, found, and how sure.

    python benchmarks/locate_unseen.py SCENE [SCENE ...] --every 3 --list

Takes scenes by benchmarks/locate_scene.py. Rough starts at each noise level; then, at noise 3, the same photos in
colour, turned to portrait, enlarged to 12 Mpx, cut so that the principal point lies far off, and reduced until the
part is 90 px large; without a start, over a declared range and over all views; and what is wrong: the photo mirrored,
without the part (that of another scene), the start turned over, the model 3 to 6 % longer along one axis, another
scene's model. Prints by input how many are right (every corner within 2 px), how many of these are found, wrong ones
called found (beyond 5 px), errors and normalised errors.

A photo without the part is that of another scene; so give several. A stretched model counts only where no pose brings
the corners within 3 px of where the photo has them, as in benchmarks/quality.py.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import BrownConrady
from cadcam.errors import CadcamError
from cadcam.geometry.rigid import Rigid
from cadcam.geometry.rotation import exp
from cadcam.locate.in_photos import locate_part
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange
from locate_errors import CLOSE_PX, NEAR_PX, squared
from locate_sets import Case, PhotoSet
from quality import explained, fitted, its_own_mirror_image, middle_on_middle, sized, stretched_part

NOISE = 3
TINT = (1.0, 0.86, 0.7)  # of light from a lamp
LARGE, SMALL = 4, 90.0  # times as many px a side; px of a part that is nearly too small
AROUND_PX = 60  # of the picture that is left around the part
QUARTER = exp(np.array([0, 0, np.pi / 2]))


@dataclass(frozen=True)
class Asked:
    """A part in a photo, a start or none, and what is right (None: nothing is)."""

    kind: str
    part: Part
    photo: Photo
    start: Rigid | None
    truth: Rigid | None
    views: ViewRange = WHOLE_SPHERE


@dataclass(frozen=True)
class Answer:
    """What came of it: px of the farthest corner, mm of their middle, xi' C^-1 xi."""

    scene: str
    kind: str
    px: float
    mm: float
    squared: float
    quality: float
    found: bool
    cpu_s: float
    words: str


def answer(scene: str, asked: Asked) -> Answer:
    """Return what locating makes of an input; a refusal in words is an answer that found nothing."""
    began = time.process_time()
    try:
        location = locate_part(asked.part, [asked.photo], asked.start, views=asked.views)
    except CadcamError as error:
        words = f"{type(error).__name__}: {error}"
        return Answer(scene, asked.kind, np.inf, np.nan, np.nan, 0.0, False, time.process_time() - began, words)
    cpu_s, pose = time.process_time() - began, location.pose.world_from_part
    said = location.quality, location.found, cpu_s, location.reason
    if asked.truth is None:
        return Answer(scene, asked.kind, np.inf, np.nan, np.nan, *said)
    corners, truth = asked.part.scene.mesh.vertices, asked.truth
    shown = asked.photo.camera.project(truth @ corners)
    seen = np.isfinite(shown).all(axis=1)

    def off(found: Rigid) -> float:
        d = np.linalg.norm(asked.photo.camera.project(found @ corners)[seen] - shown[seen], axis=1)
        return float(d.max()) if np.isfinite(d).all() else np.inf

    px, k = min((off(pose @ same), k) for k, same in enumerate(asked.part.symmetries))
    pose, middle = pose @ asked.part.symmetries[k], corners.mean(axis=0)
    mm = float(np.linalg.norm(pose @ middle - truth @ middle))
    xi = (location.pose.world_from_part.inv @ truth @ asked.part.symmetries[k].inv).log()
    return Answer(scene, asked.kind, px, mm, squared(xi, location.pose.covariance), *said)


def rough(photos: PhotoSet, every: int) -> Iterator[Asked]:
    """Yield rough starts at each noise level."""
    for noise in photos.noises:
        for start in photos.starts[::every]:
            photo = photos.photo(noise, start.frame)
            yield Asked(f"noise {noise}", photos.part, photo, start.pose, photos.truth[start.frame])


def taken_otherwise(photos: PhotoSet, every: int) -> Iterator[Asked]:
    """Yield the photos in colour, turned, enlarged, cut and reduced."""
    for start in photos.starts[::every]:
        gray, camera, truth = photos.gray(NOISE, start.frame), photos.camera, photos.truth[start.frame]
        q = camera.project(truth @ photos.vertices)
        times = round(float(np.ptp(q, axis=0).max()) / SMALL)
        near = truth @ Rigid.exp((truth.inv @ start.pose).log() / 3)  # 40 px would lead out of a small part
        tinted = np.round(255 * gray[..., None] * TINT).astype(np.uint8)
        yield Asked("colour", photos.part, Photo.of(tinted, camera), start.pose, truth)
        turned, turn = Photo.of(np.rot90(gray, -1), _turned(camera)), Rigid(QUARTER)
        yield Asked("portrait", photos.part, turned, turn @ start.pose, turn @ truth)
        yield Asked("12 Mpx", photos.part, _enlarged(gray, camera), start.pose, truth)
        yield Asked("cut", photos.part, _cut(gray, camera, q), start.pose, truth)
        yield Asked("90 px", photos.part, Photo.of(gray, camera).reduced(times), near, truth)


def _enlarged(gray: Picture, camera: Camera) -> Photo:
    from scipy.ndimage import zoom

    large = np.clip(zoom(gray, LARGE, order=3, grid_mode=True, mode="nearest"), 0, 1)
    return Photo.of(large, camera.resize((LARGE * camera.width, LARGE * camera.height)))


def _cut(gray: Picture, camera: Camera, q: Array) -> Photo:
    """Return the part of a photo that shows the corners q (n, 2) px."""
    x, y = np.maximum(np.floor(q.min(axis=0)) - AROUND_PX, 0).astype(int)
    right, lower = np.minimum(np.ceil(q.max(axis=0)) + AROUND_PX + 1, camera.size).astype(int)
    return Photo.of(gray[y:lower, x:right], camera.crop(int(x), int(y), (int(right - x), int(lower - y))))


def searched(photos: PhotoSet) -> Iterator[Asked]:
    """Yield photos at noise 3 without a start, over a declared range and over all views."""
    part = photos.part
    middle = part.scene.mesh.bounds.mean(axis=0)
    away = [float((truth @ middle)[2]) for truth in photos.truth.values()]
    declared = ViewRange.above(within_deg=75.0, distance_mm=(0.8 * min(away), 1.25 * max(away)))
    for frame, truth in photos.truth.items():
        photo = photos.photo(NOISE, frame)
        yield Asked("no start, range", part, photo, None, truth, declared)
        yield Asked("no start", part, photo, None, truth)


def wrong(photos: PhotoSet, others: Sequence[PhotoSet], rng: np.random.Generator) -> Iterator[Asked]:
    """Yield what has no right answer, or whose start is far beyond what starts may be off."""
    part, mesh = photos.part, photos.part.scene.mesh
    middle = mesh.bounds.mean(axis=0)
    about = Rigid(translation=middle)
    for frame, truth in photos.truth.items():
        photo = photos.photo(NOISE, frame)
        case = Case(photos.name, part, photo, truth)
        if not its_own_mirror_image(mesh):
            mirrored = Photo(photo.gray[:, ::-1].copy(), photo.viewpoint)
            yield Asked("mirrored", part, mirrored, truth, None)
            yield Asked("mirrored, no start", part, mirrored, None, None)
        for axis in np.eye(3):
            start = truth @ about @ Rigid(exp(np.pi * axis)) @ about.inv
            yield Asked("start turned over", part, photo, start, truth)
        for axis in np.eye(3):
            share = rng.choice([-1, 1]) * rng.uniform(0.03, 0.06)
            other = stretched_part(part, (1 + share * axis).tolist())
            if not explained(case, other, photos.camera):
                yield Asked("model 3 to 6 % longer or shorter", other, photo, truth, None)
        for other_set in others[:2]:
            yield Asked(
                "other model", sized(other_set.part, part), photo, middle_on_middle(other_set.part, part, truth), None
            )
            strange = other_set.photo(NOISE, min(other_set.truth))
            absent = Photo(fitted(strange, photos.camera).astype(np.float32), photo.viewpoint)
            yield Asked("absent", part, absent, truth, None)
            yield Asked("absent, no start", part, absent, None, None)


def _turned(camera: Camera) -> Camera:
    """Return the camera of a picture turned by a quarter, clockwise: x to the lower end, y to the left."""
    K, lens = camera.K, camera.lens
    assert isinstance(lens, BrownConrady)
    return Camera.from_focal(
        (camera.height, camera.width),
        float(K[1, 1]),
        fy=float(K[0, 0]),
        cx=camera.height - 1 - float(K[1, 2]),
        cy=float(K[0, 2]),
        lens=replace(lens, p1=lens.p2, p2=-lens.p1),
    )


def table(answers: Sequence[Answer]) -> Iterator[str]:
    """Yield a line for each kind of input, of all scenes or of one."""
    yield (
        "| input | asked | < 2 px | of them found | wrong, called found | mm, median | normalised"
        " | quality right, least | CPU median, s |\n|---|---|---|---|---|---|---|---|---|"
    )
    for kind in dict.fromkeys(a.kind for a in answers):
        own = [a for a in answers if a.kind == kind]
        right = [a for a in own if a.px < CLOSE_PX]
        near = [a for a in own if a.px < NEAR_PX]
        norm = f"{np.sqrt(np.mean([a.squared for a in near]) / 6):.2f}" if near else ""
        mm = f"{np.median([a.mm for a in right]):.3f}" if right else ""
        least = f"{min(a.quality for a in right):.2f}" if right else ""
        yield (
            f"| {kind} | {len(own)} | {len(right)} | {sum(a.found for a in right)}"
            f" | {sum(a.found and a.px > NEAR_PX for a in own)} | {mm} | {norm} | {least}"
            f" | {np.median([a.cpu_s for a in own]):.2f} |"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, nargs="+", help="folders by benchmarks/locate_scene.py")
    parser.add_argument("--every", type=int, default=3, help="use every n-th start only (default %(default)s)")
    parser.add_argument("--only", nargs="+", choices=("rough", "otherwise", "searched", "wrong"), help="these alone")
    parser.add_argument("--list", action="store_true", help="tell all that is not right and found, in words")
    a = parser.parse_args()
    sets, answers = [PhotoSet(folder) for folder in a.scene], []
    for photos in sets:
        others = [other for other in sets if other is not photos]
        kinds = {
            "rough": rough(photos, a.every),
            "otherwise": taken_otherwise(photos, 2 * a.every),
            "searched": searched(photos),
            "wrong": wrong(photos, others, np.random.default_rng(1)),
        }
        own = []
        for name in a.only or kinds:
            for asked in kinds[name]:
                own.append(said := answer(photos.name, asked))
                if a.list and (said.found if asked.truth is None else said.px > CLOSE_PX or not said.found):
                    print(
                        f"{photos.name}, {said.kind}: {said.px:.1f} px, quality {said.quality:.2f},"
                        f" {said.cpu_s:.2f} s: {said.words}",
                        flush=True,
                    )
        print(f"\n{photos.name}\n")
        print("\n".join(table(own)), flush=True)
        answers += own
    if len(sets) > 1:
        print("\nall\n")
        print("\n".join(table(answers)))


if __name__ == "__main__":
    main()
