"""What a drawing asks of a part: features named by part, chain, region and kind of edge, and their limits.

The pose is fitted to the datum features; the others are judged relative to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from enum import Enum
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Floats, Longs, Mask, frozen
from cadcam.cad.edges import EdgeKind
from cadcam.errors import BadValue, CadcamError, UnknownName
from cadcam.geometry.box import clipped_to_box
from cadcam.geometry.plane import axes_across
from cadcam.kinds import FrozenMap, expect, expect_each, expect_known, expect_names, expect_numbers
from cadcam.render.view import Scene
from cadcam.verify.tolerances.circles import Circles
from cadcam.verify.tolerances.spacing import Spacing

LARGEST_K = 30.0  # sigmas: beyond them numbers hold no probability


class Rule(Enum):
    """How a deviation and its uncertainty decide: ISO 14253-1's guard band, or simple acceptance."""

    GUARD_BAND = "guard band"
    SIMPLE = "simple acceptance"


class Quantity(Enum):
    """What is limited. The value is its key in a tolerance file, with the unit."""

    POSITION = "position_mm"
    PROFILE = "profile_mm"
    DIAMETER = "diameter_mm"
    DISTANCE = "distance_mm"
    ANGLE = "angle_deg"
    PRESENCE = "presence"

    @property
    def unit(self) -> str:
        """Return the unit in which its limits are written."""
        return {Quantity.ANGLE: "deg", Quantity.PRESENCE: ""}.get(self, "mm")

    @property
    def per_unit(self) -> float:
        """Return the factor from mm or rad, used inside, to that unit."""
        return float(np.degrees(1.0)) if self is Quantity.ANGLE else 1.0


SIGNED = Quantity.DIAMETER, Quantity.DISTANCE  # whose zone may lie to one side of the CAD's own value
_WAYS = {"direction": (Quantity.POSITION, Quantity.DISTANCE), "axis": (Quantity.POSITION,)}


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Selection(Brief):
    """A selection of a part's edges: those of the bodies whose names fit `part`, narrowed by all other entries.

    part: a name or a pattern as for file names (`bar *`). chains: numbers of feature chains. box (2, 3) mm: lowest and
    highest corner, in the part frame, of a region; of an edge that it cuts, what lies in it belongs. kinds: kinds of
    edge. Raises `BadValue` for entries of another kind.
    """

    part: str = "*"
    chains: tuple[int, ...] = ()
    box: Array | None = None
    kinds: tuple[EdgeKind, ...] = ()

    def __post_init__(self) -> None:
        expect(self.part, "part of a selection", str)
        chains = frozen(self.chains, "chains", (None,), np.int64)
        object.__setattr__(self, "chains", tuple(chains.tolist()))
        object.__setattr__(self, "kinds", expect_each(self.kinds, "kinds", EdgeKind))
        if self.box is not None:
            box = frozen(self.box, "box_mm", (2, 3))
            if not (box[0] <= box[1]).all():
                raise BadValue("box_mm", box.tolist(), "[lowest corner, highest corner], x, y, z in mm")
            object.__setattr__(self, "box", box)

    @property
    def whole(self) -> bool:
        """Return whether all edges of its bodies belong."""
        return not self.chains and not self.kinds and self.box is None

    def bodies(self, scene: Scene) -> Mask:
        """Return which of the scene's parts (P,) are selected; raise `UnknownName` listing them where none is."""
        return self.among(scene.mesh.part_names)

    def among(self, names: Sequence[str]) -> Mask:
        """Return which of the names (P,) of parts are selected; raise `UnknownName` listing them where none is.

        What is the name of a part is no pattern: "plate [2]" is not "plate 2", too.
        """
        exact = self.part in names
        meant = np.array([name == self.part if exact else fnmatchcase(name, self.part) for name in names], bool)
        if not meant.any():
            raise UnknownName("part", self.part, names)
        return meant

    def check(self, scene: Scene) -> None:
        """Raise an error that lists the existing names where the scene has no such edge at all."""
        bodies = self.bodies(scene)
        if self.whole:
            return
        edges = scene.edges
        own = bodies[edges.part]
        chains = np.unique(edges.chain[own])
        for chain in self.chains:
            if chain not in chains:
                raise BadValue(f"chain of {self.part!r}", chain, f"one of {runs(chains)}")
        curved = (EdgeKind.CONTOUR in self.kinds or not self.kinds) and self._meets(scene)
        if not curved and not self.segments(scene)[0].any():
            kinds = ", ".join(EdgeKind(k).name.lower() for k in np.unique(edges.kind[own]))
            at = scene.mesh.vertices[edges.vertices[own]].reshape(-1, 3)
            low, high = at.min(axis=0).round(1).tolist(), at.max(axis=0).round(1).tolist()
            raise BadValue(
                f"choice of edges of {self.part!r}", "empty", f"a box_mm within {low} to {high}, kinds among {kinds}"
            )

    def _meets(self, scene: Scene) -> bool:
        """Return whether the bodies reach into the box, where they may have contours of curved surfaces."""
        if self.chains:
            return False
        used = scene.mesh.faces[self.bodies(scene)[scene.mesh.part]]
        return self.box is None or bool(_inside(scene.mesh.vertices[used].reshape(-1, 3), self.box).any())

    def holds(
        self,
        part: npt.NDArray[np.int32],
        chain: npt.NDArray[np.int32],
        kind: npt.NDArray[np.int32],
        p: Array,
        bodies: Mask,
    ) -> Mask:
        """Return which places (N,) belong, p (N, 3) mm in the part frame; bodies as `bodies(scene)` gives them."""
        out = bodies[part]
        if self.chains:
            out = out & np.isin(chain, self.chains)
        if self.kinds:
            out = out & np.isin(kind, self.kinds)
        return out if self.box is None else out & _inside(p, self.box)

    def segments(self, scene: Scene) -> tuple[Mask, Array]:
        """Return which edges (E,) of the scene are chosen, and the ends (E, 2, 3) mm of what the box holds of each."""
        edges, bodies = scene.edges, self.bodies(scene)
        ends = scene.mesh.vertices[edges.vertices]
        chosen = replace(self, box=None).holds(edges.part, edges.chain, edges.kind, ends[:, 0], bodies)
        if self.box is None:
            return chosen, ends
        inside, ends = clipped_to_box(ends, self.box)
        return chosen & inside, ends

    def polylines(self, scene: Scene, by: Array | None = None) -> tuple[Longs, list[Array]]:
        """Return the numbers (c,) of the feature chains chosen, and the edges (n, 3) mm as they lie in the scene.

        by (P, 3) mm: how far the scene's parts are from where the CAD has them, by default not at all.
        """
        edges, points = scene.edges, scene.mesh.vertices
        middle = points[edges.vertices].mean(axis=1) - (0.0 if by is None else by[edges.part])
        chosen = self.holds(edges.part, edges.chain, edges.kind, middle, self.bodies(scene))
        return np.unique(edges.chain[chosen]).astype(np.int64), edges.select(chosen).polylines(scene.mesh)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Limit(Brief):
    """The largest deviation of one quantity (mm; rad for an angle; unused for presence), and the decision rule.

    middle: of the zone of a diameter or distance, in mm from the CAD's, from which deviations are told: the value is
    half its width.

    direction: unit vector in the part frame along which alone a position or distance counts; axis: that across which
    alone a position does, ISO 1101's cylindrical zone. None: all that the photos show.
    """

    quantity: Quantity
    value: float
    k: float = 2.0
    rule: Rule = Rule.GUARD_BAND
    direction: Array | None = None
    axis: Array | None = None
    middle: float = 0.0

    def __post_init__(self) -> None:
        expect(self.quantity, "quantity", Quantity)
        expect(self.rule, "rule", Rule)
        expect_numbers(self)
        if self.quantity is not Quantity.PRESENCE and not (np.isfinite(self.value) and self.value > 0):
            raise BadValue(self.quantity.value, self.value, "a positive number")
        if self.quantity is Quantity.ANGLE and self.value >= np.pi:
            raise BadValue(self.quantity.value, np.degrees(self.value), "less than 180: no turn is larger")
        if self.middle and not (self.quantity in SIGNED or self.direction is not None):
            has_one = f"only {' and '.join(q.value for q in SIGNED)} have one, and a position along a direction"
            raise BadValue("middle of a zone", f"that of {self.quantity.value}", f"0: {has_one}")
        if not 0 < self.k <= LARGEST_K:
            raise BadValue("coverage factor k", self.k, f"a positive number up to {LARGEST_K:g}, usually 2")
        if self.direction is not None and self.axis is not None:
            raise BadValue("direction", "given beside an axis", "one of them: a position counts along it, or across it")
        for name, of in _WAYS.items():
            given = getattr(self, name)
            if given is None:
                continue
            if self.quantity not in of:
                has_one = " or ".join(q.value for q in of)
                raise BadValue(name, f"that of {self.quantity.value}", f"none: it is that of {has_one}")
            d = frozen(given, name, (3,))
            if not np.linalg.norm(d) > 0:
                raise BadValue(name, d.tolist(), "a vector that is not zero")
            object.__setattr__(self, name, frozen(d / np.linalg.norm(d), name, (3,)))

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest deviation from the CAD that keep the limit."""
        return self.middle - self.value, self.middle + self.value

    @property
    def of_length(self) -> bool:
        """Return whether it limits a length, which is never negative: of a displacement along no one direction."""
        return self.quantity is Quantity.POSITION and self.direction is None

    @property
    def basis(self) -> Array | None:
        """Return the orthonormal directions (3, k) in which alone a position counts; None: all that the photos show."""
        if self.direction is not None:
            return self.direction[:, None]
        return None if self.axis is None else np.stack(axes_across(self.axis), axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Feature:
    """A piece of the part that moves as one, and what is asked of it. Raises `BadValue` for entries of another kind."""

    name: str
    selection: Selection
    limits: tuple[Limit, ...] = ()

    def __post_init__(self) -> None:
        expect(self.name, "name of a feature", str)
        expect(self.selection, f"selection of feature {self.name!r}", Selection)
        object.__setattr__(self, "limits", expect_each(self.limits, f"limits of feature {self.name!r}", Limit))
        if any(limit.quantity is Quantity.DISTANCE for limit in self.limits):
            raise BadValue(
                f"limits of feature {self.name!r}", Quantity.DISTANCE.value, "a Distance: it has two features"
            )

    def circles(self, scene: Scene, by: Array | None = None, *, sized: bool = False) -> Circles | None:
        """Return the circles that it is, if their diameter is asked, their place across an axis, or they are `sized`.

        None otherwise, or where it is no circles about one axis: of which `BadValue` is raised if a diameter is asked.
        by: as of `Selection.polylines`.
        """
        asked = any(limit.quantity is Quantity.DIAMETER for limit in self.limits)
        if not (asked or sized or any(limit.axis is not None for limit in self.limits)):
            return None
        chains, lines = self.selection.polylines(scene, by)
        found = Circles.through(lines)
        if found is None and asked:
            raise BadValue(
                Quantity.DIAMETER.value,
                f"asked of edges {runs(chains) or 'contours alone'}",
                "arcs of circles about one axis, as of a hole or a pin",
            )
        return found


@dataclass(frozen=True, slots=True, eq=False)
class Distance:
    """A distance between two features, by their names, and the limit of its deviation from the CAD's.

    It counts along the limit's direction; without one straight from axis to axis of circles. Raises `BadValue` for
    entries of another kind.
    """

    name: str
    between: Sequence[str]
    limit: Limit

    def __post_init__(self) -> None:
        expect(self.name, "name of a distance", str)
        expect(self.limit, f"limit of distance {self.name!r}", Limit)
        if self.limit.quantity is not Quantity.DISTANCE:
            raise BadValue(f"limit of distance {self.name!r}", self.limit.quantity.value, Quantity.DISTANCE.value)
        between = expect_names(self.between, f"between of distance {self.name!r}")
        if len(set(between)) != 2 or len(between) != 2:
            raise BadValue(f"between of distance {self.name!r}", list(between), "the names of two features")
        object.__setattr__(self, "between", tuple(between))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tolerances(Brief):
    """Features with their limits, the datum that the pose is fitted to, and distances between features.

    An empty datum is everything that is not judged; where every part is, those that agree with each other.
    """

    features: tuple[Feature, ...] = ()
    datum: tuple[Selection, ...] = ()
    source: str = ""
    sha256: str = ""
    notes: Mapping[str, str] = field(default_factory=FrozenMap)
    distances: tuple[Distance, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "features", expect_each(self.features, "features", Feature))
        object.__setattr__(self, "datum", expect_each(self.datum, "datum", Selection))
        expect(self.notes, "notes", Mapping)
        object.__setattr__(self, "notes", FrozenMap(self.notes))
        object.__setattr__(self, "distances", expect_each(self.distances, "distances", Distance))
        features = [f.name for f in self.features]
        names = [*features, *(d.name for d in self.distances)]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise BadValue("feature", f"named twice: {twice!r}", "a name of its own for each")
        for end in (end for d in self.distances for end in d.between):
            expect_known(end, "feature", features)

    @property
    def judged(self) -> tuple[Feature, ...]:
        """Return the features of which something is asked: those with limits, and those between which distances are."""
        ends = {end for d in self.distances for end in d.between}
        return tuple(f for f in self.features if f.limits or f.name in ends)

    def circles(self, scene: Scene, by: Array | None = None) -> tuple[Circles | None, ...]:
        """Return for each feature the circles that may be of another size: of a diameter, about an axis, of a distance.

        by: as of `Selection.polylines`. Raises `BadValue` where a diameter is asked of what is no circle.
        """
        ends = {end for d in self.distances for end in d.between}
        return tuple(f.circles(scene, by, sized=f.name in ends) for f in self.features)

    def spacing(self, distance: Distance, scene: Scene) -> Spacing:
        """Return the way, and the CAD's distance, between two features; raise `BadValue` where they have none."""
        ends = [next(f for f in self.features if f.name == name) for name in distance.between]
        (a, first), (b, second) = (f.selection.polylines(scene) for f in ends)
        if shared := sorted({*a.tolist()} & {*b.tolist()}):
            raise BadValue("between", f"two features that share edges {runs(np.array(shared))}", "edges of their own")
        return Spacing.between(first, second, distance.limit.direction)

    def check(self, scene: Scene) -> None:
        """Raise an error as `check_names`, or where a selection that narrows its parts holds none of their edges.

        Raise `BadValue`, too, where a diameter is asked of edges that are no circles about one axis.
        """
        self.check_names(scene.mesh.part_names)
        for where, chosen in self._selections():
            with _told(where):
                chosen.check(scene)
        for feature in self.features:
            with _told(f"feature {feature.name!r}"):
                feature.circles(scene)
        for distance in self.distances:
            with _told(f"distance {distance.name!r}"):
                self.spacing(distance, scene)

    def check_names(self, names: Sequence[str]) -> None:
        """Raise an error that lists the names of a model's parts, for the first name that is none of them.

        Raise one, too, where nothing is left that the pose could be fitted to, because all of it is judged. The names
        are known as soon as a model is read, its edges in large ones much later.
        """
        for where, chosen in self._selections():
            with _told(where):
                chosen.among(names)
        self._check_what_is_left(names)

    def _selections(self) -> list[tuple[str, Selection]]:
        """Return all selections, each with where it stands."""
        datum = [(f"datum {i}", chosen) for i, chosen in enumerate(self.datum)]
        return [*datum, *((f"feature {f.name!r}", f.selection) for f in self.features)]

    def judge_every_part(self, names: Sequence[str]) -> bool:
        """Return whether each of the names of parts is judged as a whole: then no other is left to measure from."""
        judged = [f.selection.among(names) for f in self.judged if f.selection.whole]
        return bool(judged) and bool(np.any(judged, axis=0).all())

    def _check_what_is_left(self, names: Sequence[str]) -> None:
        """Raise `BadValue` where whole bodies that are judged are all that the pose may be fitted to."""
        judged = [(f, f.selection.among(names)) for f in self.features if f.limits and f.selection.whole]
        datum = np.any([chosen.among(names) for chosen in self.datum], axis=0) if self.datum else np.array(True)
        for f, bodies in judged:
            placed = any(limit.quantity is not Quantity.PRESENCE for limit in f.limits)
            if placed and not (datum & ~bodies).any():
                raise BadValue("datum", f"all within feature {f.name!r}", "parts beside it: it is measured from them")


@contextmanager
def _told(where: str) -> Iterator[None]:
    """Let errors say where the selection stands that they are about."""
    try:
        yield
    except CadcamError as error:
        error.args = (f"{where}: {error}",)
        raise


def whole_parts(scene: Scene) -> Tolerances:
    """Return every part of the scene as a feature without limits, so that displaced or missing ones are reported."""
    expect(scene, "scene", Scene)
    return Tolerances(tuple(Feature(name, Selection(name)) for name in scene.mesh.part_names))


def runs(numbers: Floats) -> str:
    """Return sorted whole numbers as text with runs shortened: 3 to 7, 9, 12 to 14."""
    n = np.asarray(numbers, np.int64)
    pieces = np.split(n, np.flatnonzero(np.diff(n) > 1) + 1) if len(n) else []
    return ", ".join(f"{p[0]} to {p[-1]}" if len(p) > 2 else ", ".join(map(str, p.tolist())) for p in pieces)


def _inside(p: Array, box: Array) -> Mask:
    return np.asarray(((p >= box[0]) & (p <= box[1])).all(axis=1))
