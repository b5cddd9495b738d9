"""Edge trackers of others, each taken from a rough pose onto one photo, for benchmarks/locate_peers.py.

They get the photo without lens distortion and K with pixel centres at whole numbers, which is the convention of both;
lengths in metres, as their examples have it. What they prepare once for a part is not timed.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import process_time
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from cadcam.arrays import Array, Ids
from cadcam.cad.edges import FeatureEdges
from cadcam.cad.mesh import Mesh
from cadcam.geometry import rotation
from cadcam.geometry.rigid import Rigid
from render_peers import module

SPACING_MM = 10.0  # of points on edges: rapid joins the corners that it sees on a silhouette by straight lines
LINES = 400  # search lines of rapid
FLAT = 1e-6  # of the part's size
PROGRAM = Path(__file__).with_name("visp_edges.cpp")
LIBRARIES = ("-lvisp_mbt", "-lvisp_io", "-lvisp_me", "-lvisp_vision", "-lvisp_core")

Gray8 = npt.NDArray[np.uint8]
Schedule = Sequence[tuple[int, int]]  # search range in px, rounds


@dataclass(frozen=True)
class Job:
    """An 8-bit picture and a rough pose camera_from_part."""

    picture: Gray8
    start: Rigid


@dataclass(frozen=True)
class Ended:
    """Where a tracker ended, and the CPU time of all its threads."""

    pose: Rigid
    cpu_s: float


class Tracker(Protocol):
    """What a tracker must do here."""

    def track(self, jobs: Sequence[Job]) -> Iterator[Ended]:
        """Yield the end of each job, in order."""
        ...


class Rapid:
    """cv2.rapid.rapid, round by round: the strongest step on lines across the silhouette, then a pose of those points.

    Its silhouette runs straight from corner to corner, in the picture and on the part alike, which perspective forbids
    for long edges: so the edges get points in between.
    """

    def __init__(self, mesh: Mesh, edges: FeatureEdges, K: Array, schedule: Schedule) -> None:
        self._cv2 = cv2 = module("cv2")
        cv2.setNumThreads(1)
        self._points = np.asarray(with_points_between(mesh, edges) / 1000, np.float32)
        self._faces, self._K, self._schedule = np.array(mesh.faces, np.int32), np.array(K), schedule

    def track(self, jobs: Sequence[Job]) -> Iterator[Ended]:
        """Yield the end of each job; one that meets no step ends where it was."""
        for job in jobs:
            began = process_time()
            pose = self._tracked(job)
            yield Ended(pose, process_time() - began)

    def _tracked(self, job: Job) -> Rigid:
        cv2, pose = self._cv2, job.start
        turn, shift = cv2.Rodrigues(np.array(pose.rotation))[0], np.array(pose.translation[:, None]) / 1000
        for range_px, rounds in self._schedule:
            for _ in range(rounds):
                try:
                    _, turn, shift, _ = cv2.rapid.rapid(
                        job.picture, LINES, range_px, self._points, self._faces, self._K, turn, shift
                    )
                except cv2.error:  # no silhouette in the picture
                    return pose
                if not (np.isfinite(turn).all() and np.isfinite(shift).all()):
                    return pose
                pose = Rigid(rotation.nearest(cv2.Rodrigues(turn)[0]), 1000 * shift.ravel())
        return pose


def with_points_between(mesh: Mesh, edges: FeatureEdges) -> Array:
    """Return the corners (V, 3) in mm and, after them, points along the feature edges, `SPACING_MM` apart at most."""
    ends = mesh.vertices[edges.vertices]
    counts = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) // SPACING_MM
    between = [a + (b - a) * t for (a, b), n in zip(ends, counts, strict=True) for t in np.arange(1, n + 1) / (n + 1)]
    return np.concatenate([mesh.vertices, np.reshape(between, (-1, 3))])


class Visp:
    """ViSP's vpMbGenericTracker on edges, by benchmarks/visp_edges.cpp, which is compiled here."""

    def __init__(self, mesh: Mesh, edges: FeatureEdges, K: Array, program: Path, options: Sequence[str]) -> None:
        self._model, self._K, self._program, self._options = cao(mesh, edges), K, program, options

    def track(self, jobs: Sequence[Job]) -> Iterator[Ended]:
        """Yield the end of each job; one that ViSP calls lost ends at its last pose."""
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            (folder / "model.cao").write_text(self._model)
            (folder / "jobs").write_text(self._jobs(folder, jobs))
            command = [str(self._program), str(folder / "model.cao"), *self._options]
            with (
                (folder / "jobs").open() as lines,
                subprocess.Popen(
                    command, stdin=lines, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
                ) as run,
            ):
                yield from (_ended(line) for line in run.stdout or ())
            if run.returncode:
                raise RuntimeError(f"{' '.join(command)} ended with {run.returncode}")

    def _jobs(self, folder: Path, jobs: Sequence[Job]) -> str:
        rows = [" ".join(f"{x:.12g}" for x in self._K[[0, 1, 0, 1], [0, 1, 2, 2]])]  # fx, fy, u0, v0
        paths: dict[int, Path] = {}
        for job in jobs:
            if id(job.picture) not in paths:
                paths[id(job.picture)] = path = folder / f"{len(paths):04d}.pgm"
                height, width = job.picture.shape
                path.write_bytes(f"P5\n{width} {height}\n255\n".encode() + job.picture.tobytes())
            numbers = [*job.start.rotation.ravel(), *job.start.translation / 1000]
            rows.append(" ".join([str(paths[id(job.picture)]), *(f"{x:.12g}" for x in numbers)]))
        return "\n".join(rows) + "\n"


def _ended(line: str) -> Ended:
    values = np.array([float(word) for word in line.split()])
    return Ended(Rigid(rotation.nearest(values[:9].reshape(3, 3)), 1000 * values[9:12]), float(values[12]))


def visp_program(folder: Path) -> tuple[Path, str] | None:
    """Return the compiled program and ViSP's version; None where a compiler or ViSP's headers are missing."""
    if not (shutil.which("g++") and shutil.which("pkg-config")):
        return None
    asked = [subprocess.run(["pkg-config", what, "visp"], **_QUIET) for what in ("--cflags", "--modversion")]
    if any(answer.returncode for answer in asked):
        return None
    program = folder / "visp_edges"
    flags, version = (answer.stdout.split() for answer in asked)
    subprocess.run(["g++", "-O2", "-w", "-o", str(program), str(PROGRAM), *flags, *LIBRARIES], check=True)
    return program, version[0]


_QUIET: dict[str, Any] = {"capture_output": True, "text": True}


def cao(mesh: Mesh, edges: FeatureEdges) -> str:
    """Return ViSP's model (m): flat faces with one border as polygons, whose sides it tracks where they are seen.

    Other faces (curved, or with holes) come as triangles of the name "surface", which only hide, with their feature
    edges as lines.
    """
    polygons, triangles, lines = [], [], []
    face = smooth_faces(mesh, edges)
    for k in range(face.max(initial=-1) + 1):
        of = mesh.faces[face == k]
        border = _border(of)
        if border is not None and _flat(mesh, of):
            polygons.append(border)
        else:
            triangles += of.tolist()
            lines += edges.vertices[(face[edges.faces] == k).any(axis=1)].tolist()
    corners = [" ".join(f"{x:.9g}" for x in p / 1000) for p in mesh.vertices]
    unique = sorted({tuple(sorted(line)) for line in lines})
    surfaces = [" ".join(map(str, (len(p), *p))) for p in polygons]
    surfaces += [" ".join(map(str, (3, *t))) + " name=surface" for t in triangles]
    rows = ["V1", len(corners), *corners, len(unique), *(f"{a} {b}" for a, b in unique), 0, len(surfaces), *surfaces]
    return "\n".join(map(str, [*rows, 0, 0])) + "\n"


def smooth_faces(mesh: Mesh, edges: FeatureEdges) -> Ids:
    """Return for each triangle (F,) the face that it belongs to: triangles joined across all but feature edges."""
    side = np.sort(mesh.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    feature = {tuple(pair) for pair in np.sort(edges.vertices, axis=1).tolist()}
    _, number = np.unique(side, axis=0, return_inverse=True)
    owner, order = np.repeat(np.arange(mesh.n_faces), 3), np.argsort(number.ravel(), kind="stable")
    sharp = np.array([tuple(pair) in feature for pair in side.tolist()])
    a, b = order[:-1], order[1:]
    same = (number.ravel()[a] == number.ravel()[b]) & ~sharp[a]
    joined = coo_array((np.ones(same.sum()), (owner[a[same]], owner[b[same]])), shape=(mesh.n_faces, mesh.n_faces))
    return np.asarray(connected_components(joined, directed=False)[1], np.int32)


def _border(triangles: Ids) -> list[int] | None:
    """Return the corners around triangles, counter-clockwise from outside; None if there is not just one border."""
    sides = {(int(t[k]), int(t[(k + 1) % 3])) for t in triangles for k in range(3)}
    after = dict(side for side in sides if side[::-1] not in sides)
    count = sum(side[::-1] not in sides for side in sides)
    if not after or len(after) != count:
        return None
    loop = [next(iter(after))]
    while (following := after[loop[-1]]) != loop[0] and len(loop) <= count:
        loop.append(following)
    return loop if len(loop) == count else None


def _flat(mesh: Mesh, triangles: Ids) -> bool:
    p = mesh.vertices[np.unique(triangles)]
    return bool(np.linalg.svd(p - p.mean(axis=0), compute_uv=False)[2] <= FLAT * np.linalg.norm(mesh.size_mm))
