"""A photo with the deviations of all edges in colour, as self-contained inline SVG."""

from __future__ import annotations

import base64
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from html import escape
from unicodedata import bidirectional

import numpy as np

from cadcam.arrays import Array
from cadcam.image.picture import encoded
from cadcam.image.svg import hex_color
from cadcam.locate.photo import Photo
from cadcam.verify.deviations.deviation import EdgeDeviation, FeatureDeviation, State
from cadcam.verify.inspection import Inspection
from cadcam.verify.reasons import shown_decimals, vector_words
from cadcam.verify.tolerances.tolerance import Quantity
from cadcam.verify.tolerances.verdict import Judgement, Verdict
from cadcam.whole import utf8, write_whole

# Okabe and Ito's hues: blue, pale grey, vermilion; distinct for people with any colour vision
NEGATIVE, ZERO, POSITIVE = np.array([0.0, 0.45, 0.70]), np.array([0.85, 0.85, 0.85]), np.array([0.84, 0.37, 0.0])
MISSING, EXTRA, UNSEEN = "#cc2fa0", "#f0e442", "#9a9a9a"
_CORNER = 0.5  # SVG counts from the corner of the top-left pixel
_MOST_TIMES, _LEAST_ARROW = 100.0, 40  # greatest magnification of arrows; their least length is width / 40
_ARROW_SHARE = 0.09  # of the photo's width: the longest arrow
_LABEL_SHARE, _LETTER = 1 / 32, 0.62  # of the photo's width: a label's height; of that: a wide font's letter
_APART = 8.0  # px from a label to what it names
_MORE = "{} more below"  # labels that have no room; all are in the tables
_LINE, _BELOW = 1.2, 1.8  # distance of labels, and of one from the middle of its dimension line, in their heights
_MOST_LETTERS = int(1 / (_LABEL_SHARE * _LETTER)) - 2  # of a label that is as long as the photo is wide
_LEFT_TO_RIGHT = "\u200e"  # Unicode's mark, without width


def deviation_color(value: float, full: float) -> str:
    """Return the colour of a deviation (mm) on a scale from -full to full."""
    share = float(np.clip(value / full, -1, 1)) if full > 0 else 0.0
    end = POSITIVE if share > 0 else NEGATIVE
    return hex_color(((1 - abs(share)) * ZERO + abs(share) * end).tolist())


def full_scale(seen: Inspection) -> float:
    """Return the deviation (mm), a round number, at which colours saturate: above that of most edges, at least 0.1."""
    values = [abs(e.value) for e in seen.edges if np.isfinite(e.value)]
    values += [f.size for f in seen.features if f.state is State.DISPLACED]
    most = max(values, default=0.0)
    return float(next((s for s in (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0) if most <= s), 20.0))


def write_overlay_svg(
    path: str | os.PathLike[str],
    photo: Photo,
    number: int,
    seen: Inspection,
    *,
    judgements: Sequence[Judgement] = (),
    quality: int = 85,
) -> None:
    """Write the <svg> as a separate picture, whole or not at all."""
    alone = overlay_svg(photo, number, seen, judgements=judgements, quality=quality).replace(
        "<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1
    )
    write_whole(path, utf8(alone))


def overlay_svg(
    photo: Photo, number: int, seen: Inspection, *, judgements: Sequence[Judgement] = (), quality: int = 85
) -> str:
    """Return the <svg> of a photo: edges in the colours of their deviations; what is displaced, missing or fails."""
    width, height = photo.camera.size
    data = base64.b64encode(encoded(photo.gray, "JPEG", quality=quality)).decode()
    full = full_scale(seen)
    body = [f'<image width="{width}" height="{height}" href="data:image/jpeg;base64,{data}"/>']
    gone = {f.name for f in seen.features if f.state is State.MISSING}
    body += [_edge(edge, full, gone) for edge in seen.edges if edge.photo == number]
    for extra in seen.extra:
        if extra.photo == number:
            title = f"{extra.length_px:.0f} px that no edge explains, near {extra.near}"
            body.append(_dots(extra.q, EXTRA, title))
    body += _marks(photo, seen, width, judgements)
    alt = escape(f"photo {number + 1} with the deviations of the part's edges in colour")
    return (
        f'<svg class="photo" viewBox="0 0 {width} {height}" role="img" aria-label="{alt}">' + "".join(body) + "</svg>"
    )


def _edge(edge: EdgeDeviation, full: float, gone: set[str]) -> str:
    if gone & set(edge.features) - set(edge.held):
        return _line(edge.q, MISSING, f"{edge.name}: missing", 2.5, dash=True)
    if not np.isfinite(edge.value):
        return _line(edge.q, UNSEEN, f"{edge.name}: not seen", 1.2, dash=True)
    title = f"{edge.name}: {edge.value:+.3f} mm, U {2 * edge.sigma:.3f} mm (k 2), along {vector_words(edge.direction)}"
    width = 3.5 if edge.off else 2.5
    dark = _line(edge.q, "#000000", "", width + 1.5, opacity=0.45)
    return dark + _line(edge.q, deviation_color(edge.value, full), title, width)


def _line(q: Array, color: str, title: str, width: float, *, dash: bool = False, opacity: float = 1.0) -> str:
    if len(q) < 2:
        return ""
    step = np.linalg.norm(np.diff(q, axis=0), axis=1)
    runs = np.split(q + _CORNER, np.flatnonzero(step > 3 * np.median(step)) + 1)
    path = "".join("M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in run) for run in runs if len(run) > 1)
    style = f'fill="none" stroke="{color}" stroke-width="{width}" stroke-linecap="round"'
    style += ' stroke-dasharray="4 5"' if dash else ""
    style += f' stroke-opacity="{opacity}"' if opacity < 1 else ""
    said = f"<title>{escape(title)}</title>" if title else ""
    return f'<path d="{path}" {style}>{said}</path>' if path else ""


def _dots(q: Array, color: str, title: str) -> str:
    path = "".join(f"M{x + _CORNER:.1f} {y + _CORNER:.1f}h0" for x, y in q[::2])
    said = f"<title>{escape(title)}</title>"
    return f'<path d="{path}" stroke="{color}" stroke-width="3" stroke-linecap="round">{said}</path>'


def _marks(photo: Photo, seen: Inspection, width: int, judgements: Sequence[Judgement]) -> list[str]:
    """Return arrows of displaced features, all magnified by one factor, lines of distances that fail, and labels."""
    moves = _moves(photo, seen, judgements)
    longest = max((float(np.hypot(*d)) for _, _, d in moves), default=0.0)
    times = min(max(_ARROW_SHARE * width / longest, 1.0), _MOST_TIMES) if longest > 0 else 1.0
    arrows = [(q, times * d) for _, q, d in moves if np.hypot(*d) * times > width / _LEAST_ARROW]
    distances = _distances(photo, seen, judgements)
    out = [_dimension(ends, width) for _, ends in distances] + [_arrow(q, d, width) for q, d in arrows]
    labels = [_Label.of(q, d, _label_text(f, judgements), width) for f, q, d in moves]
    below = np.array([0.0, _BELOW * _LABEL_SHARE * width])
    labels += [
        _Label.of(ends.mean(axis=0) + below, np.zeros(2), _shortened(j.feature, _off(j)), width)
        for j, ends in distances
    ]
    notes = [f"arrows: displacements x {times:.0f}"] if arrows else []
    placed = _spaced(labels, photo.camera.size, notes)
    if len(placed) < len(labels):
        placed = _spaced(labels, photo.camera.size, [*notes, _MORE.format(len(labels))])
        notes.append(_MORE.format(len(labels) - len(placed)))
    if placed:
        out += [label.leader(width) for label in placed if label.moved]
        texts = [label.svg() for label in placed]
        texts += [_Label.at_bottom("; ".join(notes), photo.camera.size).svg()] if notes else []
        style = 'font-family="sans-serif" fill="#ffffff" stroke="#000000" paint-order="stroke"'
        out.append(f'<g class="labels" font-size="{_LABEL_SHARE * width:.0f}" {style}>{"".join(texts)}</g>')
    return out


def _moves(
    photo: Photo, seen: Inspection, judgements: Sequence[Judgement]
) -> list[tuple[FeatureDeviation, Array, Array]]:
    """Return the missing, displaced and failing features in the picture, each with its pixel (2,) and displacement, px.

    In the order in which labels get their room: the missing ones, those that fail, and those displaced the farthest.
    """
    camera_from_part, failed = photo.camera_from_world @ seen.pose.world_from_part, failing(judgements)
    moves = []
    for f in seen.features:
        told = f.state in (State.DISPLACED, State.MISSING) or f.name in failed
        if not told or not np.isfinite(f.p).all():
            continue
        ends = np.stack([f.p, f.p + (f.vector if f.state is State.DISPLACED else 0.0)])
        q = photo.camera.project(camera_from_part @ ends)
        if np.isfinite(q).all() and photo.camera.sees(q[0]):
            moves.append((f, q[0], q[1] - q[0]))

    def urgency(f: FeatureDeviation) -> tuple[bool, bool, float]:
        return f.state is not State.MISSING, f.name not in failed, -np.nan_to_num(f.size)

    return sorted(moves, key=lambda move: urgency(move[0]))


def _distances(photo: Photo, seen: Inspection, judgements: Sequence[Judgement]) -> list[tuple[Judgement, Array]]:
    """Return the distances in the picture that fail, each with its two ends (2, 2) px."""
    camera_from_part, out = photo.camera_from_world @ seen.pose.world_from_part, []
    for j in judgements:
        if not j.between or j.verdict is not Verdict.FAIL:
            continue
        one, other = (seen.feature(name).p for name in j.between)
        if j.limit.direction is not None:
            other = one + ((other - one) @ j.limit.direction) * j.limit.direction
        ends = photo.camera.project(camera_from_part @ np.stack([one, other]))
        if np.isfinite(ends).all() and photo.camera.sees(ends).all():
            out.append((j, ends))
    return out


@dataclass(frozen=True, slots=True)
class _Label:
    """A label in a photo: its text from x (px) on, or up to it, on a baseline y; what it names is at the place (2,)."""

    text: str
    x: float
    y: float
    size: float
    leftwards: bool
    place: tuple[float, float]
    moved: bool = False

    @classmethod
    def of(cls, q: Array, d: Array, text: str, width: int) -> _Label:
        """Return the label beside pixel q (2,), on the other side than its arrow d (2,) px if there is room."""
        size, length = _LABEL_SHARE * width, _label_length(text, width)
        leftwards = _leftwards(q, d, text, width)
        x = float(q[0]) - _APART if leftwards else min(float(q[0]) + _APART, max(width - length, 0.0) + _APART)
        return cls(text, x, float(q[1]) - 0.4 * size, size, leftwards, (float(q[0]), float(q[1])))

    @classmethod
    def at_bottom(cls, text: str, size: tuple[int, int]) -> _Label:
        """Return the label at the bottom left of a photo."""
        at = (_APART, 0.97 * size[1])
        return cls(text, 2 * _APART, at[1] - 0.4 * _LABEL_SHARE * size[0], _LABEL_SHARE * size[0], False, at)

    @property
    def box(self) -> tuple[float, float, float, float]:
        """Return left, top, right and bottom (px) of the text: its letters reach a quarter of its height below."""
        length = _LETTER * len(self.text) * self.size
        left = self.x - length if self.leftwards else self.x
        return left, self.y - 0.9 * self.size, left + length, self.y + 0.25 * self.size

    def meets(self, other: _Label) -> bool:
        """Return whether two labels would overlap."""
        (a, b, c, d), (left, top, right, bottom) = self.box, other.box
        return a < right and left < c and b < bottom and top < d

    def svg(self) -> str:
        """Return it as text."""
        anchor = ' text-anchor="end"' if self.leftwards else ""
        place = f'x="{self.x:.0f}" y="{self.y:.0f}"'
        return f'<text {place}{anchor} stroke-width=".18em">{escape(self.text)}</text>'

    def leader(self, width: int) -> str:
        """Return a line from the label to what it names."""
        path = f"M{self.place[0]:.0f} {self.place[1]:.0f}L{self.x:.0f} {self.y - 0.3 * self.size:.0f}"
        colors = (("#000000", width / 400), ("#ffffff", width / 900))
        return "".join(f'<path d="{path}" fill="none" stroke="{c}" stroke-width="{w:.2g}"/>' for c, w in colors)


def _spaced(labels: Sequence[_Label], size: tuple[int, int], notes: Sequence[str]) -> list[_Label]:
    """Return the labels that have room in a photo, each moved up or down, as little as that takes, off those before it.

    notes: what stands at the bottom, and keeps its room.
    """
    line = _LINE * _LABEL_SHARE * size[0]
    lines = int(size[1] / line) + 1
    fixed = [_Label.at_bottom("; ".join(notes), size)] if notes else []
    placed = list[_Label]()
    for label in labels:
        for n in sorted(range(-lines, lines + 1), key=lambda n: (abs(n), -n)):
            tried = replace(label, y=label.y + n * line, moved=n != 0)
            _, top, _, bottom = tried.box
            if top >= 0 and bottom <= size[1] and not any(tried.meets(other) for other in (*fixed, *placed)):
                placed.append(tried)
                break
    return placed


def _label_text(f: FeatureDeviation, judgements: Sequence[Judgement]) -> str:
    """Return a feature's name with what fails, the judgement of its position, or the displacement that is seen."""
    return _shortened(f.name, displacement_words(f, judgements))


def _shortened(name: str, said: str) -> str:
    """Return a name and what is said of it; a name is shortened in its middle where that would leave the photo."""
    most = max(_MOST_LETTERS - len(f": {said}"), 3)
    name = f"{name[: most // 2]}…{name[-((most - 1) // 2) :]}" if len(name) > most else name
    return f"{name}{_LEFT_TO_RIGHT}: {said}" if _is_right_to_left(name) else f"{name}: {said}"


def _is_right_to_left(name: str) -> bool:
    """Return whether letters run leftwards in a name: numbers after it would be shown in turned order, U first."""
    return any(bidirectional(letter) in ("R", "AL") for letter in name)


def displacement_words(f: FeatureDeviation, judgements: Sequence[Judgement]) -> str:
    """Return what fails worst of a feature, by its limit; else the judgement of its position, else its displacement.

    Of a missing one, that it is missing.
    """
    if f.state is State.MISSING:
        return "missing"
    measured = [j for j in judgements if j.feature == f.name and np.isfinite(j.U)]
    if failed := [j for j in measured if j.verdict is Verdict.FAIL]:
        return _failed(max(failed, key=lambda j: abs(j.deviation) / j.limit.value))
    for j in measured:
        if j.limit.quantity is Quantity.POSITION:
            return _plus_minus(j)
    return _value(f.size, 2 * f.sigma)


def failing(judgements: Sequence[Judgement]) -> set[str]:
    """Return the names of the features and distances that fail."""
    return {j.feature for j in judgements if j.verdict is Verdict.FAIL}


def _failed(j: Judgement) -> str:
    if j.limit.quantity is Quantity.ANGLE:
        return f"turned by {_plus_minus(j)}"
    if j.limit.quantity is Quantity.PROFILE:
        return f"a piece of edge {_plus_minus(j)} off"
    return f"diameter {_off(j)}" if j.limit.quantity is Quantity.DIAMETER else _plus_minus(j)


def _off(j: Judgement) -> str:
    """Return by how much a distance or diameter is larger or smaller than in the CAD."""
    off = j.deviation + j.limit.middle
    return f"{_value(abs(off), j.U)} {'more' if off > 0 else 'less'}"


def _plus_minus(j: Judgement) -> str:
    scale = j.limit.quantity.per_unit
    return _value(scale * (j.deviation + j.limit.middle), scale * j.U, j.limit.quantity.unit)


def _value(value: float, U: float, unit: str = "mm") -> str:
    decimals = shown_decimals(2, U)
    return f"{value:.{decimals}f} ± {U:.{decimals}f} {unit}"


def _arrow(q: Array, d: Array, width: int) -> str:
    return _drawn([q, q + d], _barbs(q, d, width), width=width)


def _dimension(ends: Array, width: int) -> str:
    """Return a dimension line with arrowheads at both its ends (2, 2) px."""
    one, other = ends
    heads = [_barbs(b, a - b, width) for a, b in ((one, other), (other, one))]
    return _drawn([one, other], *heads, width=width / 2)


def _barbs(q: Array, d: Array, width: int) -> list[Array]:
    """Return the polyline of the head of an arrow d (2,) px from q (2,)."""
    along = d / max(float(np.hypot(*d)), 1e-9)
    across = np.array([-along[1], along[0]])
    return [q + d - width / 60 * (along + across / 2), q + d, q + d - width / 60 * (along - across / 2)]


def _drawn(*lines: Sequence[Array], width: float) -> str:
    """Return polylines in white with a black border."""
    path = "".join("M" + "L".join(f"{x + _CORNER:.1f} {y + _CORNER:.1f}" for x, y in line) for line in lines)
    return "".join(
        f'<path d="{path}" fill="none" stroke="{color}" stroke-width="{w}" stroke-linejoin="round"/>'
        for color, w in (("#000000", width / 130), ("#ffffff", width / 260))
    )


def _leftwards(q: Array, d: Array, text: str, width: int) -> bool:
    """Return whether a label at q extends to the left: away from its arrow, if there is room on that side."""
    length = _label_length(text, width)
    fits_left, fits_right = q[0] > length, width - q[0] > length
    return bool(fits_left and (d[0] > 0 or not fits_right))


def _label_length(text: str, width: int) -> float:
    return _APART + _LETTER * len(text) * _LABEL_SHARE * width
