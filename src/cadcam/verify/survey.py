"""All edges that the photos should show, which feature each place belongs to, and the photo's edge found for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.verify.association import Association, associated
from cadcam.verify.candidates import Candidates, candidates
from cadcam.verify.presence import EdgeCounts, clutter_of, counted
from cadcam.verify.sightlines import Sightlines, sightlines
from cadcam.verify.tolerance import Selection, Tolerances
from cadcam.verify.twins import twins

Longs = npt.NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """N places on visible edges; every place belongs to one body, which moves as one.

    names: of the bodies, first the features asked about, then the model's parts as far as they are none of those. body
    (N,): of each place; usable (N,): whether its edge cannot be mistaken for a neighbour's; datum (N,): whether the
    pose may be fitted to it; stated: whether the datum was, by the tolerances.
    """

    lines: Sightlines
    found: Candidates
    matched: Association
    names: tuple[str, ...]
    body: Longs
    usable: Mask
    datum: Mask
    stated: bool
    counts: EdgeCounts
    clutter: float

    def rows(self, body: int) -> Mask:
        """Return the places (N,) of a body that can be used."""
        return np.asarray((self.body == body) & self.usable)

    @property
    def seen_share(self) -> float:
        """Return the share of the datum's usable places where the photos show an edge."""
        asked = self.datum & self.usable
        return float(self.matched.support[asked].mean()) if asked.any() else 0.0


def surveyed(
    part: Part, photos: Sequence[Photo], world_from_part: Rigid, asked: Tolerances, *, reach_px: float
) -> Survey:
    """Return what the photos show along the part's lines, within `reach_px` of them."""
    lines = sightlines(part, photos, world_from_part)
    found = candidates(photos, lines, reach_px=reach_px)
    names, body = _bodies(part.scene, lines, asked)
    usable = ~twins(lines)
    moved_as_one = np.where(usable, body, -1)
    matched = associated(lines, found, moved_as_one, reach_px=reach_px)
    return Survey(
        lines,
        found,
        matched,
        names,
        body,
        usable,
        _datum(part.scene, lines, asked, body),
        bool(asked.datum),
        counted(lines, moved_as_one, matched.support),
        clutter_of(lines, found, moved_as_one, reach_px=reach_px),
    )


def _bodies(scene: Scene, lines: Sightlines, asked: Tolerances) -> tuple[tuple[str, ...], Longs]:
    """Return the names of the bodies and the body (N,) of each place: the first feature that has it, else its part."""
    features = [f.name for f in asked.features]
    body = np.full(len(lines), -1, np.int64)
    for i, feature in reversed(list(enumerate(asked.features))):
        body[_held(scene, lines, feature.selection)] = i
    rest = np.unique(lines.part[body < 0])
    for j, number in enumerate(rest):
        body[(body < 0) & (lines.part == number)] = len(features) + j
    others = [scene.mesh.part_names[number] for number in rest]
    return (*features, *(f"rest of {name}" if name in features else name for name in others)), body


def _datum(scene: Scene, lines: Sightlines, asked: Tolerances, body: Longs) -> Mask:
    """Return the places that the pose may be fitted to: those stated, or all that nothing is asked of."""
    if asked.datum:
        held = [_held(scene, lines, chosen) for chosen in asked.datum]
        return np.asarray(np.any(held, axis=0))
    limited = np.array([bool(f.limits) for f in asked.features], bool)
    is_feature = body < len(limited)
    return np.asarray(~is_feature | ~limited[np.where(is_feature, body, 0)]) if len(limited) else np.ones(len(body), bool)


def _held(scene: Scene, lines: Sightlines, chosen: Selection) -> Mask:
    return chosen.holds(lines.part, lines.chain, lines.kind, lines.p, chosen.bodies(scene))
