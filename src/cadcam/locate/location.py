"""The answer to "where is the part?": pose, evidence, quality, and the alternatives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from cadcam.arrays import Array
from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.locate.freedom import Freedom
from cadcam.locate.matches import EdgeMatches, JudgedSamples
from cadcam.locate.reason import Reason, Refusal

FOUND = 0.5  # quality from which a pose counts as found: one threshold for all parts
MORE_THAN_LIGHT = "more than light explains: are model, focal length and lens as told?"
_UNKNOWN = np.diag([1e6] * 3 + [10.0] * 3)  # mm^2, rad^2: covariance of a pose without any measurement
_UNCERTAIN = 0.45  # largest quality of a pose that is not certain for a reason beside its own lines


def unmeasured(world_from_part: Rigid, B: Array) -> PoseEstimate:
    """Return a pose that nothing was measured of, as unknown as can be along the free motions B (6, k)."""
    return PoseEstimate(world_from_part, B @ (B.T @ _UNKNOWN @ B) @ B.T, freedom=B, dof=1.0)


@dataclass(frozen=True, slots=True)
class Disagreement:
    """A photo that, beyond doubt, does not show the part where all photos together have it.

    photo: its number; name: of its viewpoint. px: how far the lines move if the part is fitted to this photo alone by
    rotating its camera; nan where nothing of the part is found there. left_out: whether the pose ignores this photo.
    """

    photo: int
    name: str
    px: float
    left_out: bool

    def __str__(self) -> str:
        """Return it in words."""
        off = f"{self.px:.1f} px beside where all together have it"
        said = f"photo {self.name!r} shows {'nothing of the part' if math.isnan(self.px) else f'the part {off}'}"
        return f"{said}, and was left out" if self.left_out else said


@dataclass(frozen=True, slots=True)
class Covered:
    """What something that stands before the part hides of it.

    share: of its lines in view; side: of the part as pictured, such as "lower left", "" where that is open.
    """

    share: float
    side: str

    def __str__(self) -> str:
        """Return it in words."""
        at = f" at its {self.side}" if self.side else ""
        return f"something stands before the part{at} and hides {self.share:.0%} of its edges"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Location:
    """Where the part is, or the best pose that was tried.

    quality in [0, 1]: how certain it is that the pose is right; from `FOUND` on the part counts as found. why: it is
    believed, or not; `reason` is that as one line of text. alternatives: other poses that the photos allow nearly as
    well (symmetry, planar flip), best first. doubted: whether the evidence was weak at first: few or faint lines, or a
    loose fit. disagreements: those of several photos that do not show the part there. cameras_off_mm: standard
    deviation by which the photos show each camera to be off along each axis of the world and, by its direction, at the
    part, in addition to the covariance of its calibration; the covariance of the pose contains what follows from it.
    covered: what was taken to be hidden by something before the part, and so does not count; None where the answer
    needed no such thing. judged: samples of the part's edges, and which of them the photos show. off_px: by how much
    the edges are off as a whole, where that is more than light explains; 0 elsewhere.
    """

    pose: PoseEstimate
    matches: EdgeMatches
    quality: float
    why: Reason
    alternatives: tuple[Location, ...] = field(default=(), repr=False)
    doubted: bool = False
    disagreements: tuple[Disagreement, ...] = ()
    cameras_off_mm: float = 0.0
    covered: Covered | None = None
    judged: JudgedSamples = field(default_factory=JudgedSamples.none, repr=False)
    off_px: float = 0.0

    @classmethod
    def nowhere(cls, world_from_part: Rigid, why: Reason | str) -> Location:
        """Return the answer where there is no evidence of the part: quality 0, no matches, at the pose searched."""
        one, two, three, ids = np.zeros(0), np.zeros((0, 2)), np.zeros((0, 3)), np.zeros(0, np.int32)
        nothing = EdgeMatches(two, two, one, one, one, three, ids, ids)
        reason = Reason(why) if isinstance(why, str) else why
        return cls(unmeasured(world_from_part, np.eye(6)), nothing, 0.0, reason)

    @property
    def found(self) -> bool:
        """Return whether the part is where the pose says."""
        return self.quality >= FOUND

    @property
    def reason(self) -> str:
        """Return in one line why the pose is believed, or not."""
        return str(self.why)

    @property
    def amiss(self) -> str:
        """Return in words that model or camera may not be what was told; "" where the edges do not say so."""
        return f"edges are off by {self.off_px:.2f} px as a whole, {MORE_THAN_LIGHT}" if self.off_px else ""

    def doubts(self, freedom: Freedom) -> str:
        """Return what to ask where a part is not found, restricted to a freedom, in photos that are fit for use."""
        near = ", near enough to the start" if self.why.around_start else ""
        moves = "" if freedom.full else ", moved from there only as stated"
        return f"is it this part, this camera, not mirrored, all in view{near}{moves}?"

    def noting(self, note: str) -> Location:
        """Return the location with one more note to its reason."""
        return replace(self, why=self.why.noting(note))

    def numbered(self, photos: Sequence[int]) -> Location:
        """Return the location by some of several photos, numbered as they are among all."""
        number = np.array(photos, np.int32)
        return replace(
            self,
            matches=replace(self.matches, photo=number[self.matches.photo]),
            judged=replace(self.judged, photo=number[self.judged.photo]),
            disagreements=tuple(replace(one, photo=photos[one.photo]) for one in self.disagreements),
            alternatives=tuple(one.numbered(photos) for one in self.alternatives),
        )

    def uncertain(self, why: str, *, off_plane: bool = False) -> Location:
        """Return the location as not found, because its pose is not certain; why: in words, beside its own reason."""
        refused = self.why.refused(Refusal.NOT_CERTAIN, why, off_plane=off_plane)
        return replace(self, quality=min(self.quality, _UNCERTAIN), why=refused)

    @property
    def left_out(self) -> frozenset[int]:
        """Return the numbers of the photos that the pose ignores."""
        return frozenset(one.photo for one in self.disagreements if one.left_out)

    @property
    def disputed(self) -> bool:
        """Return whether the pose rests on photos that disagree."""
        return not all(one.left_out for one in self.disagreements)

    def __repr__(self) -> str:
        said = "found" if self.found else "not found"
        return f"Location({said}, quality {self.quality:.2f}, {self.pose}, {self.reason!r})"
