"""Which of a part's lines can be visible under the light: none between surfaces of equal brightness.

How bright surfaces are is estimated from the photo itself, given the pose (`cadcam.locate.quality.light`). At the right
pose a line without contrast is known to be invisible, and its absence does not speak against the pose. At a wrong pose
the surfaces lie on anything: the light fits badly, so contrasts are hardly known, and lines of known contrast are
not shown.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cadcam.arrays import Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.quality.light import colors_of, fitted_light
from cadcam.render import open_renderer
from cadcam.render.view import Channel

_ASIDE_PX = 1.5  # distance from a line at which its two sides are evaluated
_FAINT = 2.0  # largest contrast, plus its uncertainty, of invisible lines, in sds of the photo's noise


def showing(part: Part, sights: Sequence[Sight], world_from_part: Rigid) -> list[Sight]:
    """Return sights without the samples between surfaces that the light makes equally bright at a pose."""
    return [sight.select(~_without(part, sight, world_from_part)) for sight in sights]


def _without(part: Part, sight: Sight, world_from_part: Rigid) -> Mask:
    """Return which samples (N,) of a sight are known to lack contrast."""
    photo = sight.photo
    camera_from_part = photo.camera_from_world @ world_from_part
    view = open_renderer(part.scene).render(photo.camera, camera_from_part, channels=Channel.NORMAL | Channel.FACE)
    normal, color = view.normal, colors_of(part, view.face)  # normals in the camera frame: the light may move with it
    at = sight.project(world_from_part)
    seen = at.imaged
    q = at.q[seen, None] + _ASIDE_PX * np.array([-1.0, 1.0])[:, None] * at.normal[seen, None]
    x, y = np.moveaxis(np.clip(np.rint(q).astype(np.int64), 0, np.array(photo.camera.size) - 1), 2, 0)
    change, sigma = fitted_light(photo.gray, normal, color).contrast(normal[y, x].astype(np.float64), color[y, x])
    out = np.zeros(len(at.q), bool)
    out[seen] = np.abs(change) + sigma < _FAINT * sight.noise
    return out
