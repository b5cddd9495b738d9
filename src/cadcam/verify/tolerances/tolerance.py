"""What a drawing asks of a part: features named by part, chain, region and kind of edge, and their limits.

The pose is fitted to the datum features; the others are judged relative to it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from fnmatch import fnmatchcase

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Array, Brief, Floats, Mask, frozen
from cadcam.cad.edges import EdgeKind
from cadcam.errors import BadValue, CadcamError, UnknownName
from cadcam.geometry.plane import axes_across
from cadcam.kinds import FrozenMap, expect, expect_each, expect_numbers
from cadcam.render.view import Scene
from cadcam.verify.tolerances.circles import Circles

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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Selection(Brief):
    """A selection of a part's edges: those of the bodies whose names fit `part`, narrowed by all other entries.

    part: a name or a pattern as for file names (`bar *`). chains: numbers of feature chains. box (2, 3) mm: lowest and
    highest corner, in the part frame, of the region in which an edge must lie. kinds: kinds of edge. Raises `BadValue`
    for entries of another kind.
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
        """Return which of the names (P,) of parts are selected; raise `UnknownName` listing them where none is."""
        meant = np.array([name == self.part or fnmatchcase(name, self.part) for name in names], bool)
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
        at = scene.mesh.vertices[edges.vertices].mean(axis=1)
        curved = (EdgeKind.CONTOUR in self.kinds or not self.kinds) and self._meets(scene)
        if not curved and not self.holds(edges.part, edges.chain, edges.kind, at, bodies).any():
            kinds = ", ".join(EdgeKind(k).name.lower() for k in np.unique(edges.kind[own]))
            low, high = at[own].min(axis=0).round(1).tolist(), at[own].max(axis=0).round(1).tolist()
            raise BadValue(
                f"edges of {self.part!r}", "none chosen", f"a box_mm within {low} to {high}, kinds among {kinds}"
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


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Limit(Brief):
    """The largest deviation of one quantity (mm; rad for an angle; unused for presence), and the decision rule.

    middle: of a diameter's zone, in mm from the CAD's, from which deviations are told: the value is half its width.

    direction: unit vector in the part frame along which alone a position counts; axis: that across which alone it does,
    ISO 1101's cylindrical zone. None: all that the photos show.
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
        signed = self.quantity is Quantity.DIAMETER or self.direction is not None
        if self.middle and not signed:
            has_one = f"only {Quantity.DIAMETER.value} has one, and a position along a direction"
            raise BadValue("middle of a zone", f"that of {self.quantity.value}", f"0: {has_one}")
        if not 0 < self.k <= LARGEST_K:
            raise BadValue("coverage factor k", self.k, f"a positive number up to {LARGEST_K:g}, usually 2")
        if self.direction is not None and self.axis is not None:
            raise BadValue("direction", "given beside an axis", "one of them: a position counts along it, or across it")
        for name in ("direction", "axis"):
            given = getattr(self, name)
            if given is None:
                continue
            if self.quantity is not Quantity.POSITION:
                raise BadValue(name, f"that of {self.quantity.value}", f"none: it is that of {Quantity.POSITION.value}")
            d = frozen(given, name, (3,))
            if not np.linalg.norm(d) > 0:
                raise BadValue(name, d.tolist(), "a vector that is not zero")
            object.__setattr__(self, name, frozen(d / np.linalg.norm(d), name, (3,)))

    @property
    def bounds(self) -> tuple[float, float]:
        """Return the least and the greatest deviation from the CAD that keep the limit."""
        return self.middle - self.value, self.middle + self.value

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

    def circles(self, scene: Scene, by: Array | None = None) -> Circles | None:
        """Return the circles of which a diameter is asked, None where none is; raise `BadValue` for edges on none.

        by (P, 3) mm: how far the scene's parts are from where the CAD has them, by default not at all.
        """
        if all(limit.quantity is not Quantity.DIAMETER for limit in self.limits):
            return None
        edges, points = scene.edges, scene.mesh.vertices
        middle = points[edges.vertices].mean(axis=1) - (0.0 if by is None else by[edges.part])
        chosen = self.selection.holds(edges.part, edges.chain, edges.kind, middle, self.selection.bodies(scene))
        found = Circles.through(edges.select(chosen).polylines(scene.mesh))
        if found is None:
            chains = runs(np.unique(edges.chain[chosen])) or "contours alone"
            raise BadValue(
                Quantity.DIAMETER.value,
                f"asked of edges {chains}",
                "arcs of circles about one axis, as of a hole or a pin",
            )
        return found


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Tolerances(Brief):
    """Features with their limits, and the datum that the pose is fitted to.

    An empty one is everything that is not judged; where every part is, those that agree with each other.
    """

    features: tuple[Feature, ...] = ()
    datum: tuple[Selection, ...] = ()
    source: str = ""
    sha256: str = ""
    notes: Mapping[str, str] = field(default_factory=FrozenMap)

    def __post_init__(self) -> None:
        object.__setattr__(self, "features", expect_each(self.features, "features", Feature))
        object.__setattr__(self, "datum", expect_each(self.datum, "datum", Selection))
        expect(self.notes, "notes", Mapping)
        object.__setattr__(self, "notes", FrozenMap(self.notes))
        names = [f.name for f in self.features]
        twice = next((n for n in names if names.count(n) > 1), None)
        if twice is not None:
            raise BadValue("feature", f"named twice: {twice!r}", "a name of its own for each")

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
        judged = [f.selection.among(names) for f in self.features if f.limits and f.selection.whole]
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
    return Tolerances(tuple(Feature(name, Selection(_literal(name))) for name in scene.mesh.part_names))


def runs(numbers: Floats) -> str:
    """Return sorted whole numbers as text with runs shortened: 3 to 7, 9, 12 to 14."""
    n = np.asarray(numbers, np.int64)
    pieces = np.split(n, np.flatnonzero(np.diff(n) > 1) + 1) if len(n) else []
    return ", ".join(f"{p[0]} to {p[-1]}" if len(p) > 2 else ", ".join(map(str, p.tolist())) for p in pieces)


def _literal(name: str) -> str:
    """Return the pattern that fits only this name, whatever characters it contains."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _inside(p: Array, box: Array) -> Mask:
    return np.asarray(((p >= box[0]) & (p <= box[1])).all(axis=1))
