"""What a scene file asks for: features with their limits, and the datum that those which are parts are judged from."""

from __future__ import annotations

from functools import partial

from cadcam.cad.mesh import Mesh
from cadcam.files.jsontext import Place
from cadcam.plan.scene.feature import Kind, LayoutFeature
from cadcam.render.view import Scene
from cadcam.verify.tolerances.file import datum_at, limits_at, rule_at, selection_at
from cadcam.verify.tolerances.tolerance import Limit, Quantity, Rule, Selection

_OF_POINTS, _OF_PARTS = ("normal", "known_plane_mm"), ("chains", "box_mm", "kinds")
_OF_MARKS = (*_OF_POINTS, "diameter_mm")
_HAS = {"point_mm": _OF_POINTS, "circle_mm": _OF_MARKS, "edge_mm": (), "part": _OF_PARTS}  # beside those of limits
_FEATURE = (*_HAS, *_OF_PARTS, *_OF_MARKS, "k", "rule", "direction", "axis")
_JUDGED = (Quantity.POSITION, Quantity.ANGLE)  # what a layout is planned for


def features_at(place: Place, part: Mesh) -> tuple[LayoutFeature, ...]:
    """Return the features of a scene at its place. Raises `UnreadableFile` naming the key that is wrong."""
    listed = place.at("features")
    k = place.at("k").number() if "k" in place.object else 2.0
    rule = rule_at(place.at("rule")) if "rule" in place.object else Rule.GUARD_BAND
    scene = (
        Scene.of(part) if any("part" in (v if isinstance(v, dict) else {}) for v in listed.object.values()) else None
    )
    return tuple(_feature(listed.at(name), name, k, rule, scene) for name in listed.object)


def judged_from(place: Place, part: Mesh) -> tuple[Selection, ...]:
    """Return the datum of a scene at its place, none where it names none. Raises as `features_at`."""
    if "datum" not in place.object:
        return ()
    at = place.at("datum")
    datum = datum_at(at, without="then features are places in the world")
    for item, chosen in zip(at.items(), datum, strict=True):
        item.build(partial(chosen.among, part.part_names))
    return datum


def _feature(place: Place, name: str, k: float, rule: Rule, scene: Scene | None) -> LayoutFeature:
    place.only(*_FEATURE, *(q.value for q in _JUDGED))
    given = place.object
    what = [key for key in _HAS if key in given]
    if len(what) != 1:
        raise place.error(f"is {' and '.join(what) or 'nothing'}", f"give one of {', '.join(_HAS)}")
    for key in (*_OF_PARTS, *_OF_MARKS):
        if key in given and key not in _HAS[what[0]]:
            of = " and ".join(kind for kind, keys in _HAS.items() if key in keys)
            raise place.error(f"has {key} beside {what[0]}", f"leave it out: it has a meaning beside {of}")
    limits = limits_at(place, k, rule, _JUDGED)
    if scene is not None and what[0] == "part":
        selection: Selection = selection_at(place)
        return place.build(lambda: LayoutFeature.selected(name, selection, scene, limits))
    if what[0] == "edge_mm":
        return place.build(lambda: LayoutFeature.edge(name, place.at("edge_mm").array((2, 3)), limits))
    kind = Kind.CIRCLE if what[0] == "circle_mm" else Kind.POINT
    return place.build(lambda: _mark(place, name, kind, what[0], limits))


def _mark(place: Place, name: str, kind: Kind, key: str, limits: tuple[Limit, ...]) -> LayoutFeature:
    given = place.object
    return LayoutFeature(
        name,
        kind,
        place.at(key).array((3,)),
        limits,
        normal=place.at("normal").array((3,)) if "normal" in given else None,
        diameter_mm=place.at("diameter_mm").number() if "diameter_mm" in given else None,
        plane_mm=place.at("known_plane_mm").number() if "known_plane_mm" in given else None,
    )
