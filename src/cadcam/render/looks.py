"""Named looks, and custom colours for parts."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from types import MappingProxyType

import numpy as np

from cadcam.arrays import Picture, frozen
from cadcam.errors import BadValue, UnknownName
from cadcam.kinds import expect, expect_known, said
from cadcam.render.view import PLAIN, Look, Scene

Color = tuple[float, float, float]

LOOKS: Mapping[str, Look] = MappingProxyType(
    {
        "default": PLAIN,
        # Even: the brightness of a face shows only how far it is turned from the camera, and no face is dark.
        "inspection": Look(head=0.40, fill=0.0, back=0.0, ambient=0.60),
        # Each part in exactly its own colour: for masks and labels.
        "flat": Look(head=0.0, fill=0.0, back=0.0, ambient=1.0),
    }
)


def named_look(name: str) -> Look:
    """Return the look of a name in `LOOKS`: "default" (three lights), "inspection" or "flat"; or `UnknownName`."""
    expect_known(name, "look", LOOKS)
    return LOOKS[name]


def repaint(scene: Scene, chosen: Iterable[tuple[str, Color]]) -> Scene:
    """Return the scene with other colours for some parts: (name, RGB in [0, 1]) pairs; later ones take precedence.

    A name may be a pattern as for file names (`bolt*`, `rib_[0-9]`); one that matches no part is `UnknownName`, and
    what is no pair or no such colour `BadValue`.
    """
    expect(scene, "scene", Scene)
    colors, paint = scene.colors.copy(), scene.paint.copy()
    names = scene.mesh.part_names
    if not isinstance(chosen, Iterable) or getattr(chosen, "shape", None) == ():
        raise BadValue("chosen", said(chosen), "pairs such as [('bolt*', (1, 0, 0))]")
    for pattern, color in map(_checked, chosen):
        fitting = [i for i, name in enumerate(names) if name == pattern or fnmatchcase(name, pattern)]
        if not fitting:
            raise UnknownName("part", pattern, names)
        colors[fitting] = color
        painted = np.isin(scene.mesh.part, fitting)
        paint[painted] = scene.mesh.part[painted]
    return replace(scene, colors=colors, paint=paint)


def _checked(pair: object) -> tuple[str, Picture]:
    if not isinstance(pair, (tuple, list)) or len(pair) != 2 or not isinstance(pair[0], str):
        raise BadValue("part and colour", said(pair), "a pair such as ('bolt*', (1, 0, 0))")
    color = frozen(pair[1], f"colour of {pair[0]!r}", (3,), np.float32)
    if color.min() < 0 or color.max() > 1:
        raise BadValue(f"colour of {pair[0]!r}", color.tolist(), "RGB in [0, 1]: divide bytes by 255")
    return pair[0], color
