"""All edges that the photos should show, the feature each place belongs to, and the photo's edge found for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.locate.lines.sight import Sight
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.render.view import Scene
from cadcam.verify.edges.association import BORDER_PX, Association, associated, nearby_edges, searchable
from cadcam.verify.edges.feet import Feet
from cadcam.verify.edges.limbs import limb_errors
from cadcam.verify.edges.presence import LEAST_PLACES, Clutter, EdgeEvidence, Presence, clutter_of, presence
from cadcam.verify.edges.rims import Rims
from cadcam.verify.edges.shadows import shadow_errors
from cadcam.verify.edges.shifts import guessed_shifts
from cadcam.verify.edges.shown import ShownFaces
from cadcam.verify.edges.sightlines import Sightlines, sightlines
from cadcam.verify.edges.surroundings import FAINT, EdgeSurroundings, edge_surroundings
from cadcam.verify.edges.undrawn import room_beside
from cadcam.verify.tolerances.circles import Circles
from cadcam.verify.tolerances.tolerance import Selection, Tolerances

_LEAST_GUESSED = 12  # fewest places from which a feature's own place is guessed
_BESIDE_SHARE = 0.5  # share of an edge's places that show an edge beside it and none in place
_LEAST_COVERED_PX = 100  # pixels of a body that a person would say is in the picture: 10 x 10
_BLIND = 0.05  # of the largest image motion: below it a displacement is along the line of sight


@dataclass(frozen=True, eq=False)
class Survey:
    """N places on visible edges.

    nearby (N, K) px: offsets of the photos' edges near each. names: the features in question, then those of the model's
    parts that are not among them; members: the places (N,) of each, which may overlap. body (N,): what moves as one,
    each place in exactly one: the widest feature that contains it, or its part. usable (N,): whether its edge would be
    seen there, distinguishable from its neighbours and well inside the picture; datum (N,): whether the pose may be
    fitted to it; stated: whether the tolerances state the datum. lever (N,) px/mm, mate (N,) and ground (N, 3): the
    place as a foot (`Feet`), with mate a body; ought (N,): whether the light gives its edge contrast; beside: what lies
    at both sides of each place; evidence: of all edges, seen or not; by (P, 3) mm: where the bodies were drawn, from
    their places in the CAD; shown: what the part shows in each photo; sights: each photo's, whose samples are the
    places; reach_px: how far from its lines edges were searched for; circles: of each feature those whose size counts
    (`Tolerances.circles`).
    """

    lines: Sightlines
    nearby: Array
    matched: Association
    names: tuple[str, ...]
    members: tuple[Mask, ...]
    body: Longs
    usable: Mask
    datum: Mask
    stated: bool
    lever: Array
    mate: Longs
    ground: Array
    ought: Mask
    beside: EdgeSurroundings
    evidence: EdgeEvidence
    by: Array
    shown: tuple[ShownFaces, ...]
    sights: tuple[Sight, ...]
    reach_px: float
    circles: tuple[Circles | None, ...] = ()

    @cached_property
    def clutter(self) -> Clutter:
        """How often the photos show an edge where there is none: not asked of a drawing that is dropped at once."""
        moved_as_one = np.where(self.usable, self.body, -1)
        return clutter_of(self.lines, self.nearby, moved_as_one, reach_px=self.reach_px)

    def eye(self, rows: Mask) -> Array | None:
        """Return the camera's place (3,) in the part frame, if one photo has all of these places; None: several do."""
        photos = np.unique(self.lines.photo[rows])
        if len(photos) != 1:
            return None
        sight = self.sights[photos[0]]
        return np.asarray((sight.photo.camera_from_world @ sight.drawn).origin)

    def rows(self, number: int) -> Mask:
        """Return the places (N,) of a feature that can be used."""
        return np.asarray(self.members[number] & self.usable)

    @cached_property
    def rims(self) -> Rims:
        """The places as those of circles whose diameter is asked, which are, as they, where bodies were drawn."""
        return Rims.of(self.lines, self.sights, self.circles, self.members)

    def whole_part(self, number: int) -> int | None:
        """Return the number of the part whose visible places are exactly those of a feature; None if there is none."""
        own = np.unique(self.lines.part[self.members[number]])
        if len(own) != 1 or (self.lines.part == own[0]).sum() != self.members[number].sum():
            return None
        return int(own[0])

    def in_view(self, number: int) -> bool:
        """Return whether a feature, a whole part, covers some of a photo, however short its edges, inside its border.

        Along the border no profile across an edge fits.
        """
        part, border = self.whole_part(number), int(np.ceil(BORDER_PX))
        if part is None:
            return False
        inside = slice(border, -border)
        return any(np.count_nonzero(seen.shows(part)[inside, inside]) >= _LEAST_COVERED_PX for seen in self.shown)

    def mm_per_px(self, number: int) -> float:
        """Return the median length in mm of one px at a feature's edges."""
        return float(np.median(self.lines.mm_per_px[self.members[number]]))

    def shows_beside(self, number: int) -> bool:
        """Return whether some edge of a feature that ought to be seen is not seen in place, but one beside it is."""
        asked = self.members[number] & self.ought
        for e in np.unique(self.lines.edge[asked]):
            rows = asked & (self.lines.edge == e)
            if rows.sum() < LEAST_PLACES or 2 * rows.sum() < ((self.lines.edge == e) & self.rows(number)).sum():
                continue
            beside = ~self.matched.support[rows] & np.isfinite(self.nearby[rows]).any(axis=1)
            if beside.mean() >= _BESIDE_SHARE:
                return True
        return False

    def presence(self, number: int, *, elsewhere: float) -> Presence:
        """Return the evidence that a feature is there; see `cadcam.verify.edges.presence`."""
        evidence, mine = self._evidence_of(number)
        return presence(evidence, mine, clutter=self.clutter, elsewhere=elsewhere)

    def _evidence_of(self, number: int) -> tuple[EdgeEvidence, Mask]:
        """Return evidence of edges, cut in two where a feature holds only a part of one, and which of them are its."""
        member, edge = self.members[number], self.lines.edge
        own = np.unique(edge[member & self.usable])
        if not (np.isin(edge, own) & self.usable & ~member).any():
            return self.evidence, np.isin(self.evidence.edge, own)
        parted = EdgeEvidence.of(self.lines, self.usable, self.matched, self.beside, member=member)
        return parted, member[parted.place]

    def guesses(self, number: int, *, reach_px: float) -> list[Array]:
        """Return displacements (3,) mm of a feature, from where it is drawn, that many of the edges nearby agree with.

        Feet, which may not follow, are used where there is little else. None has a component along the line of sight.
        """
        rows = self.members[number]
        own = rows & (self.mate < 0)
        rows = own if own.sum() >= _LEAST_GUESSED else rows
        if not rows.any():
            return []
        photo = np.bincount(self.lines.photo[rows]).argmax()
        rows = rows & (self.lines.photo == photo)
        normal = self.lines.normal[rows]
        shifts = guessed_shifts(self.nearby[rows], normal, reach_px=reach_px)
        back = np.linalg.pinv(self.lines.by_point[rows], rcond=_BLIND)
        return [back @ (normal @ s) for s in shifts]

    @property
    def seen_share(self) -> float:
        """Return the share of the datum's usable places where the photos show an edge."""
        return self.seen_share_of(self.datum)

    def seen_share_of(self, places: Mask) -> float:
        """Return the share of the usable ones among datum places (N,) where the photos show an edge."""
        asked = places & self.datum & self.usable
        return float(self.matched.support[asked].mean()) if asked.any() else 0.0


def surveyed(
    part: Part,
    photos: Sequence[Photo],
    world_from_part: Rigid,
    asked: Tolerances,
    *,
    reach_px: float,
    by: Array | None = None,
    shown: Sequence[ShownFaces] | None = None,
) -> Survey:
    """Return what the photos show along the part's lines, within `reach_px` of them.

    by (P, 3) mm: displacement of its bodies from where the CAD has them; default none. shown: what the part shows in
    each photo, where that is known.
    """
    by = np.zeros((len(part.scene.mesh.part_names), 3)) if by is None else by
    lines, sights = sightlines(part, photos, world_from_part)
    lines = replace(lines, room=room_beside(part, sights, lines))
    in_place = replace(lines, p=lines.p - by[lines.part])  # features are chosen by their places in the CAD
    names, members = _members(part.scene, in_place, asked)
    body = _bodies(members)
    usable = searchable(lines, [photo.camera for photo in photos])
    moved_as_one = np.where(usable, body, -1)
    shown = [ShownFaces.of(part, photo, world_from_part) for photo in photos] if shown is None else shown
    beside = edge_surroundings(photos, shown, lines)
    ought = usable & (beside.contrast > FAINT) & ~beside.glare
    found = nearby_edges(lines, sights, reach_px=reach_px, way=beside.way)
    matched = associated(lines, sights, found, moved_as_one, reach_px=reach_px, ought=ought)
    matched = _relative_to_cad(matched, lines, photos, world_from_part, by)
    limbs, apart = limb_errors(lines, beside, matched.offset)
    shadows = shadow_errors(lines, beside, np.where(matched.measured, matched.step, np.nan))
    matched = replace(matched, common=np.hypot(matched.common, np.maximum(limbs, shadows)), apart=apart)
    feet = Feet.of(lines, beside)
    return Survey(
        lines=lines,
        nearby=found,
        matched=matched,
        names=names,
        members=members,
        body=body,
        usable=usable,
        datum=_datum(part.scene, in_place, asked),
        stated=bool(asked.datum),
        lever=feet.lever,
        mate=feet.of_bodies(lines, body),
        ground=feet.ground,
        ought=ought,
        beside=beside,
        evidence=EdgeEvidence.of(lines, usable, matched, beside),
        by=by,
        shown=tuple(shown),
        sights=tuple(sights),
        reach_px=reach_px,
        circles=asked.circles(part.scene, by),
    )


def _relative_to_cad(
    matched: Association, lines: Sightlines, photos: Sequence[Photo], world_from_part: Rigid, by: Array
) -> Association:
    """Return offsets and shifts relative to the CAD for bodies that were drawn displaced `by` (P, 3) mm."""
    if not by.any():
        return matched
    mm = by[lines.part]
    shift = matched.shift.copy()
    for i, photo in enumerate(photos):
        rows = lines.photo == i
        camera_from_part = photo.camera_from_world @ world_from_part
        at, place = (photo.camera.project(camera_from_part @ p) for p in (lines.p[rows], (lines.p - mm)[rows]))
        shift[rows] += at - place
    return replace(matched, offset=matched.offset + np.einsum("ni,ni->n", lines.by_point, mm), shift=shift)


def _members(scene: Scene, lines: Sightlines, asked: Tolerances) -> tuple[tuple[str, ...], tuple[Mask, ...]]:
    """Return the features' names and places, and after them those of parts with places in no feature."""
    names = [f.name for f in asked.features]
    members = [_held(scene, lines, f.selection) for f in asked.features]
    rest = ~np.any(members, axis=0) if members else np.ones(len(lines), bool)
    for number in np.unique(lines.part[rest]):
        name = scene.mesh.part_names[number]
        while name in names:
            name = f"rest of {name}"
        names.append(name)
        members.append(rest & (lines.part == number))
    return tuple(names), tuple(members)


def _bodies(members: Sequence[Mask]) -> Longs:
    """Return the body (N,) of each place: of the features that contain it, the one with most places."""
    body = np.full(len(members[0]) if members else 0, -1, np.int64)
    for i in sorted(range(len(members)), key=lambda i: (-int(members[i].sum()), i)):
        body[members[i] & (body < 0)] = i
    return body


def _datum(scene: Scene, lines: Sightlines, asked: Tolerances) -> Mask:
    """Return the places that the pose may be fitted to: those stated, or all of which nothing is asked.

    If something is asked of every part, all: those that do not agree with the others are left out later.
    """
    if asked.datum:
        return np.asarray(np.any([_held(scene, lines, chosen) for chosen in asked.datum], axis=0))
    if asked.judge_every_part(scene.mesh.part_names):
        return np.ones(len(lines), bool)
    judged = [_held(scene, lines, f.selection) for f in asked.judged]
    return ~np.any(judged, axis=0) if judged else np.ones(len(lines), bool)


def _held(scene: Scene, lines: Sightlines, chosen: Selection) -> Mask:
    return chosen.holds(lines.part, lines.chain, lines.kind, lines.p, chosen.bodies(scene))
