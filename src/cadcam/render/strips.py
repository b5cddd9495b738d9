"""Large pictures through a lens, in horizontal strips: the lens tables of a few strips at a time, not of the picture.

A strip is drawn as a picture of its own, through a table of its rows. What a pixel shows depends on the table's points
in it alone, so that strips together are the picture drawn at once, bit by bit. Where the tables of the whole picture
are small enough they are made once and kept, for the next frame; those of strips are made for each, by all threads.
"""

from __future__ import annotations

from dataclasses import dataclass

from cadcam.camera.camera import Camera
from cadcam.camera.lens import Ideal
from cadcam.native.core import NativeLens
from cadcam.render.lens_tables import MAKING_BYTES, may_return, table_points
from cadcam.render.view import Channel, Look

WHOLE_BYTES = 5 << 29  # of a picture's tables, up to which it is drawn at once: 5 megapixels of 3 x 3 samples
STRIP_BYTES = 1 << 26  # of a strip's tables
AT_ONCE_BYTES = 1 << 30  # of the tables of all strips that are being drawn
_TILE = 8  # rows of pixels of the core's tiles: strips hold whole ones
_SHADED = Channel.IMAGE | Channel.RGB


@dataclass(frozen=True, slots=True)
class Grids:
    """The samples that a picture is drawn from, n x n in each pixel: (1,), (n,) or, for two grids at once, (1, n).

    Through a distorting camera each grid needs a table.
    """

    camera: Camera
    samples: tuple[int, ...]

    @classmethod
    def of(cls, camera: Camera, channels: Channel, look: Look) -> Grids:
        """Return those that some channels need: colours are averaged, all else is of the pixels' centres."""
        n = look.supersampling if channels & _SHADED else 1
        return cls(camera, (1, n) if n > 1 and channels & ~_SHADED else (n,))

    @property
    def plain(self) -> bool:
        """Return whether no tables are needed, for lack of distortion."""
        return isinstance(self.camera.lens, Ideal)

    @property
    def finest(self) -> int:
        """Return the number of samples along a pixel in the finest grid."""
        return self.samples[-1]

    @property
    def whole(self) -> bool:
        """Return whether the picture is drawn at once: through tables worth keeping, or no larger than a strip's."""
        most = WHOLE_BYTES if may_return(self.camera.lens) else min(STRIP_BYTES, WHOLE_BYTES)
        return self.plain or self._bytes(self.camera.height) <= most

    def strips(self) -> list[slice]:
        """Return the rows of pixels of each strip, from top to bottom."""
        rows, height = self._strip_rows, self.camera.height
        return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]

    def at_once(self, threads: int) -> int:
        """Return how many of so many threads may each draw a strip."""
        return max(1, min(threads, AT_ONCE_BYTES // self._bytes(self._strip_rows)))

    def table_bytes(self, threads: int) -> int:
        """Return the bytes of all tables that exist at a time, if so many threads draw."""
        if self.plain:
            return 0
        if self.whole:
            return self._bytes(self.camera.height)
        return self._bytes(self._strip_rows) * self.at_once(threads)

    def tables(self, rows: slice) -> dict[int, NativeLens]:
        """Return the tables of a strip, by the number of samples along a pixel."""
        return {n: NativeLens(table_points(self.camera, n, rows)) for n in self.samples}

    @property
    def _strip_rows(self) -> int:
        return max(STRIP_BYTES // self._bytes(_TILE), 1) * _TILE

    def _bytes(self, rows: int) -> int:
        return MAKING_BYTES * self.camera.width * rows * sum(n * n for n in self.samples)
