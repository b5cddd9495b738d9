"""Deviations of edges and features from the CAD, in mm, each with the causes of its uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from cadcam.arrays import Array, Brief, brief
from cadcam.verify.adjustment.datum_fit import Estimate
from cadcam.verify.edges.presence import Presence


class State(Enum):
    """The state of a feature. UNCLEAR: its edges do not show where it is; OUT_OF_VIEW: nothing of it is visible.

    DATUM: the others are measured from it, and nothing else holds the pose that it could be compared with.
    """

    IN_PLACE = "in place"
    DISPLACED = "displaced"
    MISSING = "missing"
    UNCLEAR = "unclear"
    OUT_OF_VIEW = "out of view"
    DATUM = "datum"


class Unclear(Enum):
    """Why the photos do not show where a feature is, and the remedy."""

    UNSEEN = "none of its edges that should show is seen: is it there? else give more light, or light from another side"
    SHORT_EDGES = "its edges in view are too short to tell whether it is there: go closer, or take another view"
    SHOWN = "its surfaces show that it is there, but its edges are too short to tell where: go closer, or another view"
    DOUBTFUL = "too few of its edges that should show are seen to be sure that it is there: more light, or another view"
    CROWDED = "its edges lie within a few pixels of other lines: go closer, or take another view"
    FAINT = "its edges are too faint to be measured: give more light, or light from another side"
    WHITE = "the photo is white beside its edges: give less light, or expose it for a shorter time"
    ALONE = "a single line shows beside its place, which may be something else's: take another view"
    FOOT = "only the line on which it stands is measured, which need not move with it: take another view"
    LITTLE = "what is measured of its edges is too short to tell where it is: go closer, or take another view"
    POSE = "without it the pose is not known well enough: take more of the part into the picture"
    ALONE_IN_MODEL = "the model has no other part to compare it with: name some of its edges in a tolerance file"
    CALIBRATION = "the camera's calibration is too uncertain to tell: calibrate it better"
    ASTRAY = "its edges are off, but no more of them than a shadow or dirt may move: other light, or another view"
    CONTRADICTS = "what its edges tell contradicts itself: take another view"
    DISPUTED = "the photos disagree on where the part is: calibrate the rig anew, or see whether its cameras have moved"
    BEHIND = "something stands before it: take away what hides it, or take another view"
    FAR = "it seems to be farther from its place than was looked: look farther (--reach)"

    @property
    def remedy(self) -> str:
        """Return the remedy without the reason."""
        return self.value.rpartition(": ")[2]


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EdgeDeviation(Brief):
    """How far an edge lies from its place in the CAD, in one photo, with the pose fitted without it.

    value: signed mm along `direction` (3,), a unit vector in the part frame perpendicular to the edge and to the line
    of sight; sigma: its standard deviation, variances (4,) by `CAUSES`; nan where the photo shows no such edge. q (n,
    2) px: the model's places; p (3,) mm: their middle in the part frame; places: how many should be visible, seen: how
    many were; station (s, 7): along (px), deviation and sigma (mm) of pieces of the edge, and variances by `CAUSES`.
    features: those that hold places of it; of those that hold only some `held` has the stations of these.
    """

    part: str
    kind: str
    chain: int
    photo: int
    features: tuple[str, ...]
    value: float
    sigma: float
    variances: Array
    direction: Array
    p: Array
    q: Array
    mm_per_px: float
    places: int
    seen: int
    off: bool = False
    station: Array = field(default_factory=lambda: np.zeros((0, 7)))
    held: Mapping[str, Array] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Return which edge it is, in words."""
        return f"{self.kind} {self.chain} of {self.part}"

    def stations_of(self, feature: str) -> Array:
        """Return the stations (s, 7) of what a feature holds of the edge, (0, 7) where that is nothing."""
        return self.held.get(feature, self.station if feature in self.features else self.station[:0])


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class FeatureDeviation:
    """A feature as a rigid body: whether it is there, and its displacement relative to the datum.

    displacement: mm in the directions `seen` (3, m), orthonormal in the part frame; in others it is unknown. It is that
    of `p` (3,) mm, the middle of the places where the feature's edges are measured, should it turn as well. size: its
    length in mm, sigma: the standard deviation in the worst of the seen directions. turn, turn_sigma: rad about the
    line of sight `axis` (3,); nan where the edges do not determine it. p_value: probability of such a displacement for
    a feature in place. datum: whether the pose is fitted to it as well (but not for this result, which leaves its own
    edges out). why: of an unclear one, the reason.
    """

    name: str
    state: State
    presence: Presence
    seen: Array
    displacement: Estimate | None
    turn: float = float("nan")
    turn_sigma: float = float("nan")
    axis: Array = field(default_factory=lambda: np.zeros(3))
    p_value: float = float("nan")
    p: Array = field(default_factory=lambda: np.zeros(3))
    datum: bool = False
    why: Unclear | None = None

    @property
    def vector(self) -> Array:
        """Return the displacement (3,) mm in the part frame, zero in unseen directions; nan where unknown."""
        if self.displacement is None:
            return np.full(3, np.nan)
        return np.asarray(self.seen @ self.displacement.value)

    @property
    def size(self) -> float:
        """Return the displacement's length in mm."""
        return float(np.linalg.norm(self.vector))

    @property
    def sigma(self) -> float:
        """Return the standard deviation in mm in the worst of the seen directions."""
        if self.displacement is None:
            return float("nan")
        return float(np.sqrt(max(np.linalg.eigvalsh(self.displacement.covariance)[-1], 0.0)))

    @property
    def shares(self) -> dict[str, float]:
        """Return the share of each cause in the variance in that direction."""
        return {} if self.displacement is None else self.displacement.shares

    def disputed(self) -> FeatureDeviation:
        """Return what remains of it if photos disagree on the part's pose: whether it is there, but not where."""
        if self.state in (State.MISSING, State.OUT_OF_VIEW):
            return self
        return FeatureDeviation(
            self.name,
            State.UNCLEAR,
            self.presence,
            np.zeros((3, 0)),
            None,
            p=self.p,
            datum=self.datum,
            why=Unclear.DISPUTED,
        )

    def behind(self) -> FeatureDeviation:
        """Return it as one of which is not known where it is, because something before it hides it."""
        return replace(self, state=State.UNCLEAR, why=Unclear.BEHIND)

    def __repr__(self) -> str:
        off = f", {brief(self.vector)} mm, sigma {self.sigma:.2g} mm" if self.seen.size else ""
        return f"FeatureDeviation({self.name!r}, {self.state.value}{off})"


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Extra(Brief):
    """A curve in a photo, within the part's outline, that no edge of the model explains.

    q (n, 2) px; length_px; p (3,) mm: its middle projected onto the model's surface, nan beside it; near: the part
    there.
    """

    photo: int
    q: Array
    length_px: float
    p: Array
    near: str
