"""Calibration from pictures of a board: detected in each, checked against each other, adjusted jointly.

Everything that is left out is reported with its reason: pictures without the board, single points and whole views that
do not fit.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array
from cadcam.calibrate.joint.adjustment import JointFit, estimate_of, fit_jointly
from cadcam.camera.camera import Camera
from cadcam.camera.joint_estimate import JointEstimate
from cadcam.camera.lens import BrownConrady, Lens
from cadcam.camera.observations import Observations
from cadcam.errors import BadValue, CadcamError, NoBoard, SizeMismatch, TooFewPoints, listed
from cadcam.fit.many_poses import PaddedViews, poses_of_views
from cadcam.image.camera_picture import read_camera_picture_with_info
from cadcam.image.picture import checked
from cadcam.kinds import expect, expect_each, expect_flag, expect_names
from cadcam.target.boards.board import Pattern
from cadcam.target.boards.circles import disc_shift
from cadcam.target.boards.detect import Detection, detect
from cadcam.target.boards.pattern import CircleGrid

USUAL_TERMS = ("k1", "k2", "p1", "p2")
_LEAST_VIEWS = 3
_STRAY_POINT = 6.0  # robust sigmas of all residuals
_STRAY_PX = 0.3  # least residual of an outlier
_MAY_LEAVE = 0.25  # of the views: more cannot all be outliers
_SETTLED_PX = 1e-4  # change of the discs' shifts at convergence
_NAMED = 3  # names in a list before "and so many more"


class BoardsDisagree(CadcamError):
    """The pictures do not belong to one calibration: another board than the given one, or several picture sizes."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BoardPicture:
    """A picture and the board in it: `detection`, or None and why not in `problem`.

    seen: the (columns, rows) of the grid that it shows instead of the board, if any.
    """

    name: str
    size: tuple[int, int]
    sha256: str
    detection: Detection | None
    problem: str = ""
    seen: tuple[int, int] | None = None

    @property
    def observations(self) -> Observations:
        """Return the board's points and their pixels. Raises `NoBoard` where none was found.

        Centres of discs are those of their images, which perspective shifts: `board_views` removes that.
        """
        found = self.detection
        if found is None:
            raise NoBoard(f"board in {self.name}", self.problem, self.seen)
        return Observations(found.p_board, found.q, found.names, source=self.name, sha256=self.sha256)

    def __repr__(self) -> str:
        said = self.problem if self.detection is None else f"{len(self.detection.q)} points of {self.detection.pattern}"
        return f"BoardPicture({self.name!r}, {self.size[0]} x {self.size[1]} px, {said})"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class BoardCalibration:
    """A camera from pictures of a board, and the outcome for each picture.

    pictures: all of them. fit: the joint calibration in its raw form, for further analysis. used: the index of each of
    the estimate's views among the pictures. left_out: why a picture was not used, by its index. dropped: the number of
    single points left out in each of the estimate's views. radius_mm: the discs' radius where the board has any: as
    stated, or as estimated from the pictures.
    """

    pattern: Pattern
    pictures: tuple[BoardPicture, ...]
    fit: JointFit
    estimate: JointEstimate
    used: tuple[int, ...]
    left_out: Mapping[int, str]
    dropped: tuple[int, ...]
    radius_mm: float | None = None

    def detection(self, j: int) -> Detection:
        """Return the detection of the estimate's view `j`."""
        found = self.pictures[self.used[j]].detection
        assert found is not None  # `used` holds pictures with a board only
        return found

    @property
    def tilt_deg(self) -> Array:
        """Return the angle (k,) between each view's board and the picture plane, degrees."""
        return np.asarray(np.degrees(np.arccos(np.clip(np.abs(self.estimate.poses.rotation[:, 2, 2]), 0, 1))))

    @property
    def distance_mm(self) -> Array:
        """Return the distance (k,) of the middle of each view's board."""
        middle = self.pattern.points.mean(axis=0)
        return np.asarray(np.linalg.norm(self.estimate.poses @ middle, axis=-1))

    def __repr__(self) -> str:
        return f"BoardCalibration({len(self.used)} of {len(self.pictures)} pictures of {self.pattern}, {self.estimate})"


def find_board(
    picture: str | os.PathLike[str] | npt.ArrayLike,
    pattern: Pattern,
    *,
    full_scale: float | None = None,
    name: str = "",
) -> BoardPicture:
    """Return the board in a picture, or why it was not found: that in a file, or an array (H, W) or (H, W, 3).

    full_scale: the stored value of white in a file, as for `read_camera_picture`; by default found from it. name: of
    the picture in messages and reports; by default the file's, or "picture". Raises `UnreadableFile`, `BadValue`.
    """
    expect(pattern, "pattern", Pattern)
    if isinstance(picture, (str, os.PathLike)):
        read, info = read_camera_picture_with_info(picture, full_scale=full_scale)
        return found_in(read, pattern, name=name or info.path, sha256=info.sha256)
    if full_scale is not None:
        raise BadValue("full_scale", full_scale, "none for an array: divide it by its white")
    values = checked(picture)
    return found_in(values, pattern, name=name or "picture", sha256=hashlib.sha256(values.tobytes()).hexdigest())


def found_in(picture: npt.ArrayLike, pattern: Pattern, *, name: str, sha256: str = "") -> BoardPicture:
    """Return the board in a picture (H, W) or (H, W, 3), or why it was not found."""
    height, width = np.shape(picture)[:2]
    try:
        return BoardPicture(name, (width, height), sha256, detect(picture, pattern))
    except NoBoard as error:
        return BoardPicture(name, (width, height), sha256, None, error.reason, error.seen)


def calibrate_boards(
    pictures: Sequence[BoardPicture],
    *,
    fixed: Mapping[str, float] | None = None,
    lens: Lens | None = None,
    free_lens: Iterable[str] | None = None,
    bend: bool = False,
    keep_all: bool = False,
) -> BoardCalibration:
    """Return the camera that took the pictures, its lens by default Brown-Conrady with k1 k2 p1 p2 and no skew.

    fixed, lens, free_lens, bend: as in `calibrate_jointly`; fixed=None holds skew at 0. Left out, unless `keep_all`:
    points more than six robust sigmas (and 0.3 px) off, and views that `JointEstimate.outlier_views` names (twice the
    median residual, a chance below one in a thousand), the worst first, up to a quarter of all.

    The centre of a disc is not imaged at the centre of its image. The shift is computed with the estimated camera and
    removed, and the camera is estimated again, until convergence. Raises `BoardsDisagree` for pictures of several sizes
    or of another board, `TooFewPoints` for fewer than three views, and what `calibrate_jointly` raises.
    """
    expect(fixed, "fixed", Mapping, optional=True)
    pictures = expect_each(pictures, "pictures", BoardPicture)
    expect(lens, "lens", Lens, optional=True)
    expect_flag(bend, "bend")
    expect_flag(keep_all, "keep_all")
    refuse_disagreeing(pictures)
    pictures = _without_copies(pictures)
    shown = [i for i, p in enumerate(pictures) if p.detection is not None]
    if len(shown) < _LEAST_VIEWS:
        raise TooFewPoints(
            "a calibration from a flat board", len(shown), _LEAST_VIEWS, of="views", why=_losses(pictures)
        )
    if lens is None:
        lens, free_lens = BrownConrady(), USUAL_TERMS if free_lens is None else free_lens
    solver = _Solver(
        {"skew": 0.0} if fixed is None else dict(fixed), lens, expect_names(free_lens or (), "free_lens"), bend
    )
    return _without_outliers(pictures, shown, solver, keep_all=keep_all)


def board_views(pictures: Sequence[BoardPicture], camera: Camera) -> list[Observations | None]:
    """Return the observations of the board in each picture by a known camera, for pose estimates; None without it.

    The shift of the discs' images is removed with the pose estimated from each picture. Raises `BoardsDisagree` for
    pictures of another board, `SizeMismatch` of another size than the camera's, `TooFewPoints` if the board is in none.
    """
    refuse_disagreeing(pictures)
    for p in pictures[:1]:
        if p.size != camera.size:
            raise SizeMismatch(p.name, p.size, camera.size)
    shown = [i for i, p in enumerate(pictures) if p.detection is not None]
    if not shown:
        raise TooFewPoints("poses of a board", 0, 1, of="views", why=_losses(pictures))
    views = [pictures[i].observations for i in shown]
    radius = _radius([_detection(pictures[i]) for i in shown])
    seen: list[Observations | None] = [None] * len(pictures)
    for i, view in zip(shown, views if radius is None else _unshifted(views, camera, radius), strict=True):
        seen[i] = view
    return seen


def _unshifted(views: Sequence[Observations], camera: Camera, radius: float) -> list[Observations]:
    """Return the views without the shift of the discs' images; poses hardly depend on it, so it converges fast."""
    out = list(views)
    for _ in range(3):
        both = poses_of_views(camera, PaddedViews.of([(v.p_world, v.q) for v in out]))
        poses = both.chosen(np.zeros(len(out), dtype=int))
        for j, (view, found) in enumerate(zip(views, np.isfinite(both.sum_of_squares[:, 0]), strict=True)):
            out[j] = replace(view, q=view.q - disc_shift(camera, poses[j], view.p_world, radius)) if found else view
    return out


def _without_copies(pictures: Sequence[BoardPicture]) -> list[BoardPicture]:
    """Return the pictures; those that are copies of another one without their detection."""
    first: dict[str, int] = {}
    out = []
    for i, p in enumerate(pictures):
        original = first.setdefault(p.sha256, i) if p.sha256 else i
        copy = replace(p, detection=None, problem=f"is a copy of {pictures[original].name}")
        out.append(p if original == i else copy)
    return out


def refuse_disagreeing(pictures: Sequence[BoardPicture]) -> None:
    """Raise `BoardsDisagree` for pictures of several sizes, or if most show another board than the given one."""
    sizes = Counter(p.size for p in pictures)
    if len(sizes) > 1:
        usual = sizes.most_common(1)[0][0]
        others = [f"{p.name} ({p.size[0]} x {p.size[1]})" for p in pictures if p.size != usual]
        raise BoardsDisagree(
            f"the pictures are not of one size: most are {usual[0]} x {usual[1]} px, but not "
            f"{listed(others, _NAMED)}; one calibration is one camera at one size: calibrate each size by itself, and "
            "do not crop or resize"
        )
    found = sum(p.detection is not None for p in pictures)
    seen = Counter(tuple(sorted(p.seen, reverse=True)) for p in pictures if p.seen is not None)
    if not seen:
        return
    (columns, rows), times = seen.most_common(1)[0]
    if times > found and times >= 2:
        raise BoardsDisagree(
            f"the board is another one than was asked for: {times} of {len(pictures)} pictures show a grid of "
            f"{columns} x {rows}, {found} the one asked for; give {columns}x{rows} (inner corners of a chessboard are "
            "counted, one less than squares)"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Solver:
    fixed: dict[str, float]
    lens: Lens
    free_lens: tuple[str, ...]
    bend: bool

    def __call__(self, views: Sequence[Observations], size: tuple[int, int]) -> tuple[JointFit, JointEstimate]:
        fit = fit_jointly(views, size, fixed=self.fixed, lens=self.lens, free_lens=self.free_lens, bend=self.bend)
        return fit, estimate_of(fit)


def _without_outliers(
    pictures: Sequence[BoardPicture], shown: list[int], solver: _Solver, *, keep_all: bool
) -> BoardCalibration:
    """Return the calibration without outliers, or with them if `keep_all`: single points first, then whole views."""
    size = pictures[shown[0]].size
    views = {i: pictures[i].observations for i in shown}
    radius = _radius([_detection(pictures[i]) for i in shown])
    used, left_out = list(shown), {i: p.problem for i, p in enumerate(pictures) if p.detection is None}

    def calibrated() -> tuple[JointFit, JointEstimate]:
        return _settled([views[i] for i in used], size, solver, radius)

    fit, estimate = calibrated()
    if not keep_all:
        for i, kept in zip(used, _kept_points(estimate), strict=True):
            views[i] = _subset(views[i], kept)
        fit, estimate = calibrated()
        while (outliers := estimate.outlier_views()) and _may_leave_out_another(used, shown):
            worst = outliers[0]
            left_out[used[worst]] = _why_outlier(estimate, worst)
            del used[worst]
            fit, estimate = calibrated()
    dropped = tuple(len(_detection(pictures[i])) - len(views[i]) for i in used)
    pattern = _detection(pictures[shown[0]]).pattern
    return BoardCalibration(pattern, tuple(pictures), fit, estimate, tuple(used), left_out, dropped, radius)


def _may_leave_out_another(used: Sequence[int], shown: Sequence[int]) -> bool:
    return len(shown) - len(used) + 1 <= _MAY_LEAVE * len(shown) and len(used) > _LEAST_VIEWS


def _why_outlier(estimate: JointEstimate, view: int) -> str:
    residuals = estimate.view_residuals
    return (
        f"outlier: residual {residuals[view]:.2g} px, that of the median view {np.median(residuals):.2g} px; its board "
        "is bent, moved while the picture was taken, or was found in the wrong place"
    )


def _settled(
    views: Sequence[Observations], size: tuple[int, int], solver: _Solver, radius: float | None
) -> tuple[JointFit, JointEstimate]:
    """Return the estimate; for discs, the eccentricity of their images is corrected with its own camera and poses."""
    fit, estimate = solver(views, size)
    if radius is None:
        return fit, estimate
    before = [np.zeros_like(v.q) for v in views]
    for _ in range(6):
        shifts = [disc_shift(estimate.camera, estimate.pose(j), v.p_world, radius) for j, v in enumerate(views)]
        change = max(float(np.abs(a - b).max()) for a, b in zip(shifts, before, strict=True))
        if change < _SETTLED_PX:
            break
        fit, estimate = solver([replace(v, q=v.q - s) for v, s in zip(views, shifts, strict=True)], size)
        before = shifts
    return fit, estimate


def _radius(detections: Sequence[Detection]) -> float | None:
    pattern = detections[0].pattern
    if not isinstance(pattern, CircleGrid):
        return None
    if pattern.diameter_mm is not None:
        return pattern.diameter_mm / 2
    return float(np.median([d.radius_mm for d in detections if d.radius_mm is not None]))


def _kept_points(estimate: JointEstimate) -> list[npt.NDArray[np.bool_]]:
    """Return which points of each view lie within six robust sigmas of a coordinate, or 0.3 px."""
    residuals = estimate.residuals
    typical = [np.median(np.abs(r)) for r in residuals]  # by view: bad views must neither hide outliers nor lose all
    limit = [max(_STRAY_PX, _STRAY_POINT * 1.4826 * float(t)) for t in typical]
    return [np.abs(r).max(axis=1) <= most for r, most in zip(residuals, limit, strict=True)]


def _subset(view: Observations, which: npt.NDArray[np.bool_]) -> Observations:
    names = tuple(n for n, keep in zip(view.names, which, strict=True) if keep)
    return replace(view, p_world=view.p_world[which], q=view.q[which], names=names)


def _detection(picture: BoardPicture) -> Detection:
    assert picture.detection is not None  # callers pass pictures that show the board
    return picture.detection


def _losses(pictures: Sequence[BoardPicture]) -> str:
    lost = [f"{p.name}: {p.problem}" for p in pictures if p.detection is None]
    return f"not found in {len(lost)} of {len(pictures)} pictures: {listed(lost, _NAMED)}" if lost else "all were found"
