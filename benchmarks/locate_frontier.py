"""What less scatter by noise costs in error: linear fits of a pose to all lines at once, on the ground of photos.

The fit of `cadcam locate` judges each line in a short cell of its own. Here is what a linear fit could do instead: in
each cell all parallel lines of the model step together, as the pose moves them, the levels between them are free,
and what lies between and beside them is a random process of the covariance seen beside the edges (locate_ground.py).
How firmly that ground is held to be level is a number, its `hold`: 1 takes the covariance as it was seen, 0.1 a tenth
of it. The firmer it is held, the less noise moves the pose, and the more the ground does. Surfaces that end at an edge
and what lies behind an edge have a hold each: the latter is darkest where the part stands before it.

    python benchmarks/locate_frontier.py ../shared/data/shipblock_clean

tells for each noise and pair of holds the scatter by fresh noise over the intensity bound, and the error of photos
without noise. Lines are drawn at the true poses and nothing is decided by the photo: no outliers, no weights. A second
table bounds the influence of whole pieces of line, the least that a fit needs which meets shadows.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.ndimage import map_coordinates
from scipy.spatial import cKDTree
from scipy.special import ndtr

import locate_bound
from cadcam.arrays import Array, Ids, Picture
from cadcam.camera.camera import Camera
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.edges import EdgeSamples, project, sample_lines
from cadcam.locate.part import Part
from cadcam.render import open_renderer
from cadcam.render.view import Channel
from locate_ground import CELL_PX, Ground, ground_of
from locate_sets import PhotoSet

HOLDS = {  # by noise, of surfaces that end at an edge and of what lies behind one: alike, and apart
    3: ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (0.03, 0.03), (0.1, 0.3), (0.03, 0.1), (0.01, 0.1), (0.01, 0.05)),
    8: ((1.0, 1.0), (0.3, 0.3), (0.1, 0.1), (0.03, 0.03), (0.3, 1.0), (0.1, 0.6), (0.03, 0.3), (0.01, 0.3)),
}
REACHES = (5, 8, 12)  # px that cells reach beyond their outermost lines
BOUNDED = {3: (0.01, 0.1), 8: (0.1, 0.6)}  # by noise, holds of the fits whose pieces of line have a bounded influence
BOUNDS = (0.2, 0.1, 0.05)  # px
PIECE, ROUNDS, SETTLED = 38, 60, 1e-4  # cells of a piece of line; of a bounded fit, how often and how far it goes
DRAWS = 32  # pictures of noise a photo
PARALLEL = 0.985  # cosine between normals of lines that step in one cell
CLEAR = 2.5  # px, more than two blurs: nearer to a line's foot no level is told
ALIKE = 5  # cells to either side whose contrasts are taken together
FORESEEN = 3 / 255  # noise at which contrasts are told
MARGIN = 3.0  # px, for cubic interpolation
FINER = 2  # pixels of the depth picture in one of the photo
NEAR_PX, FAR_PX = 1.5, 2.5  # from a line: where depth is read, to be continued up to it
JUMP = 0.002  # of the distance: depth by which a side is behind the edge


@dataclass(frozen=True)
class Cell:
    """A cell `CELL_PX` long: places d (m,) px along the normal at q, and the K lines that step in it.

    at (K,) px: where along the normal; rows (K, 6): how they move along it with the pose (locate_bound.motion).
    behind (2,): whether what is seen before the first line and after the last lies behind these edges.
    """

    q: Array
    normal: Array
    d: Array
    at: Array
    rows: Array
    run: int
    behind: tuple[bool, bool]


@dataclass(frozen=True)
class Optics:
    """What shapes a profile: the blur of a step, px, and the ground between the steps."""

    blur: float
    ground: Ground

    def levels(self, cell: Cell) -> Array:
        """Return columns (m, K + 1): a level, and a step at each line."""
        return np.column_stack([np.ones(len(cell.d)), ndtr((cell.d[:, None] - cell.at) / self.blur)])

    def moves(self, cell: Cell, heights: Array) -> Array:
        """Return columns (m, 6): how steps of these heights change the profile with the pose."""
        x = (cell.d[:, None] - cell.at) / self.blur
        bells = np.exp(-0.5 * x**2) / (np.sqrt(2 * np.pi) * self.blur)
        return np.asarray(-(bells * heights) @ cell.rows)

    def covariance(self, cell: Cell, noise: float, own: float, behind: float) -> Array:
        """Return (m, m): noise, and the ground of each stretch between lines, told apart by their blurred steps.

        own, behind: the holds of surfaces that end at the lines, and of what lies behind these.
        """
        holds = [own] * (len(cell.at) + 1)
        holds[0], holds[-1] = (behind if there else own for there in cell.behind)
        steps = ndtr((cell.d[:, None] - cell.at) / self.blur).T
        total = noise**2 / self.ground.length_px * np.eye(len(cell.d))
        for k in range(len(cell.at) + 1):
            share = (steps[k - 1] if k else 1.0) * (1 - steps[k] if k < len(cell.at) else 1.0)
            away = np.abs(np.rint(cell.d - cell.at[max(k - 1, 0)])).astype(int)
            away = np.minimum(away, len(self.ground.covariance) - 1)
            total += holds[k] * self.ground.covariance[np.ix_(away, away)] * np.outer(share, share)
        return total


@dataclass(frozen=True)
class Depth:
    """The depth of a part at a pose, in mm, infinite beside it, `FINER` times as fine as the photo."""

    z: Array

    @classmethod
    def of(cls, part: Part, camera: Camera, camera_from_part: Rigid) -> Depth:
        """Return it as the camera sees it."""
        fine = camera.resize((FINER * camera.width, FINER * camera.height))
        view = open_renderer(part.scene).render(fine, camera_from_part, channels=Channel.DEPTH)
        return cls(np.asarray(view.depth, np.float64))

    def behind(self, q: Array, out: Array) -> bool:
        """Return whether what lies on the side of a line at q (2,) px to which `out` points is behind the line."""
        beyond, here = self._at_line(q, out), self._at_line(q, -out)
        return bool(beyond > (1 + JUMP) * here)

    def _at_line(self, q: Array, out: Array) -> float:
        """Return the depth that a side has at the line itself; infinite where nothing of the part is there."""
        near, far = (self._read(q + px * out) for px in (NEAR_PX, FAR_PX))
        if not np.isfinite(near) or not np.isfinite(far):
            return float(near)
        slope = (1 / far - 1 / near) / (FAR_PX - NEAR_PX)  # along a plane 1 / z is linear in the picture
        return float(1 / (1 / near - NEAR_PX * slope))

    def _read(self, q: Array) -> float:
        column, row = np.clip(np.rint(FINER * (q + 0.5) - 0.5).astype(int), 0, np.array(self.z.shape[::-1]) - 1)
        return float(self.z[row, column])


class Drawing:
    """The visible lines of a part at a pose, in cells that reach so far beyond their outermost lines."""

    def __init__(self, part: Part, camera: Camera, camera_from_part: Rigid, reach_px: int) -> None:
        lines = part.lines.draw(camera, camera_from_part).visible
        centre = camera_from_part @ part.scene.mesh.vertices.mean(axis=0)
        self._pose, self._camera, self._centre, self._reach = camera_from_part, camera, centre, reach_px
        dense = sample_lines(lines, camera, step_px=1.0, reach_px=CLEAR)
        self._q, self._normal, self._rows, self._run = self._motion(dense)
        self._near, self._depth = cKDTree(self._q), Depth.of(part, camera, camera_from_part)
        own = self._motion(sample_lines(lines, camera, step_px=CELL_PX, reach_px=reach_px + CLEAR))
        found = (self._cell(*(values[i] for values in own)) for i in range(len(own[0])))
        self.cells = [cell for cell in found if cell is not None]

    def _motion(self, samples: EdgeSamples) -> tuple[Array, Array, Array, Ids]:
        at = project(samples, self._camera, self._pose)
        p = self._pose @ samples.p
        places = locate_bound.Samples(at.q, at.normal, p, samples.run, samples.chain)
        return at.q, at.normal, locate_bound.motion(self._camera, places, self._centre), samples.run

    def _cell(self, q: Array, normal: Array, row: Array, run: int) -> Cell | None:
        """Return the cell there; None where it is at a corner, other lines cross it or there is no room for levels."""
        at, rows, crossed = self._beside(q, normal, row, run)
        low = max((c for c in crossed if c < 0), default=-np.inf) + CLEAR
        high = min((c for c in crossed if c >= 0), default=np.inf) - CLEAR
        inside = (at > low + CLEAR) & (at < high - CLEAR)
        at, rows = at[inside], rows[inside]
        if not (at == 0).any() or (np.diff(at) < CLEAR).any():
            return None
        d = np.arange(max(np.ceil(low), np.floor(at[0]) - self._reach), min(high, np.ceil(at[-1]) + self._reach) + 1)
        ends = q + d[[0, -1], None] * normal
        if d[0] > at[0] - CLEAR or d[-1] < at[-1] + CLEAR:
            return None
        if (ends < MARGIN).any() or (ends > np.array(self._camera.size) - 1 - MARGIN).any():
            return None
        outer = zip(at[[0, -1]], (-1.0, 1.0), strict=True)
        before, after = (self._depth.behind(q + place * normal, sign * normal) for place, sign in outer)
        return Cell(q, normal, d, at, rows, run, (before, after))

    def _beside(self, q: Array, normal: Array, row: Array, run: int) -> tuple[Array, Array, list[float]]:
        """Return places and motions of the lines that run along through a cell, in order, and where others cross it."""
        k = np.array(self._near.query_ball_point(q, self._reach + 2 * CLEAR))
        away, along = (self._q[k] - q) @ normal, (self._q[k] - q) @ np.array([-normal[1], normal[0]])
        k, away, along = (values[np.abs(along) <= 0.5 * CELL_PX + 0.6] for values in (k, away, along))
        turn = self._normal[k] @ normal
        lines, crossed = [(0.0, row)], []
        for other in np.unique(self._run[k]):
            some = np.flatnonzero(self._run[k] == other)
            here = some[np.argmin(np.abs(along[some]))]
            whole = abs(turn[here]) > PARALLEL and np.ptp(along[some]) > 0.75 * CELL_PX
            if other == run and whole:
                continue
            if whole:
                lines.append((float(away[here]), self._rows[k[here]] * np.sign(turn[here])))
            else:
                crossed += away[some].tolist()
        lines.sort(key=lambda line: line[0])
        return np.array([d for d, _ in lines]), np.array([r for _, r in lines]), crossed

    def profiles(self, picture: Array) -> list[Array]:
        """Return the brightness of the cells at their places, means along the lines."""
        t = np.arange(CELL_PX) - (CELL_PX - 1) / 2
        q = np.concatenate([c.q + c.d[:, None] * c.normal for c in self.cells])
        normal = np.repeat([c.normal for c in self.cells], [len(c.d) for c in self.cells], axis=0)
        along = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
        at = q[:, None] + t[:, None] * along[:, None]
        values = map_coordinates(picture, (at[..., 1], at[..., 0]), order=3, mode="nearest").mean(axis=1)
        return np.split(values, np.cumsum([len(c.d) for c in self.cells])[:-1])


@dataclass(frozen=True)
class Fit:
    """A pose by generalised least squares, in the frame of locate_bound.motion, whole pieces of line bounded or not.

    Each of C cells has equations for the pose and for one shift of its lines across themselves: rows (m, 7) take a
    profile to their right sides; information (C, 7, 6) and own (C,): their left sides, of pose and of that shift.
    piece (C,): the piece of line that a cell belongs to.
    """

    rows: list[Array]
    information: Array
    own: Array
    piece: Ids

    @classmethod
    def of(
        cls, cells: Sequence[Cell], heights: Sequence[Array], optics: Optics, noise: float, holds: tuple[float, float]
    ) -> Fit:
        """Return the fit; a cell with K lines comes K times, so each counts 1 / K.

        holds: of surfaces that end at the lines, and of what lies behind these.
        """
        rows, information, own = [], [], []
        for cell, height in zip(cells, heights, strict=True):
            levels, moves = optics.levels(cell), optics.moves(cell, height)
            across = optics.moves(replace(cell, rows=np.ones((len(cell.at), 1))), height)
            asked = np.column_stack([levels, moves, across])
            solved = np.linalg.solve(optics.covariance(cell, noise, *holds), asked)
            k = levels.shape[1]
            free = solved[:, k:] - solved[:, :k] @ np.linalg.solve(levels.T @ solved[:, :k], levels.T @ solved[:, k:])
            rows.append(free / (k - 1))
            information.append(rows[-1].T @ moves)
            own.append(rows[-1][:, 6] @ across[:, 0])
        return cls(rows, np.array(information), np.array(own), _pieces(np.array([cell.run for cell in cells])))

    def right(self, profiles: Sequence[Array]) -> Array:
        """Return the right sides (C, 7) that profiles give."""
        return np.array([row.T @ y for row, y in zip(self.rows, profiles, strict=True)])

    def pose(self, right: Array, bound_px: float) -> Array:
        """Return the shift (3,) in mm and the turn (3,) in rad that solve the equations with these right sides.

        bound_px: shift of a piece from which its influence hardly grows (pseudo-Huber); infinite: least squares.
        """
        told = np.bincount(self.piece, self.own)
        weight, x = np.ones(len(told)), np.zeros(6)
        for _ in range(ROUNDS):
            each, before = weight[self.piece], x
            information = np.tensordot(each, self.information[:, :6], 1)
            x = np.asarray(np.linalg.solve(information, each @ right[:, :6]), np.float64)
            if np.isinf(bound_px) or np.linalg.norm(x - before) < SETTLED * np.linalg.norm(x):
                break
            off = np.bincount(self.piece, right[:, 6] - self.information[:, 6] @ x) / told
            weight = 0.5 * (weight + (1 + (off / bound_px) ** 2) ** -0.5)
        return x


def _pieces(run: Ids) -> Ids:
    """Return numbers (C,) of the pieces of line, of at most `PIECE` cells, that cells of runs (C,) belong to."""
    first = np.unique(run, return_index=True, return_inverse=True)
    place = np.arange(len(run)) - first[1][first[2]]
    return np.unique(np.stack([run, place // PIECE]), axis=1, return_inverse=True)[1].ravel().astype(np.int32)


def heights_of(cells: Sequence[Cell], profiles: Sequence[Array], optics: Optics) -> list[Array]:
    """Return the contrast of each line in each cell: medians over the cells beside it with as many lines."""
    own = []
    for cell, y in zip(cells, profiles, strict=True):
        levels = optics.levels(cell)
        solved = np.linalg.solve(optics.covariance(cell, FORESEEN, 1.0, 1.0), levels)
        own.append(np.linalg.solve(levels.T @ solved, solved.T @ y)[1:])
    kinds = [(cell.run, len(cell.at)) for cell in cells]
    beside = [range(max(i - ALIKE, 0), min(i + ALIKE + 1, len(own))) for i in range(len(own))]
    return [np.median([own[j] for j in beside[i] if kinds[j] == kinds[i]], axis=0) for i in range(len(own))]


@dataclass(frozen=True)
class Shot:
    """A photo without noise, its cells, what they show of it, and of pictures of noise of sd 1."""

    gray: Picture
    cells: list[Cell]
    profiles: list[Array]
    noises: list[list[Array]]


class Frontier:
    """All photos of a set, in cells of one reach."""

    def __init__(self, photos: PhotoSet, optics: Optics, reach_px: int, *, seed: int = 1) -> None:
        self._photos, self._optics = photos, optics
        rng = np.random.default_rng(seed)
        self._shots = {}
        for frame, truth in photos.truth.items():
            drawing, gray = Drawing(photos.part, photos.camera, truth, reach_px), photos.gray(0, frame)
            noises = [drawing.profiles(rng.normal(size=gray.shape)) for _ in range(DRAWS)]
            seen = drawing.profiles(np.asarray(gray, np.float64))
            self._shots[frame] = Shot(gray, drawing.cells, seen, noises)

    @cached_property
    def _heights(self) -> dict[int, list[Array]]:
        return {k: heights_of(shot.cells, shot.profiles, self._optics) for k, shot in self._shots.items()}

    @cached_property
    def _least(self) -> dict[int, Array]:
        """Return the intensity bound (3,) of each photo's centroid at a noise of 1, mm."""
        part, camera, truth = self._photos.part, self._photos.camera, self._photos.truth
        told = {k: locate_bound.information(shot.gray, part, camera, truth[k], 1.0) for k, shot in self._shots.items()}
        return {k: locate_bound.bound(information)[:3] for k, information in told.items()}

    def at(self, noise: float, holds: tuple[float, float], bound_px: float = np.inf) -> tuple[Array, Array]:
        """Return scatter over the bound (3,), rms over photos, and the errors (F, 3) mm of photos without noise.

        holds: of surfaces that end at edges, and of what lies behind edges; bound_px: as of `Fit.pose`.
        """
        ratios, errors = [], []
        for frame, shot in self._shots.items():
            fit = Fit.of(shot.cells, self._heights[frame], self._optics, noise, holds)
            right = fit.right(shot.profiles)
            errors.append(fit.pose(right, bound_px)[:3])
            noisy = [right + noise * fit.right(draw) for draw in shot.noises]
            by_noise = np.array([fit.pose(one, bound_px)[:3] for one in noisy]) - errors[-1]
            ratios.append((by_noise**2).mean(axis=0) / (noise * self._least[frame]) ** 2)
        return np.sqrt(np.mean(ratios, axis=0)), np.array(errors)


def report(photos: PhotoSet) -> Iterator[str]:
    """Yield a table by reach, noise and holds, then one by how the influence of pieces of line is bounded."""
    ground, blur = ground_of(photos, sorted(photos.truth))
    frontiers = {}
    columns = "scatter over the bound x, y, z | error without noise x, y, z: rms, mm | mean, mm | median, mm |\n|"
    yield f"| reach | noise | hold, own | behind | {columns}" + "---|" * 8
    for reach in REACHES:
        frontiers[reach] = Frontier(photos, Optics(blur, ground), reach)
        for noise in (n for n in photos.noises if n):
            for own, behind in HOLDS[_nearest(noise)]:
                yield f"| {reach} px | {noise} | {own:g} | {behind:g} | " + _told(frontiers[reach], noise, own, behind)
    yield f"\n| reach | noise | bounded at, px | {columns}" + "---|" * 7
    for noise in (n for n in photos.noises if n):
        for bound in BOUNDS:
            told = _told(frontiers[REACHES[0]], noise, *BOUNDED[_nearest(noise)], bound_px=bound)
            yield f"| {REACHES[0]} px | {noise} | {bound:g} | {told}"


def _nearest(noise: int) -> int:
    """Return that noise of those with holds that is nearest."""
    return min(HOLDS, key=lambda known: abs(known - noise))


def _told(frontier: Frontier, noise: int, own: float, behind: float, *, bound_px: float = np.inf) -> str:
    ratio, errors = frontier.at(noise / 255, (own, behind), bound_px)
    rms, mean = np.sqrt((errors**2).mean(axis=0)), errors.mean(axis=0)
    return f"{_row(ratio, 2)} | {_row(rms, 3)} | {_row(mean, 3)} | {np.median(np.linalg.norm(errors, axis=1)):.3f} |"


def _row(values: Array, digits: int) -> str:
    return ", ".join(f"{v:.{digits}f}" for v in values)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("scene", type=Path, help="folder of a scene with exact poses")
    for line in report(PhotoSet(parser.parse_args().scene)):
        print(line, flush=True)


if __name__ == "__main__":
    main()
