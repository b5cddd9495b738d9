"""Matching results as tables and JSON: peaks with the gap to the next (Tables 3.15 and 3.16), features, edges."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cadcam.arrays import Array
from cadcam.files.jsontext import or_null
from cadcam.files.matrix import pose_as_json
from cadcam.image.correlate import Peaks
from cadcam.image.template import Template
from cadcam.image.undetermined import Undetermined, undetermined
from cadcam.locate.match.closeness import Closeness
from cadcam.locate.match.templates import Features, TemplateMatches
from cadcam.locate.photo import Photo
from cadcam.report.table import Table

_LITTLE = 0.01  # share of a template's pixels with structure below which coarse pixels may lose it all
_HIGH = 0.95  # score that a slow change of brightness and noise hardly reach by themselves: up to 0.8 were seen


def peaks_table(peaks: Peaks, title: str, *, template: Template | None = None) -> Table:
    """Return score, place, angle and scale of each peak with their sigmas, and the gap to the next.

    template: what was looked for; notes say what it does not determine, where sigmas are those of the rest, and where
    it was not found well and has little structure.
    """
    sigma = peaks.sigma
    scaled = bool(sigma[:, 3].any()) if len(peaks) else False
    left_open = [] if template is None else undetermined(peaks, template)
    rows = []
    for i in range(len(peaks)):
        gap = peaks.gap[i]
        rows.append(
            (
                str(i + 1),
                f"{peaks.score[i]:.4f}",
                "" if math.isnan(gap) else f"{gap:.4f}",
                f"{peaks.q[i, 0]:.3f}",
                f"{peaks.q[i, 1]:.3f}",
                _px(peaks.covariance[i, :2, :2], left_open[i] if left_open else None),
                f"{round(math.degrees(peaks.angle[i]), 2) + 0.0:.2f}",  # + 0.0: no -0.00
                f"{math.degrees(sigma[i, 2]):.3f}",
                *((f"{peaks.scale[i]:.4f}", f"{sigma[i, 3]:.4f}") if scaled else ()),
            )
        )
    columns = ("", "score", "gap", "x, px", "y, px", "+-", "angle, deg", "+-") + (("scale", "+-") if scaled else ())
    return Table(title, columns, tuple(rows), notes=_peak_notes(peaks, template))


def _px(covariance: Array, left_open: Undetermined | None) -> str:
    """Return the sigma of a coordinate, px; where the place along an edge is open, that across it."""
    variance = np.linalg.eigvalsh(covariance)
    known = variance[: 2 - len(left_open.along)] if left_open else variance
    return f"{math.sqrt(max(float(known.mean()), 0.0)):.3f}" if len(known) else "open"


def feature_table(matches: TemplateMatches) -> Table:
    """Return one row per feature: its place in the drawing, its best peaks, and which of them agree with the pose."""
    rows = []
    for i, peaks in enumerate(matches.features.peaks):
        chosen = int(matches.features.chosen[i])
        best = [f"{s:.2f}" for s in peaks.score[:2]] + ["", ""]
        x, y = matches.features.window[i]
        place = ("", "", "none agrees")
        if chosen >= 0:
            q = peaks.q[chosen]
            place = (f"{q[0]:.2f}", f"{q[1]:.2f}", f"peak {chosen + 1}")
        rows.append((str(i + 1), f"{x:.0f}", f"{y:.0f}", best[0], best[1], *place))
    title = f"{len(matches.features)} features, {int(np.sum(matches.features.chosen >= 0))} agree on one pose"
    columns = ("feature", "drawn x px", "drawn y px", "best", "second", "found x px", "found y px", "")
    agreeing = f"as many agreeing by chance: {matches.by_chance:.1g} poses expected"
    if not np.isfinite(matches.by_chance):
        agreeing = "too few agree to tell them from chance"
    notes = (agreeing,) if rows else ("the drawing has nothing there that is worth looking for in the photo",)
    return Table(title, columns, tuple(rows), ("",), notes)


def feature_peaks(features: Features) -> list[Table]:
    """Return the peak table of each feature."""
    titles = (f"Feature {i + 1}, drawn at ({x:.0f}, {y:.0f})" for i, (x, y) in enumerate(features.window))
    return [peaks_table(peaks, title) for peaks, title in zip(features.peaks, titles, strict=True)]


def closeness_table(close: Closeness) -> Table:
    """Return one row per edge, the longest first: the share of it near a photo edge, and the distance."""
    rows = tuple(
        (
            str(int(close.chain[i])),
            f"{close.length[i]:.0f}",
            f"{100 * close.share[i]:.0f}",
            f"{100 * close.chance[i]:.0f}",
            _number(close.offset[i]),
            _number(close.scatter[i]),
            _number(close.shift[i]),
            f"{100 * close.votes[i]:.0f}",
        )
        for i in np.argsort(-close.length, kind="stable")
    )
    columns = ("edge", "length, px", "close, %", "chance, %", "offset, px", "scatter", "by vote, px", "votes, %")
    notes = (
        f"over all edges {100 * close.total:.0f} % more than chance (100: all, 0: as lines drawn anywhere)",
        "offset: from the model's edge to the photo's, to the right of the direction in which the edge runs",
    )
    return Table(f"How close the photo's edges are to {len(close)} visible edges", columns, rows, notes=notes)


def template_as_json(template: Template) -> dict[str, Any]:
    """Return how many pixels of a template count, and how many of these show structure."""
    return {"template_pixels": int(template.mask.sum()), "structured_pixels": template.structured()}


def peaks_as_json(peaks: Peaks, template: Template | None = None) -> dict[str, Any]:
    """Return the peaks as a document, angles in degrees; with what each does not determine if a template is given."""
    sigma, gap = peaks.sigma, peaks.gap
    left_open = [] if template is None else undetermined(peaks, template)
    return {
        "complete": peaks.complete,
        "peaks": [
            {
                "q": peaks.q[i].tolist(),
                "angle_deg": math.degrees(peaks.angle[i]),
                "scale": float(peaks.scale[i]),
                "score": float(peaks.score[i]),
                "gap": or_null(gap[i]),
                "sigma_px": sigma[i, :2].tolist(),
                "sigma_deg": math.degrees(sigma[i, 2]),
                "sigma_scale": float(sigma[i, 3]),
                "covariance": peaks.covariance[i].tolist(),  # of x, y (px), angle (rad) and scale
                **({"not_determined": _as_json(left_open[i])} if left_open else {}),
            }
            for i in range(len(peaks))
        ],
    }


def _as_json(left_open: Undetermined) -> dict[str, Any]:
    return {"along": [list(d) for d in left_open.along], "angle": left_open.angle, "scale": left_open.scale}


def matches_as_json(matches: TemplateMatches, photo: Photo, number: int = 0) -> dict[str, Any]:
    """Return the pose, and every feature with its place in the drawing, its peaks and which agree with the pose.

    Of one of the photos that were matched: number, from 0, which it is.
    """
    features, pose = matches.features, matches.pose
    return {
        "found": matches.found,
        "poses_by_chance": or_null(matches.by_chance),
        "camera_from_part": None if pose is None else pose_as_json(photo.camera_from_world @ pose.world_from_part),
        "covariance": None if pose is None else pose.covariance.tolist(),
        "from_calibration": None if pose is None else pose.from_calibration.tolist(),
        "features": [
            {
                "drawn": features.window[i].tolist(),
                "p_part": features.p_part[i].tolist(),
                "chosen": int(features.chosen[i]) if features.chosen[i] >= 0 else None,
                **peaks_as_json(features.peaks[i]),
            }
            for i in np.flatnonzero(features.photo == number)
        ],
    }


def closeness_as_json(close: Closeness) -> dict[str, Any]:
    """Return how close the edges are in total, and each edge by its chain; null where there is no result."""
    names = ("length", "share", "chance", "offset", "scatter", "shift", "votes")
    return {
        "total": close.total,
        "each": [
            {"chain": int(close.chain[i])} | {n: or_null(getattr(close, n)[i]) for n in names}
            for i in range(len(close))
        ],
    }


def _number(value: float) -> str:
    return "" if math.isnan(value) else f"{value:.2f}"


def _peak_notes(peaks: Peaks, template: Template | None) -> tuple[str, ...]:
    little = _little_structure(peaks, template)
    if not len(peaks):
        return ("nothing in the picture looks like the template", *little)
    more = () if peaks.complete else ("the picture holds more candidates than were looked at: a better peak may exist",)
    return more + _left_open(peaks, template) + little


def _left_open(peaks: Peaks, template: Template | None) -> tuple[str, ...]:
    """Return of which peaks what is not determined, one line for all of which the same is not."""
    if template is None:
        return ()
    alike: dict[str, list[tuple[int, str]]] = {}
    for i, left_open in enumerate(undetermined(peaks, template)):
        if left_open:
            alike.setdefault(_in_words(left_open, 1), []).append((i + 1, _in_words(left_open, 2)))
    right = "what it shows is the same there; cut out a corner, an end or a mark with it"
    return tuple(
        f"peak{'s' * (len(of) > 1)} {', '.join(str(i) for i, _ in of)}: not determined {of[0][1]}: {right}"
        for of in alike.values()
    )


def _in_words(left_open: Undetermined, digits: int) -> str:
    along = [f"along ({round(x, digits) + 0.0:g}, {round(y, digits) + 0.0:g})" for x, y in left_open.along]
    others = [f"in {name}" for name in ("angle", "scale") if getattr(left_open, name)]
    return " and ".join([*along, *others])


def _little_structure(peaks: Peaks, template: Template | None) -> tuple[str, ...]:
    """Return how much structure a template has that was not found well, where that may be why."""
    if template is None or np.abs(peaks.score).max(initial=0.0) >= _HIGH:
        return ()
    structured, counted = template.structured(), int(template.mask.sum())
    if structured >= _LITTLE * counted:
        return ()
    why = f"{structured} of the template's {counted} pixels lie on a border or texture that stands out of its noise"
    right = "take a smaller one, cut out around them, or one with corners or texture"
    return (f"{why}; the rest looks like any other place: {right}",)
