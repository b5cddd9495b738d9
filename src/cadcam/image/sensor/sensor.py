"""A sensor: the effects that turn a scene's radiance into the grey levels of a file, in the order in which they happen.

    light   vignetting, blur, motion, interlace, pixel_aspect
    charge  exposure, smear, blooming, noise
    signal  gain, gamma, edge_enhancement, jitter, quantization, jpeg

Every effect that is None is left out. Radiance is linear: 1 is what gives white at exposure 1 and gain 1.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from cadcam.arrays import Picture
from cadcam.image.picture import checked
from cadcam.image.sensor.charge import Blooming, Exposure, Noise, Smear
from cadcam.image.sensor.effect import Effect
from cadcam.image.sensor.light import Blur, Interlace, Motion, PixelAspect, Vignetting
from cadcam.image.sensor.video import EdgeEnhancement, Gain, Gamma, Jitter, Jpeg, Quantization
from cadcam.kinds import expect


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """A named profile: one value, or None, for each effect."""

    name: str = "ideal"
    vignetting: Vignetting | None = None
    blur: Blur | None = None
    motion: Motion | None = None
    interlace: Interlace | None = None
    pixel_aspect: PixelAspect | None = None
    exposure: Exposure | None = None
    smear: Smear | None = None
    blooming: Blooming | None = None
    noise: Noise | None = None
    gain: Gain | None = None
    gamma: Gamma | None = None
    edge_enhancement: EdgeEnhancement | None = None
    jitter: Jitter | None = None
    quantization: Quantization | None = None
    jpeg: Jpeg | None = None

    def __post_init__(self) -> None:
        for name, effect in EFFECTS.items():
            expect(getattr(self, name), name, effect, optional=True)

    @property
    def effects(self) -> dict[str, Effect]:
        """Return the effects that are there by their names, in the order in which they act."""
        named = {f.name: getattr(self, f.name) for f in fields(self) if f.name != "name"}
        return {name: effect for name, effect in named.items() if effect is not None}

    def apply(self, radiance: npt.ArrayLike, *, rng: np.random.Generator) -> Picture:
        """Return the picture in [0, 1] that the sensor makes of radiance (H, W) or (H, W, 3), both linear at 1 = white.

        Each effect draws from a stream of its own: one effect more or less leaves the others' noise as it is. Another
        picture size comes back only with `pixel_aspect`. Raises `BadValue` for what is no picture.
        """
        expect(rng, "rng", np.random.Generator)
        streams = dict(zip(EFFECTS, rng.spawn(len(EFFECTS)), strict=True))
        picture = given = checked(radiance)
        for name, effect in self.effects.items():
            picture = effect.apply(picture, streams[name])
        own = None if np.may_share_memory(picture, given) else picture
        return np.clip(picture, np.float32(0.0), np.float32(1.0), out=own)


EFFECTS: dict[str, type[Effect]] = {
    "vignetting": Vignetting,
    "blur": Blur,
    "motion": Motion,
    "interlace": Interlace,
    "pixel_aspect": PixelAspect,
    "exposure": Exposure,
    "smear": Smear,
    "blooming": Blooming,
    "noise": Noise,
    "gain": Gain,
    "gamma": Gamma,
    "edge_enhancement": EdgeEnhancement,
    "jitter": Jitter,
    "quantization": Quantization,
    "jpeg": Jpeg,
}
"""Every effect by its name in a profile, in the order in which they act."""
