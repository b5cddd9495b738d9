"""Pictures of matching results on the photo: a template's peaks, or features and the pose that they agree on."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Picture
from cadcam.image.correlate import Peaks
from cadcam.image.draw import draw_points, draw_polylines, draw_text
from cadcam.image.template import Template
from cadcam.locate.match.templates import TemplateMatches
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo

_WHOLE_PX = 900.0  # px along the longer side up to which lines are a pixel wide
_PLUS_PX, _TEXT_PX = 9.0, 14.0
_MOST_SHARE = 1 / 20  # of the template's smaller side, at most, that a line of its outline covers
_FOUND_COLOR, _OTHER_COLOR = (0.0, 0.85, 0.35), (1.0, 0.35, 0.0)


def with_peaks(photo: Picture, template: Template, peaks: Peaks) -> Picture:
    """Return the photo with the template's outline at each peak, its upper side thick, and the peak's number."""
    w, h = template.size
    large = _thickness(photo)
    thick = min(large, max(1.0, _MOST_SHARE * min(w, h)))
    corner = 0.5 * np.array([[-w, -h], [w, -h], [w, h], [-w, h], [-w, -h]], float)
    picture = photo
    for i, box in enumerate(peaks.at(corner)):
        color = _FOUND_COLOR if i == 0 else _OTHER_COLOR
        picture = draw_polylines(picture, [box], color=color, width=1.5 * thick)
        picture = draw_polylines(picture, [box[:2]], color=color, width=3.5 * thick)
        picture = draw_points(
            picture, peaks.q[i : i + 1], color=color, mark="plus", size=_PLUS_PX * thick, width=1.5 * thick
        )
        at, text = box[0] + large * np.array([4, 10]), f"{i + 1}: {peaks.score[i]:.3f}"
        picture = draw_text(picture, at, text, color=color, height=_TEXT_PX * large)
    return picture


def with_features(photo: Photo, part: Part, matches: TemplateMatches, number: int = 0) -> Picture:
    """Return the photo with the lines of the estimated pose, agreeing features, and the best peaks of the others.

    number: which of the photos that were matched it is, from 0.
    """
    picture, thick = photo.gray, _thickness(photo.gray)
    if matches.found and matches.pose is not None:
        lines = part.lines.draw(photo.camera, photo.camera_from_world @ matches.pose.world_from_part).visible.lines
        picture = draw_polylines(picture, lines, color=(0.1, 0.7, 1.0), width=thick, opacity=0.7)
    features = matches.features
    own = [
        (features.window[i], features.peaks[i], features.chosen[i]) for i in np.flatnonzero(features.photo == number)
    ]
    agreed = [(window, p.q[c]) for window, p, c in own if c >= 0]
    others = [p.q[0] for _, p, c in own if c < 0 and len(p)]
    picture = draw_polylines(picture, [np.array(pair) for pair in agreed], color=_FOUND_COLOR, width=1.5 * thick)
    if agreed:
        centres = np.array([q for _, q in agreed])
        picture = draw_points(picture, centres, color=_FOUND_COLOR, mark="circle", size=11 * thick, width=1.5 * thick)
    if others:
        picture = draw_points(
            picture, np.array(others), color=_OTHER_COLOR, mark="cross", size=9 * thick, width=1.5 * thick
        )
    return picture


def _thickness(photo: Picture) -> float:
    """Return the width of what is drawn, so that it shows where the whole of a large photo is looked at."""
    return max(1.0, float(max(photo.shape)) / _WHOLE_PX)
