"""Error budgets: contributions of independent causes and their sum (Tables 6.3 and 6.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from cadcam.camera.measurement import PIXELS, Measurement
from cadcam.kinds import FrozenMap, expect_positive


@dataclass(frozen=True, slots=True, eq=False)
class Budget:
    """Contributions in mm by cause, all of one kind (standard deviations, or worst cases treated as such)."""

    contributions: Mapping[str, float]

    def __post_init__(self) -> None:
        for cause, value in self.contributions.items():
            expect_positive(value, f"contribution of {cause!r}", "mm, from 0 on", zero=True)
        object.__setattr__(self, "contributions", FrozenMap(self.contributions))

    @property
    def total(self) -> float:
        """Return the root of the sum of squares, mm: the causes are independent."""
        return float(np.sqrt(sum(v * v for v in self.contributions.values())))

    @property
    def shares(self) -> dict[str, float]:
        """Return each cause's share in the square of the total, largest first."""
        whole = self.total**2 or 1.0
        return dict(sorted(((c, v * v / whole) for c, v in self.contributions.items()), key=lambda item: -item[1]))


def budget_of(measured: Measurement, name: str) -> Budget:
    """Return the budget of a measured point in its worst direction on the floor, by cause."""
    if name not in measured.names:
        measured.point(name)  # refuses unknown names
    i = measured.names.index(name)
    worst = np.linalg.eigh(measured.covariance[i][:2, :2])[1][:, -1]
    along = {PIXELS: 0.0}
    for source, effect in measured.effects:
        g = worst @ effect[i, :2]
        along[source.name] = along.get(source.name, 0.0) + float(g @ source.covariance @ g)
    for part in measured.noise:
        along[part.name] = along.get(part.name, 0.0) + float(worst @ part.covariance[i, :2, :2] @ worst)
    return Budget({cause: float(np.sqrt(max(v, 0.0))) for cause, v in along.items()})
