"""Parts with narrow bands beside their borders: contact shadows, gaps underneath, print and painted rims.

The CAD model knows nothing of the bands: they lie on the bench or on the part, 1 to 3 mm wide, and in a photo they are
a second step of brightness 1 to 6 px beside the border. What stands in the picture besides the part is its dressing:
meshes in the part's frame, each with how much light it throws back.
"""

from __future__ import annotations

import numpy as np

from cadcam.cad.mesh import Mesh
from cadcam.cad.parts.shape import box, circle, extruded, filled, moved, prism, rounded, turned

THICK = 2.5  # mm, of the plate
HOLES = (((22.0, 20.0), 9.0), ((22.0, 62.0), 6.0), ((86.0, 58.0), 11.0))  # centre and radius, mm
SLOT = ((50.0, 14.0), (104.0, 26.0))  # corners, mm
PLATE = np.array([(0, 0), (120, 0), (120, 48), (100, 80), (0, 80)], float)
COVER = ((0, 0), (110, 0), (110, 14), (62, 14), (62, 27), (0, 27))  # x, z, mm
WIDE = 70.0  # mm, of the cover
GAP = 1.3  # mm, under the cover
PRINT = 0.02  # mm, how far print stands out
DARK, RIM, GREY = 0.06, 0.42, 0.3  # how much light print throws back, and the part 0.52

Dressing = tuple[tuple[Mesh, float], ...]


def thin_plate(*, sides: int) -> Mesh:
    """Return a plate with three holes, a slot and a cut corner, from z = 0 up."""
    holes = [circle(centre, radius, sides) for centre, radius in HOLES]
    cells = [filled(PLATE, [*holes, rounded(*SLOT, 5.0, sides // 4)])]
    return extruded(cells, 0.0, THICK, name="plate", color=None)


def plate_print(*, sides: int) -> Dressing:
    """Return painted rims of two holes and of one border, and stripes of print beside two others."""
    rims = [_ring(*HOLES[0], 1.0, sides), _ring(*HOLES[2], 1.6, sides)]
    stripes = [_bar((1.8, 6), (3.0, 74)), _bar((8, 78.6), (92, 80)), _bar((10, 1.6), (110, 2.6))]
    return tuple(
        (moved(m, (0, 0, THICK)), a) for m, a in zip([*rims, *stripes], (RIM, DARK, DARK, RIM, DARK), strict=True)
    )


def stepped_cover() -> Mesh:
    """Return a block with a step, from z = 0 up."""
    outline = np.array(COVER, float)
    return moved(turned(prism(outline, 0.0, WIDE, name="cover", color=None), "xz"), (0, WIDE, 0))


def cover_foot() -> Dressing:
    """Return what the cover stands on, a dark foot set back from its borders, and stripes of print on its top."""
    foot = box((2.2, 2.2, -GAP), (107.8, WIDE - 2.2, 0.0), name="foot")
    high, low = COVER[-1][1], COVER[2][1]
    upper = _bar((1.9, 5), (3.1, WIDE - 5)), _bar((6, 0), (58, 1.3))
    lower = (_bar((105.4, 8), (107.4, WIDE - 8)),)
    printed = [*(moved(m, (0, 0, high)) for m in upper), *(moved(m, (0, 0, low)) for m in lower)]
    return ((foot, DARK), *zip(printed, (DARK, RIM, GREY), strict=True))


def _bar(low: tuple[float, float], high: tuple[float, float]) -> Mesh:
    return box((*low, 0.0), (*high, PRINT), name="print")


def _ring(centre: tuple[float, float], radius: float, wide: float, sides: int) -> Mesh:
    """Return paint around a hole."""
    cells = [filled(circle(centre, radius + wide, sides), [circle(centre, radius, sides)])]
    return extruded(cells, 0.0, PRINT, name="print", color=None)
