"""Locating compared with other edge trackers: the same photos, the same rough starts, one run.

    python benchmarks/locate_peers.py ../shared/data/shipblock_clean
    python benchmarks/locate_peers.py SCENE --noise 0 8 --every 6 --reach 1.5

Peers, each as documented and with search ranges that were tuned on these photos (`RAPID_TUNED`, `VISP_TUNED`):

- cv2.rapid, from `pip install opencv-contrib-python-headless` (in place of opencv-python-headless). Its OLSTracker and
  GOSTracker tell the part by its hue; grey photos have none, and they stay where they started.
- ViSP's vpMbGenericTracker on edges, from `apt install libvisp-dev g++ pkg-config`: benchmarks/visp_edges.cpp.

A peer that is not there is named with how to get it. They get photos without the lens' distortion, made beforehand.
Columns as in benchmarks/locate.py: shares of starts that end below 2 and 5 px (largest reprojection error of a corner);
of those below 5 px the error of the centroid, its mean over photos (bias) and, with `FRESH` new pictures of noise on
each noise-free photo and the true pose as the start, its scatter over the intensity Cramer-Rao bound; CPU time of all
threads; and by how many times a peer's median and rms error and time are cadcam's.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time

import numpy as np
from rich.console import Console
from rich.progress import Progress

from cadcam.arrays import Array, Picture
from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.geometry.rigid import Rigid
from cadcam.locate.in_photos import locate_part
from cadcam.locate.photo import Photo
from edge_trackers import Ended, Gray8, Job, Rapid, Schedule, Tracker, Visp, visp_program
from locate import least_scatter
from locate_errors import NEAR_PX, Outcome, Summary, summary, vertex_error
from locate_sets import PhotoSet, Start
from render_peers import module

FRESH = 4  # noisy pictures of each photo, for scatter
RAPID_PLAIN: Schedule = [(40, 20)]  # one range that reaches the worst start
RAPID_TUNED: Schedule = [(40, 10), (20, 10), (10, 10), (6, 10), (4, 40), (3, 40), (2, 20)]
VISP_PLAIN = ("10000", "4", "0.4", "8x5")  # threshold, sample step, share of good edges, ranges: those of its tutorial
VISP_TUNED = ("20000", "4", "0.05", "40x1", "25x1", "15x1", "10x1", "7x1", "5x1", "4x1", *["3x1"] * 6, "2x1")


class Ours:
    """cadcam.locate_part, from the start to the pose with its covariance; a first pass draws what the part keeps."""

    def __init__(self, photos: PhotoSet) -> None:
        self._part, self._camera = photos.part, photos.camera

    def track(self, jobs: Sequence[Job]) -> Iterator[Ended]:
        """Yield the end of each job."""
        for job in jobs:
            photo = Photo.of(job.picture / np.float32(255), self._camera)
            locate_part(self._part, [photo], job.start)
            began = process_time()
            location = locate_part(self._part, [photo], job.start)
            yield Ended(location.pose.world_from_part, process_time() - began)


@dataclass(frozen=True)
class Entry:
    """A tracker in the table; straight: it knows no lens distortion."""

    name: str
    tracker: Tracker
    straight: bool = True


def entries(photos: PhotoSet, folder: Path) -> Iterator[Entry]:
    """Yield who is there, ours first; say on stderr how to get who is not. folder: for a compiled program."""
    mesh, edges, K = photos.part.scene.mesh, photos.part.scene.edges, photos.camera.K
    yield Entry("cadcam", Ours(photos), straight=False)
    if importlib.util.find_spec("cv2") is not None and hasattr(module("cv2"), "rapid"):
        version = f"OpenCV {module('cv2').__version__} rapid"
        yield Entry(f"{version}, one range", Rapid(mesh, edges, K, RAPID_PLAIN))
        yield Entry(f"{version}, tuned", Rapid(mesh, edges, K, RAPID_TUNED))
    else:
        print("OpenCV rapid is not installed: pip install opencv-contrib-python-headless", file=sys.stderr)
    if (there := visp_program(folder)) is not None:
        program, version = there
        yield Entry(f"ViSP {version}, as documented", Visp(mesh, edges, K, program, VISP_PLAIN))
        yield Entry(f"ViSP {version}, tuned", Visp(mesh, edges, K, program, VISP_TUNED))
    else:
        print("ViSP is not installed: apt install libvisp-dev g++ pkg-config", file=sys.stderr)


@dataclass(frozen=True)
class Pictures:
    """8-bit pictures of the frames of one noise level, as the camera saw them and without distortion."""

    seen: dict[int, Gray8]
    straight: dict[int, Gray8]

    @classmethod
    def of(cls, grays: dict[int, Picture], camera: Camera) -> Pictures:
        """Return both."""
        seen = {frame: to_bytes(gray) for frame, gray in grays.items()}
        if isinstance(camera.lens, Ideal):
            return cls(seen, seen)
        return cls(seen, {frame: to_bytes(undistorted(gray, camera)) for frame, gray in grays.items()})

    def jobs(self, entry: Entry, starts: Sequence[Start]) -> list[Job]:
        """Return what an entry has to do."""
        pictures = self.straight if entry.straight else self.seen
        return [Job(pictures[start.frame], start.pose) for start in starts]


def to_bytes(gray: Picture) -> Gray8:
    """Return the picture in 8 bits."""
    return np.ascontiguousarray(np.round(255 * np.clip(gray, 0, 1)), np.uint8)


def undistorted(gray: Picture, camera: Camera) -> Picture:
    """Return the picture that the camera would take without its lens' distortion."""
    from scipy.ndimage import map_coordinates

    q = camera.project(Camera(camera.size, camera.K).unproject(camera.pixel_grid()))
    return np.asarray(map_coordinates(gray, (q[..., 1], q[..., 0]), order=3, mode="nearest"), np.float32)


def farther(photos: PhotoSet, start: Start, reach: float) -> Start:
    """Return the start with so many times its distance from the truth."""
    truth = photos.truth[start.frame]
    return Start(start.row, start.frame, truth @ Rigid.exp(reach * (truth.inv @ start.pose).log()))


def outcomes(photos: PhotoSet, entry: Entry, pictures: Pictures, starts: Sequence[Start]) -> Iterator[Outcome]:
    """Yield how an entry's starts end; without covariance and quality, which the peers do not have."""
    for start, ended in zip(starts, entry.tracker.track(pictures.jobs(entry, starts)), strict=True):
        truth = photos.truth[start.frame]
        shift = ended.pose @ photos.centroid - truth @ photos.centroid
        px, xi = vertex_error(photos, ended.pose, truth), (ended.pose.inv @ truth).log()
        yield Outcome(start.row, start.frame, px, shift, xi, np.nan, np.nan, ended.cpu_s)


class Run:
    """The photos and starts of a scene, and a bar that counts what has ended."""

    def __init__(self, photos: PhotoSet, starts: Sequence[Start], bar: Progress) -> None:
        self.photos, self.starts, self._bar = photos, starts, bar
        self.frames = sorted({start.frame for start in starts})
        self._least = least_scatter(photos, self.frames)

    def summary(self, entry: Entry, noise: int) -> Summary:
        """Return how an entry does on the photos of a noise level."""
        pictures = Pictures.of({k: self.photos.gray(noise, k) for k in self.frames}, self.photos.camera)
        return summary(self._told(entry, noise, pictures, self.starts))

    def scatter(self, entry: Entry, noise: int) -> Array:
        """Return the scatter (3,) by noise over the bound, of what ends below `NEAR_PX`."""
        rng = np.random.default_rng(noise)
        starts = [Start(-1, k, self.photos.truth[k]) for k in self.frames]
        found = []
        for _ in range(FRESH):
            noisy = {k: self._noisy(k, noise / 255, rng) for k in self.frames}
            found += self._told(entry, noise, Pictures.of(noisy, self.photos.camera), starts)
        near = {k: [o.shift for o in found if o.frame == k and o.vertex_px < NEAR_PX] for k in self.frames}
        variances = [np.var(shifts, axis=0, ddof=1) for shifts in near.values() if len(shifts) > 1]
        return np.sqrt(np.mean(variances, axis=0)) / (noise * self._least) if variances else np.full(3, np.nan)

    def _noisy(self, frame: int, sigma: float, rng: np.random.Generator) -> Picture:
        gray = self.photos.gray(0, frame)
        return gray + np.float32(sigma) * rng.standard_normal(gray.shape, np.float32)

    def _told(self, entry: Entry, noise: int, pictures: Pictures, starts: Sequence[Start]) -> list[Outcome]:
        task = self._bar.add_task(f"noise {noise}: {entry.name}", total=len(starts))
        found = []
        for outcome in outcomes(self.photos, entry, pictures, starts):
            found.append(outcome)
            self._bar.advance(task)
        self._bar.remove_task(task)
        return found


def table(run: Run, noise: int, field: Sequence[Entry]) -> Iterator[str]:
    """Yield the rows of a noise level."""
    ours: Summary | None = None
    for entry in field:
        s = run.summary(entry, noise)
        ours = ours or s
        scatter = _row(run.scatter(entry, noise), 1) if noise else ""
        ratios = (s.median_mm / ours.median_mm, s.rms_mm / ours.rms_mm, s.cpu_ms / ours.cpu_ms)
        yield (
            f"| {noise} | {entry.name} | {s.close:.1%} | {s.near:.1%} | {s.median_mm:.3f} / {s.rms_mm:.3f}"
            f" | {_row(s.bias, 3)} | {scatter} | {s.cpu_ms:.0f} | {ratios[0]:.1f} / {ratios[1]:.1f} | {ratios[2]:.1f} |"
        )


def report(photos: PhotoSet, noises: Sequence[int], starts: Sequence[Start], only: str) -> Iterator[str]:
    """Yield the table of cadcam and the peers with this word in their names."""
    with Progress(console=Console(stderr=True), transient=True) as bar, tempfile.TemporaryDirectory() as folder:
        run = Run(photos, starts, bar)
        field = [entry for entry in entries(photos, Path(folder)) if only in entry.name or not entry.straight]
        yield f"{photos.name}: {len(run.frames)} photos, {len(starts)} starts\n"
        yield (
            "| noise | | < 2 px | < 5 px | centroid median / rms, mm | bias x, y, z, mm | scatter over the bound"
            " x, y, z | CPU, ms | error : ours, median / rms | CPU : ours |\n|---|---|---|---|---|---|---|---|---|---|"
        )
        for noise in noises:
            yield from table(run, noise, field)


def _row(values: Array, digits: int) -> str:
    return ", ".join(f"{v:.{digits}f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    parser.add_argument("--noise", type=int, nargs="+", default=[3], help="noise levels (default: 3)")
    parser.add_argument("--every", type=int, default=3, help="use every n-th start only (default %(default)s)")
    parser.add_argument("--reach", type=float, default=1.0, help="put starts so many times as far off")
    parser.add_argument("--only", default="", help="peers with this word in their names only")
    a = parser.parse_args()
    photos = PhotoSet(a.scene)
    starts = [farther(photos, start, a.reach) for start in photos.starts[:: a.every]]
    for line in report(photos, a.noise, starts, a.only):
        print(line, flush=True)


if __name__ == "__main__":
    main()
