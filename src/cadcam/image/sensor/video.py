"""Effects on the signal: gain, gamma, edge enhancement, line jitter, quantization, compression.

Sections 5.1 and 5.3 of "Industrial Vision" (1997): what surveillance cameras do for the eye, and grabbers to lines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Picture
from cadcam.image.picture import decoded_jpeg, encoded
from cadcam.image.sensor.effect import check, in_rows
from cadcam.kinds import expect_count


@dataclass(frozen=True, slots=True)
class Gain:
    """I' = factor I + black: the amplifier, which amplifies noise as well (thesis 5.1, AGC); black: set-up level."""

    factor: float = 1.0
    black: float = 0.0

    def __post_init__(self) -> None:
        check("factor of the gain", self.factor, 0.0, above=True)
        check("black of the gain", self.black, 0.0, 0.5)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the amplified picture."""
        return np.asarray(picture * np.float32(self.factor) + np.float32(self.black), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Gamma:
    """I' = I^gamma with white at 1 (EQ 5.1); surveillance cameras have 0.6. Below black and above white it is straight.

    `undo` is EQ 5.2, the exponent 1/gamma: what a photo needs before grey values are averaged, as in blur or fits.
    """

    gamma: float = 1.0

    def __post_init__(self) -> None:
        check("gamma", self.gamma, 0.05, 20.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the bent picture."""
        return _bent(picture, self.gamma)

    def undo(self, picture: Picture) -> Picture:
        """Return the picture whose bent version this is: linear in radiance again (EQ 5.2)."""
        return _bent(picture, 1 / self.gamma)


def _bent(picture: Picture, exponent: float) -> Picture:
    out = np.zeros(picture.shape, np.float32)
    for rows in in_rows(picture):
        inside = np.clip(picture[rows], 0.0, 1.0)
        out[rows] = inside**exponent + (picture[rows] - inside)
    return out


@dataclass(frozen=True, slots=True)
class EdgeEnhancement:
    """I' = I + strength (I - Gauss(radius_px) * I): dark beside an edge is made darker, light lighter (thesis Fig 5-1).

    Along lines only, as analogue cameras do, or both ways (`vertical`).
    """

    strength: float = 0.0
    radius_px: float = 1.5
    vertical: bool = False

    def __post_init__(self) -> None:
        check("strength of the edge enhancement", self.strength, 0.0, 20.0)
        check("radius_px of the edge enhancement", self.radius_px, 0.1, 50.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture with over- and undershoot."""
        from scipy.ndimage import gaussian_filter1d

        soft = gaussian_filter1d(picture, self.radius_px, axis=1, mode="nearest", truncate=6.0)
        if self.vertical:
            soft = gaussian_filter1d(soft, self.radius_px, axis=0, mode="nearest", truncate=6.0)
        for rows in in_rows(picture):
            soft[rows] = picture[rows] + np.float32(self.strength) * (picture[rows] - soft[rows])
        return np.asarray(soft, dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Jitter:
    """Each line starts too early or late by a time drawn evenly from [-worst_ns, worst_ns]: x' = x + t/pixel_ns.

    pixel_ns: the time of a pixel: 67.7 ns of a CCIR line of 52 us visible in 768 px; thesis 5.3 has 90 ns, of lines
    that fill the field. Grabbers: 5 ns with a digital circuit, 8 to 10 ns with an analogue loop, 1 to 2 ns as sync
    master, under 1 ns on the camera's pixel clock (thesis 5.3).
    """

    worst_ns: float = 0.0
    pixel_ns: float = 52000.0 / 768

    def __post_init__(self) -> None:
        check("worst_ns of the jitter", self.worst_ns, 0.0)
        check("pixel_ns of the jitter", self.pixel_ns, 0.0, above=True)
        check("worst_ns of the jitter, in px,", self.worst_px, 0.0, 50.0)

    @property
    def worst_px(self) -> float:
        """Return the largest shift of a line in px; its standard deviation is that by the root of 3."""
        return self.worst_ns / self.pixel_ns

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture with every line shifted, between pixels by cubic splines."""
        from scipy.ndimage import map_coordinates

        by = rng.uniform(-self.worst_px, self.worst_px, len(picture))
        out = np.zeros(picture.shape, np.float32)
        deep = (*picture.shape[:2], -1)
        for plane, made in zip(
            np.moveaxis(picture.reshape(deep), 2, 0), np.moveaxis(out.reshape(deep), 2, 0), strict=True
        ):
            splined = _splined(plane)
            for rows in in_rows(splined):
                y, x = np.mgrid[rows, : picture.shape[1]].astype(np.float64)
                from_xy = [y, x - by[rows, None]]
                made[rows] = map_coordinates(splined, from_xy, order=3, prefilter=False, mode="nearest")
        return out


def _splined(plane: Picture) -> Picture:
    from scipy.ndimage import spline_filter

    return np.asarray(spline_filter(plane.astype(np.float64), order=3, mode="nearest"))


@dataclass(frozen=True, slots=True)
class Quantization:
    """I' = round(I (2^bits - 1))/(2^bits - 1), clipped to [0, 1] first."""

    bits: int = 8

    def __post_init__(self) -> None:
        expect_count(self.bits, "bits of the quantization", most=16)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture in steps."""
        steps = np.float32(2 ** int(self.bits) - 1)
        out: Picture = np.clip(picture, 0.0, 1.0, dtype=np.float32)
        out *= steps
        np.rint(out, out=out)
        out /= steps
        return out


@dataclass(frozen=True, slots=True)
class Jpeg:
    """The picture as it comes back from a JPEG file (ISO/IEC 10918-1) of this quality, colours at full size."""

    quality: int = 90

    def __post_init__(self) -> None:
        expect_count(self.quality, "quality of the JPEG", most=100)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture with the losses of blocks of 8 x 8 px."""
        return decoded_jpeg(encoded(picture, "JPEG", quality=int(self.quality)))
