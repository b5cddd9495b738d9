"""Correspondences: samples of the part's visible edges, and where the photos show those edges, or whether."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from cadcam.arrays import Array, Brief, Ids, Mask, frozen
from cadcam.geometry.rigid import Rigid

_BELIEVED = 0.3  # weight in the fit from which a sample counts as shown


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class EdgeMatches(Brief):
    """N samples of visible edges with the photo's edge along their normal.

    q (N, 2) px where the model puts the sample and normal (N, 2) its unit normal in the photo; offset (N,) px, the
    photo's edge minus the model's along the normal, nan where none was found; sigma (N,) px, its standard deviation by
    the photo's noise; weight (N,) in [0, 1], how far it was believed; p (N, 3) mm in the part frame, where on the edge
    it lies; chain (N,) the feature chain (edge), -1 on contours; photo (N,) which photo.
    """

    q: Array
    normal: Array
    offset: Array
    sigma: Array
    weight: Array
    p: Array
    chain: Ids
    photo: Ids

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.offset))
        shapes = {"q": (n, 2), "normal": (n, 2), "sigma": (n,), "weight": (n,), "p": (n, 3), "offset": (n,)}
        for name, shape in shapes.items():
            finite = name not in ("offset", "sigma")
            object.__setattr__(self, name, frozen(getattr(self, name), f"matches' {name}", shape, finite=finite))
        for name in ("chain", "photo"):
            object.__setattr__(self, name, frozen(getattr(self, name), f"matches' {name}", (n,), np.int32))

    def __len__(self) -> int:
        return len(self.offset)

    def among(self, part_from_part: Rigid, chain_images: Ids) -> EdgeMatches:
        """Return the same of a part that has been moved onto itself: on those edges that are now where others were.

        chain_images (C,): the chain that the motion has brought onto each chain.
        """
        chain = np.where(self.chain < 0, np.int32(-1), chain_images[self.chain] if len(chain_images) else -1)
        return replace(self, p=part_from_part.inv @ self.p, chain=chain)

    @property
    def believed(self) -> Mask:
        """Return which samples (N,) the photos show where the pose has them, as far as the fit believes."""
        return np.isfinite(self.offset) & (self.weight > _BELIEVED)

    @property
    def scatter_px(self) -> float:
        """Return the root mean square of the offsets, as far as they are believed; inf without any."""
        found = np.isfinite(self.offset) & (self.weight > 0)
        if not found.any():
            return math.inf
        return math.sqrt(np.average(self.offset[found] ** 2, weights=self.weight[found]))


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class JudgedSamples(Brief):
    """The n samples of feature edges by which a pose was judged: those with room to the next line, some hundred of all.

    p (n, 3) mm in the part frame; photo (n,) which photo; shown (n,) whether it shows the edge there.
    """

    p: Array
    photo: Ids
    shown: Mask

    @classmethod
    def none(cls) -> JudgedSamples:
        """Return no samples."""
        return cls(np.zeros((0, 3)), np.zeros(0, np.int32), np.zeros(0, bool))
