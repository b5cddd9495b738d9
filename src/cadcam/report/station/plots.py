"""The mechanics' deviation over the work area as figures: arrows and heat maps in x and y (Fig 6-17, 6-18)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array
from cadcam.report.figures import BLUE, INK, figure
from cadcam.station.gantry import GantryCalibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LONGEST_M = 1.5  # of an arrow in the plot: the largest deviation along an axis
_FINE = 41  # places along each side, between the calibrated positions


def deviation_figure(stations: Mapping[str, GantryCalibration], *, reference: int | None = None) -> Figure:
    """Return heat maps of the deviation in x and in y, with arrows, for every camera on one floor plan.

    reference: the index of the position that deviations are relative to; None: the mean of all.
    """
    fields = {name: _between(station, reference) for name, station in stations.items()}
    most = max(float(np.abs(values).max()) for _, _, values in fields.values()) or 1.0
    with figure(9.0, 4.2) as drawn:
        panels = drawn.subplots(1, 2, sharex=True, sharey=True)
        for axis, panel in enumerate(panels):
            for name, (xs, ys, values) in fields.items():
                half = [float(side[1] - side[0]) / 2 for side in (xs, ys)]
                shown = panel.imshow(  # not shaded triangles: viewers of SVG do not interpolate their colours correctly
                    values[..., axis],
                    extent=(xs[0] - half[0], xs[-1] + half[0], ys[0] - half[1], ys[-1] + half[1]),
                    origin="lower",
                    cmap="RdBu_r",
                    vmin=-most,
                    vmax=most,
                    interpolation="bilinear",
                )
                _positions(panel, name, stations[name], reference, most)
            panel.set_xlim(*_reach([xs for xs, _, _ in fields.values()]))
            panel.set_ylim(*_reach([ys for _, ys, _ in fields.values()]))
            panel.set_aspect("equal")
            panel.set_xlabel("x, m")
            panel.set_title(f"deviation in {'xy'[axis]}, mm; arrows: both")
        panels[0].set_ylabel("y, m")
        drawn.colorbar(shown, ax=panels, shrink=0.8)
    return drawn


def _reach(sides: Sequence[Array]) -> tuple[float, float]:
    """Return the limits of an axis, m, so that no arrow at the border is cut off."""
    return min(float(s[0]) for s in sides) - _LONGEST_M, max(float(s[-1]) for s in sides) + _LONGEST_M


def _positions(panel: Axes, name: str, station: GantryCalibration, reference: int | None, most: float) -> None:
    seen = station.map(reference=reference)
    x, y = (seen.positions / 1000).T
    panel.plot(x, y, ".", color=INK, markersize=3)
    long = _LONGEST_M / most
    u, v = seen.deviation.T * long
    panel.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.005)
    place = (float(x.min()), float(y.max()))
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    panel.annotate(f"camera {name}", place, xytext=(4, -12), textcoords="offset points", bbox=white)


def _between(station: GantryCalibration, reference: int | None) -> tuple[Array, Array, Array]:
    """Return places x, y in m and the deviation (ny, nx, 2) mm there, by the field's best weights."""
    low, high = station.grid.min(axis=0), station.grid.max(axis=0)
    xs, ys = (np.linspace(low[i], high[i], _FINE) for i in (0, 1))
    x, y = np.meshgrid(xs, ys)
    W = station.field.weights(np.column_stack([x.ravel(), y.ravel()]))
    m = station.map(reference=reference).deviation
    values = np.stack([(W[axis] @ m[:, axis]).reshape(x.shape) for axis in (0, 1)], axis=-1)
    return xs / 1000, ys / 1000, values
