"""Light on a scene for photographs: distant lamps that cast shadows, a flash at the camera, and ambient light.

A matt surface of reflectance c has the radiance c (ambient + flash cos(f) + sum of strength cos(l) times the visible
share of the lamp): linear, 1 being white at exposure 1. Lamps are fixed in the world, the flash moves with the camera.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from cadcam.arrays import Array
from cadcam.errors import BadValue
from cadcam.kinds import expect_each, expect_known, expect_numbers, expect_positive


@dataclass(frozen=True, slots=True)
class Lamp:
    """A distant round lamp in the direction `towards`, in the world's frame.

    strength: the radiance of a white surface that faces it. size_deg: its angular diameter, which softens shadows.
    """

    towards: tuple[float, float, float]
    strength: float
    size_deg: float = 0.0

    def __post_init__(self) -> None:
        expect_numbers(self)
        if len(self.towards) != 3 or not 0 < sum(x * x for x in self.towards) < float("inf"):
            raise BadValue("direction towards the lamp", self.towards, "a direction (x, y, z), not zero")
        expect_positive(self.strength, "strength of the lamp", "a number of at least 0", zero=True)
        if not 0 <= self.size_deg <= 90:
            raise BadValue("size_deg of the lamp", self.size_deg, "degrees from 0 to 90")

    def direction(self, u: float, v: float) -> Array:
        """Return the unit direction (3,) towards the point (u, v) of the lamp's unit disc; (0, 0): its middle."""
        along = np.array(self.towards) / np.linalg.norm(self.towards)
        aside = np.eye(3)[np.argmin(np.abs(along))]
        x = np.cross(along, aside)
        x /= np.linalg.norm(x)
        reach = np.tan(np.radians(self.size_deg) / 2)
        to = along + reach * (u * x + v * np.cross(along, x))
        return np.asarray(to / np.linalg.norm(to))


@dataclass(frozen=True, slots=True)
class Light:
    """All light on a scene: `lamps`, a flash round the camera's lens, and `ambient` light from all directions."""

    lamps: tuple[Lamp, ...] = ()
    flash: float = 0.0
    ambient: float = 0.0

    def __post_init__(self) -> None:
        expect_numbers(self)
        object.__setattr__(self, "lamps", expect_each(self.lamps, "lamps", Lamp))
        expect_positive(self.flash, "strength of the flash", "a number of at least 0", zero=True)
        expect_positive(self.ambient, "ambient light", "a number of at least 0", zero=True)


# Z is up in all of them, as in `standard_view`
LIGHTS: Mapping[str, Light] = MappingProxyType(
    {
        # one lamp under the roof, as wide as those of a lit hall together, and the light reflected by walls and floor
        "hall": Light((Lamp((0.35, -0.55, 1.0), 0.65, 12.0), Lamp((-0.8, 0.3, 0.5), 0.15, 40.0)), ambient=0.25),
        "sun": Light((Lamp((0.6, -0.45, 0.8), 0.85, 0.53),), ambient=0.13),  # half a degree wide, and the sky
        "ring": Light(flash=0.85, ambient=0.10),  # a ring light round the lens: no shadow that the camera sees
        "even": Light(ambient=1.0),  # each part in its own colour
    }
)


def named_light(name: str) -> Light:
    """Return the light of a name in `LIGHTS`: "hall", "sun", "ring" or "even"; `UnknownName` otherwise."""
    expect_known(name, "light", LIGHTS)
    return LIGHTS[name]
