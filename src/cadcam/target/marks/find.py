"""Marks in a picture: candidates by one of three searches, each then fitted to the grey values and judged by the fit.

`spots` (a known radius; the fastest), `correlation` (a known radius; the dissertation's program `cross`) and `blobs`
(any size and tilt: the central disc of a mark is an elliptic blob). Corners of `chess` marks are saddle points. The fit
decides: a candidate that it does not explain is dropped, whichever search found it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Ids, Mask, Picture, frozen
from cadcam.camera.camera import Camera
from cadcam.errors import BadValue, TooFewMarks
from cadcam.geometry.rigid import Rigid
from cadcam.image.picture import to_gray
from cadcam.kinds import expect, expect_count, expect_known, expect_numbers, expect_positive
from cadcam.target.marks.candidates import METHODS, MarkCandidates, approached, mark_candidates, screened
from cadcam.target.marks.cross import surface, taps, template
from cadcam.target.marks.fit import MarkFit, fit_marks
from cadcam.target.marks.mark import Mark, renumbered
from cadcam.target.marks.pose_ambiguity import NORMAL_SD, fit_both_tilts
from cadcam.target.marks.ring_code import oriented, read
from cadcam.target.marks.subpixel import Peak, centroid, parabola
from cadcam.target.marks.window import MARGIN

SUBPIXEL = ("photometric", "parabola", "centroid", "autocorrelation", "autocorrelation-grid")
_LEAST_SCORE = 0.8
_LONGEST = 6.0  # largest axis ratio of a mark's image
_SLACK = 1.4  # largest ratio of a mark's radius to the given one, either way
_SATURATED, _COVERED = 0.05, 0.02  # shares of a mark's window that raise a flag
_OPEN = 0.05  # probability of the other tilt that raises a flag
_SAME = 0.8  # of the larger radius: of two fits within it the better one is kept
_FLAT = 1e-3  # range of grey values of a picture without contrast
_GRID = 0.02  # px: the dissertation's step
_MOST, _SPARE, _FITTED = 5000, 6, 2  # most candidates; screened beyond twice the count; fitted beyond the count


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FoundMark(Brief):
    """A mark in a picture.

    pixel (2,): its position, px; covariance (2, 2) px^2 from the grey values' residuals (NaN for the methods without
    one). size: radius of its outermost border along the longer axis, px; image_from_mark (2, 2): px per mm at its
    centre. score: correlation of the fitted model with the grey values, 0 to 1. angle: direction of its x axis, rad
    from the picture's x towards y, None for marks without a direction; number: of a coded mark. method: search and
    sub-pixel rule. flags: "saturated", "covered", "cut" (by the picture's border), "tilt open" (with a camera: two
    poses that the grey values cannot tell apart). pose: camera_from_mark, where a camera was given.
    """

    pixel: Array
    covariance: Array
    score: float
    size: float
    image_from_mark: Array
    method: str
    angle: float | None = None
    number: int | None = None
    blur: float = float("nan")
    contrast: float = float("nan")
    flags: tuple[str, ...] = ()
    pose: Rigid | None = None

    def __post_init__(self) -> None:
        for name, shape in (("pixel", (2,)), ("covariance", (2, 2)), ("image_from_mark", (2, 2))):
            object.__setattr__(self, name, frozen(getattr(self, name), name, shape, finite=name == "pixel"))

    @property
    def sigma(self) -> Array:
        """Return the standard deviations (2,) of x and y, px."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    def outline(self, radius_mm: float, points: int = 73) -> Array:
        """Return the image (points, 2) of a circle about the centre, px, to first order."""
        turn = np.linspace(0, 2 * np.pi, points)
        circle = radius_mm * np.stack([np.cos(turn), np.sin(turn)], axis=-1)
        return np.asarray(self.pixel + circle @ self.image_from_mark.T)


@dataclass(frozen=True, slots=True)
class MarkOptions:
    """How marks are searched for, measured and judged.

    method: the search: auto, spots, correlation or blobs (`target.marks.find`). subpixel: the rule for a mark's
    position: photometric, the fit; or, for upright marks, parabola, centroid, autocorrelation (EQ 4.1-4.5, continuous),
    autocorrelation-grid (in steps of 0.02 px). perspective: without a camera, fits the perspective of the plane from
    several borders: removes the bias of tilted marks, at the price of more noise. least_score: required correlation
    with the grey values. margin: width of the ground around a mark that is fitted with it, over the mark's radius; must
    be less than the gap to its neighbours. any_number: of a coded mark, any number that is read.
    """

    method: str = "auto"
    subpixel: str = "photometric"
    perspective: bool = False
    least_score: float = _LEAST_SCORE
    margin: float = MARGIN
    any_number: bool = False

    def __post_init__(self) -> None:
        expect_numbers(self)
        expect_known(self.method, "method", METHODS)
        expect_known(self.subpixel, "sub-pixel rule", SUBPIXEL)
        if not 0 <= self.least_score <= 1:
            raise BadValue("least_score", self.least_score, "a correlation from 0 to 1")
        if not 0 < self.margin < np.inf:
            raise BadValue("margin", self.margin, "a positive share of the radius")


PLAIN_MARKS = MarkOptions()


def find_marks(
    picture: npt.ArrayLike,
    mark: Mark,
    *,
    radius_px: float | tuple[float, float] | None = None,
    count: int | None = None,
    camera: Camera | None = None,
    normal: npt.ArrayLike | None = None,
    normal_sd: float = NORMAL_SD,
    options: MarkOptions = PLAIN_MARKS,
) -> list[FoundMark]:
    """Return the marks in a picture (H, W) or (H, W, 3), best first; an empty list if there are none.

    radius_px: of the outermost border in the picture, or (least, largest); if given, the fast search is used, else the
    size is measured. count: how many there are; `TooFewMarks` if fewer are found, the best if more. camera: fits each
    mark's pose, so that perspective and lens do not bias it; normal (3,): of the marks' plane in the camera frame,
    known to normal_sd rad, which decides between the two tilts. Raises `BadValue`, `UnknownName`.
    """
    expect(mark, "mark", Mark)
    expect(camera, "camera", Camera, optional=True)
    expect(options, "options", MarkOptions)
    expect_positive(normal_sd, "normal_sd", "a positive number of rad")
    if count is not None:
        expect_count(count, "count", expected="1 or more, or none where it is not known")
        count = int(count)
    gray = to_gray(picture)
    task = _Task(mark, _search(gray, mark, options, radius_px is not None), _radii(radius_px, gray), count, options)
    toward = None if normal is None else frozen(normal, "normal", (3,))
    found = []
    for one, fit in task.fits(gray):
        if camera is not None:
            fit = fit_both_tilts(gray, one, camera, fit, normal=toward, normal_sd=normal_sd, margin=options.margin)
        found += [_found(gray, one, fit, i, task.search, options.subpixel) for i in range(len(fit))]
    found = _apart(sorted(found, key=lambda f: -f.score))
    if count is not None and len(found) < count:
        raise TooFewMarks(str(mark), len(found), count)
    return found[:count]


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    """What is searched for, by which method, and which fits are accepted; see `find_marks`."""

    mark: Mark
    search: str
    radii: tuple[float, float] | None
    count: int | None
    options: MarkOptions

    def fits(self, gray: Picture) -> Iterator[tuple[Mark, MarkFit]]:
        """Yield the fits that are marks, kind by kind."""
        margin = self.options.margin
        for one, seen in _kinds(gray, self.mark, self._near(gray), self.options.any_number):
            clear = seen.subset(_right_size(seen.shapes, one, self.radii))
            most = _MOST if self.count is None else self.count + _FITTED
            if len(clear) > most or not self._rough:
                clear = screened(gray, one, clear, most=most, margin=margin)
            fit = fit_marks(gray, one, clear.q, clear.shapes, perspective=self.options.perspective, margin=margin)
            yield one, fit.subset(_kept(fit, one, self.radii, self.options.least_score))

    def _near(self, gray: Picture) -> MarkCandidates:
        """Return candidates close enough for a fit to converge."""
        most = _MOST if self.count is None else 2 * self.count + _SPARE
        seen = mark_candidates(gray, self.mark, self.search, self.radii)
        seen = screened(gray, self.mark, seen, most=most, margin=self.options.margin, rough=self._rough)
        return approached(gray, self.mark.rings, seen, self.options.margin, enough=self.count) if self._rough else seen

    @property
    def _rough(self) -> bool:
        """Return whether the search gives places and shapes only to a fifth of the size."""
        return self.search in ("spots", "correlation")


def _search(gray: Picture, mark: Mark, options: MarkOptions, known: bool) -> str:
    """Return the search to use; raise for one that this mark or picture does not allow."""
    if options.subpixel != "photometric" and not mark.concentric:
        raise BadValue("subpixel", options.subpixel, f"'photometric' for {mark}, which differs from turn to turn")
    if options.any_number and mark.number is None:
        raise BadValue("any_number", options.any_number, f"a coded mark; {mark} has no number")
    if options.perspective and len(mark.sectors) == 1 and mark.core == (mark.radius, True):
        one_ellipse = f"a mark of several borders: the one ellipse of {mark} does not show where its centre is"
        raise BadValue("perspective", True, f"{one_ellipse}; or a camera")
    if float(np.ptp(gray)) < _FLAT:
        raise BadValue("picture", f"one grey value ({float(gray.flat[0]):.3g}) everywhere", "a picture of marks")
    if options.method == "auto":
        return "saddles" if mark.core is None else "spots" if known else "blobs"
    return options.method


def _radii(radius_px: float | tuple[float, float] | None, gray: Picture) -> tuple[float, float] | None:
    if radius_px is None:
        return None
    longest = max(gray.shape)
    span = (radius_px, radius_px) if np.ndim(radius_px) == 0 else radius_px
    low, high = frozen(span, "radius_px", (2,), finite=False).tolist()
    if not 1.0 <= low <= high <= longest:
        raise BadValue(
            "radius_px", radius_px, f"1 px to the picture's longer side of {longest} px, or (least, largest)"
        )
    return low, high


def _kinds(gray: Picture, mark: Mark, seen: MarkCandidates, any_number: bool) -> Iterator[tuple[Mark, MarkCandidates]]:
    """Yield the marks that are seen, one kind after the other, rotated as their rings show."""
    if mark.concentric or mark.core is None or not len(seen):
        yield mark, seen
    elif mark.number is None:
        yield mark, replace(seen, shapes=oriented(gray, mark, seen.q, seen.shapes))
    else:
        numbers, shapes = read(gray, mark, seen.q, seen.shapes)
        wanted = sorted({n for n in numbers if n is not None}) if any_number else [mark.number]
        for number in wanted:
            which = np.flatnonzero([n == number for n in numbers]).astype(np.int32)
            yield renumbered(mark, number), replace(seen, shapes=shapes).subset(which)


def _right_size(shapes: Array, mark: Mark, radii: tuple[float, float] | None) -> Mask:
    """Return which shapes (B, 2, 2) are neither too long nor of a size outside the given one."""
    axes = mark.radius * np.linalg.svd(shapes, compute_uv=False)
    right = axes[:, 0] < _LONGEST * axes[:, 1]
    if radii is None:
        return np.asarray(right)
    return np.asarray(right & (axes[:, 0] > radii[0] / _SLACK) & (axes[:, 1] < radii[1] * _SLACK))


def _kept(fit: MarkFit, mark: Mark, radii: tuple[float, float] | None, least_score: float) -> Ids:
    """Return the fits that are marks."""
    right = (fit.contrast > 0) != mark.light
    kept = fit.good & right & (fit.score >= least_score) & _right_size(fit.image_from_mark, mark, radii)
    return np.flatnonzero(kept).astype(np.int32)


def _found(gray: Picture, mark: Mark, fit: MarkFit, i: int, search: str, subpixel: str) -> FoundMark:
    S = fit.image_from_mark[i]
    flags = {"saturated": fit.clipped[i] > _SATURATED, "covered": fit.hidden[i] > _COVERED, "cut": fit.outside[i] > 0}
    flags["tilt open"] = fit.doubt[i] > _OPEN
    found = FoundMark(
        pixel=fit.q[i],
        covariance=fit.covariance[i],
        score=float(fit.score[i]),
        size=float(mark.radius * np.linalg.svd(S, compute_uv=False)[0]),
        image_from_mark=S,
        method=f"{search}, {subpixel}",
        angle=None if mark.concentric else float(np.arctan2(S[1, 0], S[0, 0])),
        number=mark.number,
        blur=float(fit.blur[i]),
        contrast=float(fit.contrast[i]),
        flags=tuple(name for name, raised in flags.items() if raised),
        pose=None if fit.poses is None else fit.poses[i],
    )
    if subpixel == "photometric":
        return found
    return replace(found, pixel=subpixel_position(gray, mark, found, subpixel), covariance=np.full((2, 2), np.nan))


def subpixel_position(gray: Picture, mark: Mark, found: FoundMark, rule: str) -> Array:
    """Return the position (2,) px by a rule that uses the mark's size but not its tilt; see `find_marks`."""
    radius = mark.radius * float(np.sqrt(abs(np.linalg.det(found.image_from_mark))))
    if rule == "centroid":
        q = centroid(gray, found.pixel, radius)
    elif rule == "parabola":
        window, top = surface(gray, found.pixel[None], taps(template(mark, radius)), 1)
        q = top[0] + parabola(window)[0]
    else:
        ideal = template(mark, radius)
        peak = Peak.of_template(ideal)
        window, top = surface(gray, found.pixel[None], taps(ideal), peak.l)
        shift, _ = peak.shift(window[0], grid=_GRID if rule.endswith("grid") else None)
        q = top[0] - shift
    return q if np.isfinite(q).all() else found.pixel


def _apart(found: list[FoundMark]) -> list[FoundMark]:
    """Return the marks not overlapped by a better one."""
    kept: list[FoundMark] = []
    places, sizes = np.zeros((len(found), 2)), np.zeros(len(found))
    for one in found:
        n = len(kept)
        near = np.hypot(*(places[:n] - one.pixel).T) < _SAME * np.maximum(sizes[:n], one.size)
        if not near.any():
            places[n], sizes[n] = one.pixel, one.size
            kept.append(one)
    return kept
