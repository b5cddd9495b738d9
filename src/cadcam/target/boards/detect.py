"""A board in a picture: several detectors are tried, and the result with the most points and the best fit is kept."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Picture, frozen
from cadcam.errors import NoBoard
from cadcam.image.picture import to_gray
from cadcam.target.boards import opencv
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.charuco import charuco_grid
from cadcam.target.boards.chess import corner_grid, fitted_corners
from cadcam.target.boards.circles import disc_grid, fitted_discs, radius_by_cell
from cadcam.target.boards.grid import Grid
from cadcam.target.boards.lattice import PlacedLattice, placed
from cadcam.target.boards.pattern import Charuco, Chessboard, CircleGrid
from cadcam.target.boards.pyramid import scales

_SMOOTHINGS = (1.5, 1.0, 2.5, 4.0)  # px of the reduced picture
_WINDOWS = (0.08, 0.03, 0.2)  # of the reduced picture's longer side
_LEAST_SHARE = 0.4  # of the board's points that a view must show
_LEAST = 6
_SMALLEST = 16  # px of the picture's shorter side: less leaves no room for a board
_CLEAR, _AGREE = 12, 3  # points and tries: after so many tries with the same grid of so many points, no other is sought
_STRAY = 0.5  # of a row: so many marks beyond the board's outline make it another board


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Detection(Brief):
    """The points of a board in a picture: their numbers (N,), pixels q (N, 2), covariance (N, 2, 2) px^2 each.

    For discs, q is the centre of the disc's image, and `radius_mm` the radius estimated from the picture; else None.
    covariance: from the residuals of the grey values. detector: the one that found the board; tried: every detector
    tried, with its result.
    """

    pattern: Pattern
    points: npt.NDArray[np.intp]
    q: Array
    covariance: Array
    detector: str
    tried: tuple[str, ...]
    radius_mm: float | None = None

    def __post_init__(self) -> None:
        n = len(self.points)
        object.__setattr__(self, "points", frozen(self.points, "points", (n,), np.intp))
        object.__setattr__(self, "q", frozen(self.q, "q", (n, 2)))
        object.__setattr__(self, "covariance", frozen(self.covariance, "covariance", (n, 2, 2)))

    @property
    def p_board(self) -> Array:
        """Return the points (N, 3) in the board's frame, mm."""
        return self.pattern.points[self.points]

    @property
    def names(self) -> tuple[str, ...]:
        """Return each point's name, "column,row" on the board's grid."""
        return tuple(f"{x},{y}" for x, y in self.pattern.cells[self.points].tolist())

    @property
    def sigma_px(self) -> float:
        """Return the typical noise of one pixel coordinate that the fits predict: the median over the points."""
        return float(np.median(np.sqrt(np.einsum("nii->n", self.covariance) / 2)))

    def __len__(self) -> int:
        return len(self.points)


def detect(picture: npt.ArrayLike, pattern: Pattern) -> Detection:
    """Return the board in a picture (H, W) or (H, W, 3). Raises `NoBoard`, which says what was seen instead.

    A partly visible board is accepted if the visible part fits at one place only (apart from rotations that look the
    same) and is at least two fifths of it. Raises `MissingExtra` for a ChArUco board without OpenCV.
    """
    gray = to_gray(picture)
    if min(gray.shape) < _SMALLEST:
        raise NoBoard(str(pattern), f"the picture is {gray.shape[1]} x {gray.shape[0]} px")
    if isinstance(pattern, Charuco):
        return _charuco(gray, pattern)
    tried: list[str] = []
    same: list[tuple[int, int, int]] = []
    best: tuple[Grid, PlacedLattice, str] | None = None
    for name, grid in _grids(gray, pattern):
        if grid is None:
            tried.append(f"{name}: nothing")
            continue
        found = placed(grid.cells, grid.fit.q, grid.color, pattern)
        tried.append(f"{name}: {len(found.points)} of {len(pattern.cells)} points")
        if best is None or _rank(grid, found) > _rank(*best[:2]):
            best = grid, found, name
        same.append((len(grid), *found.extent))
        if len(found.points) == len(pattern.cells) or (len(grid) >= _CLEAR and same.count(same[-1]) == _AGREE):
            break
    if best is None:
        raise NoBoard(str(pattern), "nothing in the picture looks like one")
    grid, found, name = best
    _refuse(found, pattern)
    return _detection(grid, found.marks, found.points, pattern, name, tuple(tried))


def _grids(gray: Picture, pattern: Pattern) -> Iterator[tuple[str, Grid | None]]:
    if isinstance(pattern, Chessboard):
        yield from _corner_grids(gray, pattern)
    elif isinstance(pattern, CircleGrid):
        yield from _disc_grids(gray, pattern)


def _corner_grids(gray: Picture, board: Chessboard) -> Iterator[tuple[str, Grid | None]]:
    enough = board.columns * board.rows
    levels = scales(gray.shape)
    for smoothing in _SMOOTHINGS:
        for scale in levels if smoothing == _SMOOTHINGS[0] else levels[:2]:
            name = f"saddle points at scale {scale:.2g}, smoothing {smoothing:g}"
            yield name, corner_grid(gray, smoothing=smoothing, enough=enough, scale=scale)
    if opencv.has_opencv():
        for name, q in opencv.chessboard_candidates(gray, board.columns, board.rows):
            yield name, fitted_corners(gray, board.cells, q)


def _disc_grids(gray: Picture, board: CircleGrid) -> Iterator[tuple[str, Grid | None]]:
    enough = board.columns * board.rows
    levels = scales(gray.shape)
    for window in _WINDOWS:
        for scale in levels if window == _WINDOWS[0] else levels[:2]:
            for light in (False, True):
                name = f"{'light' if light else 'dark'} blobs at scale {scale:.2g}, window {window:.0%}"
                grid = disc_grid(
                    gray, window=window, light=light, staggered=board.staggered, enough=enough, scale=scale
                )
                yield name, grid
    if opencv.has_opencv():
        for name, light, q in opencv.circle_candidates(gray, board.columns, board.rows, staggered=board.staggered):
            radius = board.printed_diameter_mm / 2 / board.spacing_mm
            yield name, fitted_discs(gray, board.cells, q, radius, light=light, staggered=board.staggered)


def _rank(grid: Grid, found: PlacedLattice) -> tuple[bool, int, float]:
    return found.fixed, len(found.points) - found.beyond, -float(np.median(grid.fit.misfit))


def _refuse(found: PlacedLattice, pattern: Pattern) -> None:
    """Raise `NoBoard` for a grid that is not this board's, or that fits at several places of it."""
    seen = (-(-found.extent[0] // 2) if getattr(pattern, "staggered", False) else found.extent[0], found.extent[1])
    what = "discs" if isinstance(pattern, CircleGrid) else "inner corners"
    have, all_points = len(found.points), len(pattern.cells)
    shows = f"the picture shows a grid of {seen[0]} x {seen[1]} {what}"
    other = sorted(seen) != sorted((pattern.columns, pattern.rows))
    if found.beyond >= _STRAY * min(pattern.columns, pattern.rows) and other:
        raise NoBoard(str(pattern), shows, seen)
    if have == all_points:
        return
    if have < max(_LEAST, _LEAST_SHARE * all_points):
        raise NoBoard(str(pattern), f"only {have} of its {all_points} points are seen", seen if have > 3 else None)
    if not found.fixed:
        raise NoBoard(
            str(pattern),
            f"{shows}, which may be several parts of it; show all of the board, or use a ChArUco board",
            seen,
        )


def _detection(
    grid: Grid,
    marks: npt.NDArray[np.intp],
    points: npt.NDArray[np.intp],
    pattern: Pattern,
    name: str,
    tried: tuple[str, ...],
) -> Detection:
    order = np.argsort(points)
    index = marks[order]
    q, covariance = grid.fit.q[index], grid.fit.covariance[index]
    radius = radius_by_cell(grid) * pattern.cell_mm if isinstance(pattern, CircleGrid) else None
    return Detection(pattern, points[order], q, covariance, name, tried, radius)


def _charuco(gray: Picture, board: Charuco) -> Detection:
    grid, kind = charuco_grid(gray, board)
    number = {tuple(cell): i for i, cell in enumerate(board.cells.tolist())}
    marks = np.array([i for i, cell in enumerate(grid.cells.tolist()) if tuple(cell) in number], dtype=np.intp)
    points = np.array([number[tuple(cell)] for cell in grid.cells[marks].tolist()], dtype=np.intp)
    if len(points) < _LEAST:
        raise NoBoard(str(board), f"only {len(points)} of its {len(number)} corners are seen; {_LEAST} are needed")
    name = "markers by cv2.aruco, corners between them"
    said = f"{name}: {len(points)} of {len(number)} points"
    note = (f"the markers are those of {kind}",) if kind != board else ()
    return _detection(grid, marks, points, board, name, (said, *note))
