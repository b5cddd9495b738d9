"""ChArUco boards in a picture: OpenCV's markers identify the corners, our own fit locates them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Ids, Picture
from cadcam.errors import NoBoard
from cadcam.fit.plane_maps import mapped, perspectives
from cadcam.target.boards.chess import fitted_corners
from cadcam.target.boards.grid import Grid
from cadcam.target.boards.opencv import areas, find_markers
from cadcam.target.boards.pattern import Charuco

_AROUND = 2.6  # squares: markers within this distance of a corner predict its position
_FITS = 0.25  # squares: largest distance of a marker's corner from where its neighbours predict it
_CLEAR = 1.2  # in units of the margin between square and marker: the marker's nearest corner is at sqrt(2)
_LARGEST = ("4X4_1000", "5X5_1000", "6X6_1000", "7X7_1000", "APRILTAG_36h11")  # of each kind, containing the smaller


@dataclass(frozen=True, slots=True, eq=False)
class _Markers:
    """Corners of markers: positions (M, 4, 2) in squares from the first inner corner, and pixels (M, 4, 2)."""

    place: Array
    q: Array


def charuco_grid(gray: Picture, board: Charuco) -> tuple[Grid, Charuco]:
    """Return the board's inner corners in a picture at their cells, and the board with its kind as recognised.

    Boards of the legacy kind are recognised by their markers. Raises `NoBoard`, which names the markers seen instead.
    """
    number, q = find_markers(gray, board.dictionary)
    if not len(number):
        raise NoBoard(str(board), _other_dictionaries(gray, board))
    kinds = [board, replace(board, legacy=not board.legacy)] if board.rows % 2 == 0 else [board]
    fitting = [(_consistent(kind, number, q), kind) for kind in kinds]
    markers, kind = max(fitting, key=lambda pair: len(pair[0].q))  # max keeps the first of equals: the kind of `board`
    if len(markers.q) < max(2, len(number) // 2):
        raise NoBoard(str(board), _other_size(board, number, q), None)
    cells, start = _predicted(kind, markers)
    margin = (1 - kind.marker_mm / kind.square_mm) / 2
    grid = fitted_corners(gray, cells, start, clear_of=min(1.0, _CLEAR * margin / 0.42)) if len(cells) >= 4 else None
    if grid is None:
        raise NoBoard(str(board), f"{len(markers.q)} of its markers were read, but no four corners between them")
    return grid, kind


def _places(board: Charuco, number: Ids) -> Array:
    """Return the corners (M, 4, 2) of markers on the board, in squares from the first inner corner, clockwise."""
    side = board.marker_mm / board.square_mm
    square = board.marker_squares[number].astype(np.float64) - 1
    unit = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    return np.asarray(square[:, None] + (1 - side) / 2 + side * unit)


def _consistent(board: Charuco, number: Ids, q: Array) -> _Markers:
    """Return the markers that lie where their nearest neighbours predict them on this board."""
    known = number < len(board.marker_squares)
    number, q = number[known], q[known]
    if len(number) < 2:
        return _Markers(np.zeros((0, 4, 2)), np.zeros((0, 4, 2)))
    place = _places(board, number)
    middle = place.mean(axis=1)
    side = np.sqrt(np.abs(areas(q))) * board.square_mm / board.marker_mm
    good = np.zeros(len(number), dtype=bool)
    for i in range(len(number)):
        near = np.argsort(np.hypot(*(middle - middle[i]).T), kind="stable")[1:4]
        off = np.hypot(*(mapped(_map(place[near], q[near]), place[i]) - q[i]).T).max()
        good[i] = off < _FITS * side[i] * (1 if len(near) > 1 else 3)
    return _Markers(place[good], q[good])


def _predicted(board: Charuco, markers: _Markers) -> tuple[Ids, Array]:
    """Return the cells of corners with markers around them, and the positions that those predict."""
    middle = markers.place.mean(axis=1)
    cells, places = [], []
    for cell in board.cells:
        distance = np.hypot(*(middle - cell).T)
        near = np.flatnonzero(distance < _AROUND)
        if not near.size or distance[near].min() > 1.0:
            continue
        there = mapped(_map(markers.place[near], markers.q[near]), cell[None].astype(np.float64))[0]
        if np.isfinite(there).all():
            cells.append(cell)
            places.append(there)
    return np.array(cells, dtype=np.int32).reshape(-1, 2), np.array(places).reshape(-1, 2)


def _map(p: Array, q: Array) -> Array:
    """Return the homography (3, 3) from corners of markers p (M, 4, 2) to q."""
    p, q = p.reshape(1, -1, 2), q.reshape(1, -1, 2)
    return np.asarray(perspectives(p, q, np.ones(p.shape[:2]))[0])


def _other_dictionaries(gray: Picture, board: Charuco) -> str:
    seen = {name: len(find_markers(gray, name, thorough=False)[0]) for name in _LARGEST}
    best = max(seen, key=lambda name: seen[name])
    said = f"no marker of dictionary {board.dictionary} is in the picture"
    return said if seen[best] < 3 else f"{said}, but {seen[best]} of {best} (or a smaller one of its kind) are"


def _other_size(board: Charuco, number: Ids, q: Array) -> str:
    """Return the board size that would explain the positions of the markers."""
    most, highest = 0, int(number.max())
    fit: Charuco | None = None
    for columns in range(3, 41):
        rows = -(-2 * (highest + 1) // columns)
        rows = max(3, rows + (columns * rows // 2 <= highest))
        for legacy in (False, True):
            other = replace(board, columns=columns, rows=rows, legacy=legacy)
            count = len(_consistent(other, number, q).q)
            if count > most:
                most, fit = count, other
    said = f"{len(number)} markers of dictionary {board.dictionary} were read (numbers up to {highest}), but not where "
    said += f"a board of {board.columns} x {board.rows} squares has them"
    if fit is None or most < max(2, len(number) // 2):
        return said
    return said + f"; they lie as on one of {fit.columns} columns of squares, {fit.rows} rows or more"
