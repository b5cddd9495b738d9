"""All instances of a part in photos: in a tray, on a belt, in a heap.

One instance beside others does not stand out, as `locate_part` requires of the only one. Here every pose that holds
under refinement is an instance, unless most of its lines are another one's. Instances that were found explain their
lines: searches do not see these any more (`Photo.explained`), and what stands behind an instance is not expected to
show (`Refinement.others`). So what lies beneath is found after what lies on top, until a search finds nothing more.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array, Longs, Mask
from cadcam.geometry.rigid import Rigid
from cadcam.kinds import expect, expect_count, expect_each
from cadcam.locate.freedom import FREE
from cadcam.locate.in_photos import Trial, distinct_poses, elsewhere, equivalent, stands_out
from cadcam.locate.location import Location
from cadcam.locate.part import Part
from cadcam.locate.photo import Photo
from cadcam.locate.reason import Reason, Refusal
from cadcam.locate.refine.basins import Basins
from cadcam.locate.refine.options import EDGES, EdgeOptions
from cadcam.locate.refine.refinement import Refinement
from cadcam.locate.refine.retaken import at_their_sharpness
from cadcam.locate.rivals import Rivals
from cadcam.locate.search.hypothesis import Hypothesis
from cadcam.locate.search.lying import Lying, met_by_search
from cadcam.locate.search.quota import MANY
from cadcam.locate.search.without_start import search
from cadcam.locate.usable import check_photos
from cadcam.locate.views.view_range import WHOLE_SPHERE, ViewRange

MOST = 100  # instances that are looked for, unless fewer are asked for
_TRIED = 30  # most hypotheses of a search that are refined
_SURE = 0.6  # quality from which an instance need not stand out among what was searched
_LINE_PX = 4  # half width of what a line explains
_SHARED = 0.5  # share of the lines shown from which a pose is another one's
_NOTHING = Reason("nothing in the photos looks like the part", Refusal.NOT_FOUND)
_NOT_SURE = "lines elsewhere in the photos look nearly as much like the part"


def locate_instances(
    part: Part,
    photos: Sequence[Photo],
    *,
    views: ViewRange = WHOLE_SPHERE,
    most: int = MOST,
    options: EdgeOptions = EDGES,
    step: Callable[[int], None] | None = None,
) -> list[Location]:
    """Return where every instance of the part is that the photos show (world_from_part, mm), the surest first.

    Never empty: where none is found, the one entry is the best pose tried, with `found` false and the reason. photos,
    views, options, and what `alternatives` hold: as for `locate_part`. most: after so many no more are searched for.
    step: called after each search with the number of instances found. Raises `BadValue` on photos without contrast.
    """
    expect(part, "part", Part)
    photos = expect_each(photos, "photos", Photo)
    expect(views, "views", ViewRange)
    expect_count(most, "most")
    expect(options, "options", EdgeOptions)
    check_photos(photos)

    def found_in(photos: Sequence[Photo], times: Sequence[int]) -> list[Location]:
        lying = Lying.of(part, photos, views)
        every = _Instances(part, photos, options, lying)
        while len(every.found) < most:
            best, more = every.searched(views)
            if step:
                step(len(every.found))
            if not more:
                break
        found = sorted(every.found, key=lambda one: -one.quality)[:most] or [best]
        return found if lying is None else [lying.counted(one, photos) for one in found]

    return at_their_sharpness(photos, found_in)


@dataclass(frozen=True, slots=True, eq=False)
class _Instances:
    """Instances found so far in some photos, and the pixels (H, W) of each photo that their lines explain."""

    part: Part
    photos: Sequence[Photo]
    options: EdgeOptions
    lying: Lying | None
    found: list[Location] = field(default_factory=list)
    explained: list[Mask] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.explained.extend(np.zeros(photo.gray.shape, bool) for photo in self.photos)

    def searched(self, views: ViewRange) -> tuple[Location, bool]:
        """Return the best pose that one more search tried, and whether any were instances, which are added."""
        rest = [replace(photo, explained=mask) for photo, mask in zip(self.photos, self.explained, strict=True)]
        hypotheses = search(self.part, rest if self.found else self.photos, views, quota=MANY)
        trials, known = self.refined(hypotheses), len(self.found)
        likely = [trial for trial in trials if trial.location.found]
        other = [h for h in hypotheses if all(self.apart(h, trial) for trial in likely)]
        for trial in likely:
            sure = trial.location.quality >= _SURE or stands_out(self.part, trial, other)
            if sure and self.shared(trial.location) < _SHARED:
                self.add(trial.location)
        if not trials:
            return Location.nowhere(Rigid(), _NOTHING), False
        best = trials[0].location
        return best.uncertain(_NOT_SURE) if best.found else best, len(self.found) > known

    def refined(self, hypotheses: Sequence[Hypothesis]) -> list[Trial]:
        """Return the best hypotheses refined and checked against the part's look-alikes, best quality first."""
        poses = [one.pose.world_from_part for one in self.found]
        chosen = met_by_search(self.lying)
        rivals = Rivals(self.part, self.photos, FREE, self.options, chosen)
        basins = Basins(FREE)
        trials: list[Trial] = []
        for h in hypotheses[:_TRIED]:
            sure = [trial for trial in trials if trial.location.quality >= _SURE]
            if any(not self.apart(h, trial) for trial in sure) or basins.hold(h.world_from_part, h.within_px):
                continue
            near = replace(self.options, search_px=h.within_px)
            refinement = Refinement(self.part, self.photos, options=near, chosen=chosen, others=poses)
            location, sights = refinement.around(h.world_from_part)
            basins.add(location, sights)
            location = rivals.checked(location, sights) if location.found else location
            trials.append(Trial(h.score, location if self.lying is None else self.lying.checked(location)))
        return sorted(trials, key=lambda trial: -trial.location.quality)

    def apart(self, h: Hypothesis, trial: Trial) -> bool:
        """Return whether a hypothesis is about another place in the photos than a trial."""
        return elsewhere(self.part, trial.location.pose.world_from_part, h.world_from_part)

    def shared(self, location: Location) -> float:
        """Return the share of the lines shown of a pose that instances found before explain."""
        m = location.matches
        shown = m.believed
        seen = m.q[shown] + m.offset[shown, None] * m.normal[shown]
        each = [mask[self.pixels(k, seen[m.photo[shown] == k])] for k, mask in enumerate(self.explained)]
        every = np.concatenate(each)
        return float(every.mean()) if len(every) else 1.0

    def add(self, location: Location) -> None:
        """Add an instance, and what its lines explain."""
        reach = np.arange(-_LINE_PX, _LINE_PX + 1)
        disc = np.array([(x, y) for x in reach for y in reach if x * x + y * y <= _LINE_PX**2])
        for k, mask in enumerate(self.explained):
            q = location.matches.q[location.matches.photo == k]
            mask[self.pixels(k, (q[:, None] + disc).reshape(-1, 2))] = True
        alike = distinct_poses(self.part, location, location.alternatives, equivalent(self.part, location, self.lying))
        self.found.append(replace(location, alternatives=tuple(alike)))

    def pixels(self, photo: int, q: Array) -> tuple[Longs, Longs]:
        """Return the rows and columns of the pixels of a photo at places q (N, 2) px, of those that it shows."""
        x, y = np.rint(q[self.photos[photo].camera.sees(q)]).astype(np.int64).T
        return y, x
