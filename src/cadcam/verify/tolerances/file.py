"""The tolerance file: YAML, lengths in mm and angles in degrees, as their keys say.

    k: 2                          # coverage factor of U = k sigma
    rule: guard band              # ISO 14253-1; or: simple acceptance
    datum:                        # what the pose is fitted to; without it: all that is not judged, or agrees
      - part: tank top
      - part: longitudinal *
    features:
      stiffener:
        part: bar 1.1 port
        position_mm: 0.8          # of the whole feature, in the directions that the photos show
        angle_deg: 0.2
        presence: required
      nose of the bracket:
        part: bracket 2.1 port
        box_mm: [[940, 590, 10], [1000, 603, 60]]
        kinds: [brep, contact]
        chains: [12, 13]
        direction: [0, 1, 0]      # position along this alone, in the part's axes; may be a zone, [-0.2, 0.5]
        profile_mm: 1             # the worst place along its edges
        k: 3
      hole:
        part: tank top
        chains: [40, 41]
        axis: [0, 0, 1]           # position across this alone: the zone is a cylinder about it
        position_mm: 0.2
        diameter_mm: [-0.1, 0.05] # from the CAD's, of circles about one axis; or: 0.1, to either side
      left edge:                  # without a limit of its own: the end of a distance
        part: tank top
        chains: [12]
    distances:
      hole to edge:
        between: [hole, left edge]
        distance_mm: [0, 0.2]     # from the CAD's; or: 0.2, to either side
        direction: [1, 0, 0]      # without it: from axis to axis of two holes or pins

A part may be a pattern (`longitudinal *`); what stands beside it narrows the choice.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Iterable, Mapping
from functools import partial
from typing import Any

import numpy as np

from cadcam.cad.edges import EdgeKind
from cadcam.errors import UnknownName
from cadcam.files.jsontext import Place, shortened
from cadcam.files.text import read_text
from cadcam.files.yamltext import parsed_yaml
from cadcam.kinds import expect_known, expect_names
from cadcam.render.view import Scene
from cadcam.verify.tolerances.tolerance import (
    SIGNED,
    Distance,
    Feature,
    Limit,
    Quantity,
    Rule,
    Selection,
    Tolerances,
)

_WHERE = ("part", "chains", "box_mm", "kinds")
_WAYS = {"direction": "a direction", "axis": "an axis"}  # of a position
_HOW = ("k", "rule", *_WAYS)
_OF_FEATURES = tuple(q for q in Quantity if q is not Quantity.DISTANCE)
_K, _LARGEST_WRITTEN_K = 2.0, 10.0  # what is larger, 95 or 99, is not meant as a number of sigmas
_OF_A_PART = (
    "    position_mm: 1.0    # of the whole feature; also: profile_mm (worst place along its edges), angle_deg",
    "    # diameter_mm: [-0.1, 0.05]        of a hole or pin, from the CAD's; or: 0.1, to either side",
    "    presence: required",
    "    # box_mm: [[x, y, z], [x, y, z]]   only edges in this region; chains: [...]; kinds: [brep, contact]",
    "    # direction: [0, 1, 0]             position along this alone; axis: [0, 0, 1] across it, as of a hole or pin",
)
_OF_EDGES = (  # of a part that is the datum: its other edges
    "    profile_mm: 1.0     # worst place along it; of several edges also: position_mm, angle_deg, presence: required",
    "    # box_mm: [[x, y, z], [x, y, z]]   edges in this region; kinds: [brep, contact]",
    "    # `cadcam verify MODEL --list PART` prints the numbers of all edges (chains)",
)
_OF_TWO = (
    "# distances:            # between two features named above, which then need no limit of their own",
    "#   a name: {between: [one, another], distance_mm: [-0.1, 0.1], direction: [1, 0, 0]}",
)
_DATUM = "write '- part: name' lines"
_WRITE_DISTANCE = "write name: {between: [one feature, another], distance_mm: 0.1}"
_WRITE = "write name: {part: ..., position_mm: ...}; `cadcam verify --template` writes a file to start from"


def read_tolerances(path: str | os.PathLike[str]) -> Tolerances:
    """Return the tolerances in a file. Raises `UnreadableFile` naming the key that is wrong and what is known."""
    file = read_text(path)
    place = parsed_yaml(file)
    place.only("k", "rule", "datum", "features", "distances")
    k = _coverage(place) if "k" in place.object else _K
    rule = rule_at(place.at("rule")) if "rule" in place.object else Rule.GUARD_BAND
    datum = datum_at(place.at("datum"), without="then it is all that is not judged") if "datum" in place.object else ()
    listed = _named(place.at("features"), "feature", _WRITE)
    distances = _distances(place.at("distances"), k, rule, listed.object) if "distances" in place.object else ()
    ends = {end for distance in distances for end in distance.between}
    features = tuple(_feature(name, listed.at(name), k, rule, end=name in ends) for name in listed.object)
    return place.build(lambda: Tolerances(features, datum, file.path, file.sha256, distances=distances))


def template(scene: Scene, *, seen: Iterable[str] = (), chain: int | None = None) -> str:
    """Return a file to start from: every part of the scene, the `seen` ones first (others as comments).

    Of a single part, which has to be the datum, an edge is judged: that of this `chain`, by default its longest.
    Raises `UnknownName` for what is seen but no part, `BadValue` for a chain that the part does not have.
    """
    names, seen = scene.mesh.part_names, expect_names(seen, "seen")
    for name in seen:
        expect_known(name, "part", names)
    chosen = [n for n in names if n in seen] if seen else list(names)
    part = chosen[-1] if chosen else names[-1]
    if len(chosen) == 1 and chain is None:
        chain = _longest_chain(scene, part)
    alone = (chain,) if len(chosen) == 1 and chain is not None else ()
    Selection(part, alone).check(scene)
    lines = [
        "# Tolerances for `cadcam verify`: lengths in mm, angles in degrees, in the part's own axes.",
        "k: 2                    # coverage factor of U = k sigma",
        "rule: guard band        # ISO 14253-1; or: simple acceptance",
        "datum:                  # what the pose is fitted to: keep what is known to be right",
        *(f"  - part: {quoted(name)}" for name in chosen),
        "features:               # what is judged: move it here from the datum, and set its limits",
        "  rename me:",
        f"    part: {quoted(part)}",
        *([f"    chains: {list(alone)}", *_OF_EDGES] if alone else _OF_A_PART),
    ]
    lines += [*_OF_TWO, *(f"# not in view: {name}" for name in names if name not in chosen)]
    return "\n".join(lines) + "\n"


def _longest_chain(scene: Scene, part: str) -> int | None:
    """Return the number of the longest edge of a part; None if it has only contours."""
    edges = scene.edges
    own = Selection(part).bodies(scene)[edges.part]
    length = np.bincount(edges.chain[own], edges.lengths(scene.mesh)[own])
    return int(length.argmax()) if len(length) else None


def quoted(name: str) -> str:
    """Return a name as YAML has it: plain where it can be, else in quotes; signs that cannot be seen as escapes."""
    halves = name.translate(dict.fromkeys(range(0xD800, 0xE000), "x"))  # of pairs: spelled out where they are written
    if not halves.isprintable():
        seen = (c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in name)
        return '"' + "".join(seen) + '"'
    safe = name.replace("_", "").replace(" ", "a").replace(".", "a").replace("-", "a").isalnum()
    word = name.lower() in ("true", "false", "null", "yes", "no", "on", "off")
    plain = safe and name[0].isalpha() and name == name.strip() and not word
    return name if plain else "'" + name.replace("'", "''") + "'"


def datum_at(place: Place, *, without: str) -> tuple[Selection, ...]:
    """Return the edges that the pose is fitted to; without: what follows where no datum is named."""
    items = place.items(_DATUM)
    if not items:
        raise place.error("names nothing", f"{_DATUM}, or leave it out: {without}")
    for item in items:
        if not isinstance(item.value, dict):
            raise item.error(f"is {shortened(item.value)}", _DATUM)
        item.only(*_WHERE)
    return tuple(selection_at(item) for item in items)


def _named(place: Place, what: str, write: str) -> Place:
    """Return a place that holds something under each of several names."""
    if not isinstance(place.value, dict) or not place.value:
        raise place.error(f"names no {what}", write)
    for name in place.value:
        if not name.strip() or not name.isprintable():
            raise place.error(f"names a {what} {shortened(name)}", "a name that can be read is expected")
    return place


def _feature(name: str, place: Place, k: float, rule: Rule, *, end: bool) -> Feature:
    """Return a feature; end: of a distance, so that it needs no limit of its own."""
    if not isinstance(place.value, dict):
        raise place.error(f"is {shortened(place.value)}", _WRITE)
    if Quantity.DISTANCE.value in place.value:
        raise place.at(Quantity.DISTANCE.value).error("is between two features", f"under distances, {_WRITE_DISTANCE}")
    place.only(*_WHERE, *_HOW, *(q.value for q in _OF_FEATURES))
    alone = end and place.value.keys() <= set(_WHERE)
    return Feature(name, selection_at(place), () if alone else limits_at(place, k, rule))


def _distances(place: Place, k: float, rule: Rule, features: Collection[str]) -> tuple[Distance, ...]:
    listed = _named(place, "distance", _WRITE_DISTANCE)
    return tuple(_distance(name, listed.at(name), k, rule, features) for name in listed.object)


def _distance(name: str, place: Place, k: float, rule: Rule, features: Collection[str]) -> Distance:
    if not isinstance(place.value, dict):
        raise place.error(f"is {shortened(place.value)}", _WRITE_DISTANCE)
    place.only("between", "direction", "k", "rule", Quantity.DISTANCE.value)
    between = [end.text() for end in place.at("between").items("the names of two features are expected")]
    for end in between:
        if end not in features:
            raise place.at("between").error(f"names an {UnknownName('feature', end, features)}")
    (limit,) = limits_at(place, k, rule, (Quantity.DISTANCE,))
    return place.build(lambda: Distance(name, between, limit))


def limits_at(place: Place, k: float, rule: Rule, of: Collection[Quantity] = _OF_FEATURES) -> tuple[Limit, ...]:
    """Return a feature's limits, of these quantities; k and rule are those of the file, which it may overrule."""
    k = _coverage(place) if "k" in place.object else k
    rule = rule_at(place.at("rule")) if "rule" in place.object else rule
    way = {name: place.at(name).array((3,)) for name in _WAYS if name in place.object}
    stated = [q for q in of if q.value in place.object]
    limits = tuple(place.build(partial(_limit, place.at(q.value), q, k, rule, way)) for q in stated)
    if not limits:
        beside = ", or name it in `distances`" if of is _OF_FEATURES else ""
        raise place.error("has no limit", f"give one of {', '.join(q.value for q in of)}{beside}")
    for name in way:
        if not {Quantity.POSITION, Quantity.DISTANCE} & set(stated):
            needs = f"it is that of a {Quantity.POSITION.value}: give one, or leave it out"
            raise place.error(f"has {_WAYS[name]}", needs)
    return limits


def _coverage(place: Place) -> float:
    k = place.at("k").number()
    if not 0 < k <= _LARGEST_WRITTEN_K:
        raise place.at("k").error(f"is {k:g}", f"a coverage factor up to {_LARGEST_WRITTEN_K:g} is expected, usually 2")
    return k


def _limit(place: Place, quantity: Quantity, k: float, rule: Rule, way: Mapping[str, Any]) -> Limit:
    if quantity is Quantity.PRESENCE:
        if place.value != "required" and place.value is not True:
            raise place.error(f"is {shortened(place.value)}", "write presence: required, or leave it out")
        return Limit(quantity, 0.0, k, rule)
    own = way if quantity in (Quantity.POSITION, Quantity.DISTANCE) else {}
    if isinstance(place.value, list) and (quantity in SIGNED or "direction" in own):
        low, high = place.array((2,))
        if not low < high:
            least = "the least and the greatest deviation in mm are expected, as [-0.1, 0.05]"
            raise place.error(f"is {place.value}", least)
        return Limit(quantity, float(high - low) / 2, k, rule, middle=float(low + high) / 2, **own)
    if isinstance(place.value, list) and quantity is Quantity.POSITION:
        raise place.error(f"is {place.value}", "a number is expected, or a direction beside it: a length has no sign")
    value = place.number()
    if quantity is Quantity.ANGLE:
        value = float(np.radians(value))
    return Limit(quantity, value, k, rule, **own)


def selection_at(place: Place) -> Selection:
    """Return which edges a feature or datum names."""
    given = place.object
    part = place.at("part").text() if "part" in given else "*"
    chains = tuple(c.whole() for c in _several(place, "chains", "numbers")) if "chains" in given else ()
    box = place.at("box_mm").array((2, 3)) if "box_mm" in given else None
    kinds = tuple(_kind(kind) for kind in _several(place, "kinds", "texts")) if "kinds" in given else ()
    if not given.keys() & set(_WHERE):
        raise place.error("does not say which edges", f"give one of {', '.join(_WHERE)}")
    return place.build(lambda: Selection(part, chains, box, kinds))


def _several(place: Place, key: str, what: str) -> list[Place]:
    """Return the places in a list that narrows a choice: an empty one would choose nothing."""
    items = place.at(key).items(f"a list of {what} is expected")
    if not items:
        raise place.at(key).error("is empty", "name what is meant, or leave it out")
    return items


def _kind(place: Place) -> EdgeKind:
    known, name = {kind.name.lower(): kind for kind in EdgeKind}, place.text()
    if name not in known:
        raise place.error(f"names an {UnknownName('kind of edge', name, known)}")
    return known[name]


def rule_at(place: Place) -> Rule:
    """Return a decision rule."""
    known = {rule.value: rule for rule in Rule}
    if place.text() not in known:
        raise place.error(f"is an {UnknownName('decision rule', place.text(), known)}")
    return known[place.text()]
