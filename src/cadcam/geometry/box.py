"""What of straight lines lies in a box that is parallel to the axes."""

from __future__ import annotations

import numpy as np

from cadcam.arrays import Array, Mask


def clipped_to_box(ends: Array, box: Array) -> tuple[Mask, Array]:
    """Return which lines between two ends (N, 2, 3) have a part in a box (2, 3), and the ends (N, 2, 3) of that part.

    box: lowest and highest corner. A line that meets it in one point alone has no part in it, and keeps its ends.
    """
    a, d = ends[:, 0], ends[:, 1] - ends[:, 0]
    t = np.divide(box - a[:, None], d[:, None], out=np.zeros((len(ends), 2, 3)), where=d[:, None] != 0)
    within = (a >= box[0]) & (a <= box[1])  # what runs along an axis' planes is between them as a whole, or not at all
    first = np.where(d != 0, t.min(axis=1), np.where(within, 0.0, 1.0)).max(axis=1, initial=0.0)
    last = np.where(d != 0, t.max(axis=1), np.where(within, 1.0, 0.0)).min(axis=1, initial=1.0)
    inside = first < last
    at = np.stack([first, last], axis=1)[:, :, None]
    return inside, np.where(inside[:, None, None], a[:, None] + at * d[:, None], ends)
