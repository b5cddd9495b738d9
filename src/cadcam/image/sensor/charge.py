"""Effects on the charge: exposure, light smeared into other rows while it is carried away, full wells, noise.

Charge is counted in units of the full scale: 1 is the well that gives white at a gain of 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cadcam.arrays import Array, Picture
from cadcam.image.sensor.effect import check, in_columns, in_rows

_POISSON_E = 1000.0  # electrons below which Poisson's distribution is drawn as it is


@dataclass(frozen=True, slots=True)
class Exposure:
    """I' = factor I: shutter time and aperture together, by those that make a radiance of 1 white."""

    factor: float = 1.0

    def __post_init__(self) -> None:
        check("factor of the exposure", self.factor, 0.0, above=True)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture so exposed."""
        return np.asarray(picture * np.float32(self.factor), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Smear:
    """I' = I + fraction * (mean of I along the column): light that falls in while rows are carried along the column.

    fraction: the time a charge travels over the whole column by the exposure time. It grows as the shutter gets short
    (thesis 5.1, auto shutter).
    """

    fraction: float = 0.0

    def __post_init__(self) -> None:
        check("fraction of the smear", self.fraction, 0.0, 1.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture with light streaks above and below what is bright."""
        return np.asarray(picture + np.float32(self.fraction) * picture.mean(axis=0, keepdims=True), dtype=np.float32)


@dataclass(frozen=True, slots=True)
class Blooming:
    """What a pixel cannot hold flows half up, half down its column into what has room; at the border it is lost.

    full_well: what a pixel holds. drained: the share of the excess that an overflow drain takes away.
    """

    full_well: float = 1.0
    drained: float = 0.0

    def __post_init__(self) -> None:
        check("full_well of the blooming", self.full_well, 0.0, above=True)
        check("drained of the blooming", self.drained, 0.0, 1.0)

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the picture with overflowing columns; no pixel holds more than the well."""
        if not any((picture[rows] > self.full_well).any() for rows in in_rows(picture)):
            return picture
        out = np.zeros(picture.shape, np.float32)
        for columns in in_columns(picture):
            excess = np.maximum(picture[:, columns] - self.full_well, 0.0).astype(np.float64)
            charge = np.minimum(picture[:, columns], self.full_well).astype(np.float64)
            half = excess * ((1 - self.drained) / 2)
            _flow(charge, half, self.full_well)
            _flow(charge[::-1], half[::-1], self.full_well)
            out[:, columns] = charge
        return out


def _flow(charge: Array, excess: Array, well: float) -> None:
    """Let each row's excess flow on into the rows after it, in place."""
    flowing = np.zeros_like(charge[0])
    for row, extra in zip(charge, excess, strict=True):
        taken = np.minimum(flowing, well - row)
        row += taken
        flowing += extra - taken


@dataclass(frozen=True, slots=True)
class Noise:
    """n = Poisson(I N) + normal(0, read_e) electrons, I' = n/N, with N = full_well_e: var I' = I/N + (read_e/N)^2.

    Shot noise of the light and read noise of the amplifier (the linear model of EMVA 1288). From 1000 electrons on the
    Poisson distribution is drawn as a normal one, whose skewness of 3 % nobody sees.
    """

    full_well_e: float = 20000.0
    read_e: float = 0.0

    def __post_init__(self) -> None:
        check("full_well_e of the noise", self.full_well_e, 1.0)
        check("read_e of the noise", self.read_e, 0.0)

    def sigma(self, level: float) -> float:
        """Return the standard deviation of a pixel at a level of I, as a share of the full scale."""
        return float(np.sqrt(max(level, 0.0) / self.full_well_e + (self.read_e / self.full_well_e) ** 2))

    def apply(self, picture: Picture, rng: np.random.Generator) -> Picture:
        """Return the noisy picture: below black too, where read noise takes it there."""
        electrons = np.zeros(picture.shape)
        for rows in in_rows(picture):  # three times: numbers are drawn for all of the picture, then the next ones
            mean = self._mean(picture[rows])
            electrons[rows] = mean + np.sqrt(mean) * rng.standard_normal(mean.shape)
        for rows in in_rows(picture):
            mean = self._mean(picture[rows])
            dark = mean < _POISSON_E
            electrons[rows][dark] = rng.poisson(mean[dark])
        out = np.zeros(picture.shape, np.float32)
        for rows in in_rows(picture):
            read = self.read_e * rng.standard_normal(picture[rows].shape)
            out[rows] = (electrons[rows] + read) / self.full_well_e
        return out

    def _mean(self, picture: Picture) -> Array:
        """Return the expected number of electrons."""
        return np.asarray(np.maximum(picture, 0.0).astype(np.float64) * self.full_well_e)
