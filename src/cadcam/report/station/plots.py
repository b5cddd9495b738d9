"""The mechanics' deviation over the work area as figures: arrows and heat maps in x and y (Fig 6-17, 6-18)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from cadcam.arrays import Array
from cadcam.report.figures import BLUE, INK, figure
from cadcam.station.gantry import GantryCalibration

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FINE = 41  # places along each side, between the calibrated positions


def deviation_figure(stations: Mapping[str, GantryCalibration]) -> Figure:
    """Return heat maps of the deviation in x and in y, with arrows, for every camera on one floor plan."""
    fields = {name: _between(station) for name, station in stations.items()}
    most = max(float(np.abs(values).max()) for _, _, values in fields.values()) or 1.0
    with figure(9.0, 4.2) as drawn:
        panels = drawn.subplots(1, 2, sharex=True, sharey=True)
        for axis, panel in enumerate(panels):
            for name, (xs, ys, values) in fields.items():
                shown = panel.pcolormesh(
                    xs, ys, values[..., axis], cmap="RdBu_r", vmin=-most, vmax=most, shading="gouraud"
                )
                _positions(panel, name, stations[name], most)
            panel.set_aspect("equal")
            panel.set_xlabel("x, m")
            panel.set_title(f"deviation in {'xy'[axis]}, mm; arrows: both")
        panels[0].set_ylabel("y, m")
        drawn.colorbar(shown, ax=panels, shrink=0.8)
    return drawn


def _positions(panel: Axes, name: str, station: GantryCalibration, most: float) -> None:
    seen = station.map()
    x, y = (seen.positions / 1000).T
    panel.plot(x, y, ".", color=INK, markersize=3)
    long = 1.5 / most  # the largest deviation is drawn 1.5 m long
    u, v = seen.deviation.T * long
    panel.quiver(x, y, u, v, angles="xy", scale_units="xy", scale=1, color=BLUE, width=0.005)
    panel.margins(0.07)
    place = (float(x.min()), float(y.max()))
    white = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}
    panel.annotate(f"camera {name}", place, xytext=(4, -12), textcoords="offset points", bbox=white)


def _between(station: GantryCalibration) -> tuple[Array, Array, Array]:
    """Return places x, y in m and the deviation (ny, nx, 2) mm there, by the field's best weights."""
    low, high = station.grid.min(axis=0), station.grid.max(axis=0)
    xs, ys = (np.linspace(low[i], high[i], _FINE) for i in (0, 1))
    x, y = np.meshgrid(xs, ys)
    W = station.field.weights(np.column_stack([x.ravel(), y.ravel()]))
    m = station.map().deviation
    values = np.stack([(W[axis] @ m[:, axis]).reshape(x.shape) for axis in (0, 1)], axis=-1)
    return xs / 1000, ys / 1000, values
