"""Variability studies as tables and JSON: mean, sigma, extremes, correlations; doubts in words."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from cadcam.arrays import Array, Mask
from cadcam.calibrate.variability.alternating import Alternating
from cadcam.calibrate.variability.methods import FirstOrder, Variability
from cadcam.calibrate.variability.projection_map import ProjectionMap
from cadcam.camera.extended_pinhole import EXTERNALS
from cadcam.errors import listed
from cadcam.files.jsontext import or_nulls
from cadcam.fit.sampling import R_HAT_GOOD
from cadcam.report.camera import ANGLES, MEANING
from cadcam.report.table import Table, plain, with_sigma

_ENOUGH = 400  # effective draws: a sigma to 3.5 %
_BIAS = 4.0  # standard errors by which a mean may lie off by chance
_BIAS_MATTERS = 0.1  # of a sigma
_CURVED = 0.1  # by which a sigma may differ from the first-order one
_LEFT = ("parameter", "unit")


def shown(names: Sequence[str], values: Array) -> Array:
    """Return parameters (..., n) in the units they are shown in: mm, degrees, px."""
    return np.asarray(values * np.where(np.isin(names, ANGLES), np.degrees(1.0), 1.0))


def unit(name: str) -> str:
    """Return the unit in which a parameter is shown."""
    return MEANING.get(name, ("",))[0]


def monte_carlo_table(v: Variability, first: FirstOrder, *, method: str) -> Table:
    """Return Method A: exact values, mean, sigma, extremes, and the first-order sigma."""
    world = f", {v.sigma_mm:g} mm a world coordinate" if v.sigma_mm else ""
    failed = (f"{v.failed} draws without an answer are left out",) if v.failed else ()
    notes = (
        f"{len(v.values)} synthetic sets of points, each estimated by {method}",
        f"noise {v.sigma_px:.4g} px a pixel coordinate{world}",
        *failed,
        *_surprises(v, first),
    )
    return _moments("Monte Carlo (Method A)", "exact", v, first, notes)


def markov_table(v: Variability, first: FirstOrder) -> Table:
    """Return Method B: the optimum, mean, sigma, extremes, the first-order sigma, R-hat and effective size."""
    notes = (
        f"{v.draws.shape[0]} Metropolis chains, noise {v.sigma_px:.4g} px a pixel coordinate",
        f"effective sample size {v.effective.min():.0f} or more, R-hat {v.r_hat.max():.4f} or less, "
        f"{100 * v.acceptance:.0f} % of steps accepted",
        *_mixing(v),
        *_surprises(v, first),
    )
    return _moments("Markov chain (Method B)", "optimum", v, first, notes)


def first_order_table(first: FirstOrder) -> Table:
    """Return the first-order sigmas alone."""
    rows = []
    columns = (shown(first.names, first.exact).tolist(), shown(first.names, first.sigma).tolist())
    for name, value, sigma in zip(first.names, *columns, strict=True):
        rows.append((name, *with_sigma(value, sigma), unit(name)))
    return Table("First order", ("parameter", "value", "sigma", "unit"), tuple(rows), _LEFT)


def alternating_tables(a: Alternating, first: FirstOrder, *, method: str) -> list[Table]:
    """Return the internals estimated with newly drawn poses (Table 2.17), and the correlation of the errors."""
    v = a.errors
    notes = (
        f"{len(v.values)} poses, each with points of its own noise ({v.sigma_px:.4g} px), estimated by {method}",
        *_heavy_tails(v),
    )
    with_drawn = float(np.abs(a.correlation_with_drawn[:6, 6:]).max())
    note = (
        "of the errors, estimated minus drawn; of the internals with the externals as drawn (Table 2.18) none exceeds "
        f"{with_drawn:.2f}: the noise does not know where the camera stood"
    )
    return [
        _moments("Alternating externals", "exact", v, first, notes, skip=EXTERNALS),
        correlation_table("Correlations, alternating externals", v.names, v.correlation, notes=(note,)),
    ]


def correlation_table(title: str, names: Sequence[str], correlation: Array, *, notes: tuple[str, ...] = ()) -> Table:
    """Return a correlation matrix with two decimals."""
    rows = tuple((name, *(f"{c:.2f}" for c in row)) for name, row in zip(names, correlation, strict=True))
    return Table(title, ("", *names), rows, ("",), notes)


def map_table(m: ProjectionMap) -> Table:
    """Return the projection's sigma at the centre, at the corners and at its minimum."""
    h, w = m.sigma.shape
    places = {
        "centre": (h // 2, w // 2),
        "top left": (0, 0),
        "top right": (0, w - 1),
        "bottom left": (h - 1, 0),
        "bottom right": (h - 1, w - 1),
    }
    if np.isfinite(m.sigma).any():
        i, j = np.unravel_index(int(np.nanargmin(m.sigma)), m.sigma.shape)
        places["best"] = (int(i), int(j))
    rows = tuple((k, f"{m.x[j]:.1f}", f"{m.y[i]:.1f}", _sigma_text(m.sigma[i, j])) for k, (i, j) in places.items())
    notes = (f"points {m.surface}; the camera's error alone, along its worse direction",)
    return Table("Where a known point is seen: sigma of its pixel", ("place", "x", "y", "sigma px"), rows, _LEFT, notes)


def variability_as_json(v: Variability) -> dict[str, Any]:
    """Return the study's numbers in mm, degrees, px."""
    degrees = [f"{name}_deg" if name in ANGLES else name for name in v.names]
    columns = {
        "exact": v.exact, "mean": v.mean, "mean_error": v.mean_error, "sigma": v.sigma, "minimum": v.minimum,
        "maximum": v.maximum, "q025": v.quantile(0.025), "q975": v.quantile(0.975),
    }  # fmt: skip
    return {
        "parameters": {
            name: {key: float(shown(v.names, column)[i]) for key, column in columns.items()}
            | {"r_hat": float(v.r_hat[i]), "effective_size": float(v.effective[i])}
            for i, name in enumerate(degrees)
        },
        "correlation": v.correlation.tolist(),
        "draws": len(v.values),
        "chains": v.draws.shape[0],
        "failed": v.failed,
        "sigma_px": v.sigma_px,
        "sigma_mm": v.sigma_mm,
    }


def first_order_as_json(first: FirstOrder) -> dict[str, Any]:
    """Return the first-order sigmas in mm, degrees, px, and the correlations."""
    degrees = [f"{name}_deg" if name in ANGLES else name for name in first.names]
    exact, sigma = shown(first.names, first.exact).tolist(), shown(first.names, first.sigma).tolist()
    return {
        "parameters": {n: {"exact": e, "sigma": s} for n, e, s in zip(degrees, exact, sigma, strict=True)},
        "correlation": first.correlation.tolist(),
    }


def map_as_json(m: ProjectionMap) -> dict[str, Any]:
    """Return the map's nodes and sigmas in px; null where the camera images nothing of the surface."""
    sigma = [or_nulls(row) for row in m.sigma]
    return {"surface": m.surface, "x_px": m.x.tolist(), "y_px": m.y.tolist(), "sigma_px": sigma}


def _moments(
    title: str, exact: str, v: Variability, first: FirstOrder, notes: tuple[str, ...], skip: Sequence[str] = ()
) -> Table:
    columns = [shown(v.names, c) for c in (v.exact, v.mean, v.sigma, v.minimum, v.maximum, first.sigma)]
    rows = []
    for i, name in enumerate(v.names):
        if name in skip:
            continue
        centre, mean, sigma, low, high, linear = (float(c[i]) for c in columns)
        decimals = len(with_sigma(mean, sigma / 10)[0].partition(".")[2])
        numbers = (f"{x:.{decimals}f}" for x in (centre, mean, sigma, low, high, linear))
        rows.append((name, *numbers, unit(name)))
    heads = ("parameter", exact, "mean", "sigma", "min", "max", "first order", "unit")
    return Table(title, heads, tuple(rows), _LEFT, notes)


def _mixing(v: Variability) -> list[str]:
    said = []
    if v.r_hat.max() > R_HAT_GOOD:
        name = v.names[int(np.argmax(v.r_hat))]
        said.append(f"warning: R-hat of {name} is {v.r_hat.max():.3f}, above {R_HAT_GOOD}: take more steps")
    if v.effective.min() < _ENOUGH:
        share = 100 / np.sqrt(2 * v.effective.min())
        said.append(f"warning: {v.effective.min():.0f} effective draws know a sigma to {share:.0f} %: take more steps")
    return said


def _surprises(v: Variability, first: FirstOrder) -> list[str]:
    """Return deviations from first order: a biased mean, another spread."""
    shift = (v.mean - v.exact) / v.sigma
    curved = v.sigma / first.sigma - 1
    biased = np.abs(shift) > np.maximum(_BIAS / np.sqrt(v.effective), _BIAS_MATTERS)
    bent = np.abs(curved) > np.maximum(_CURVED, 4 / np.sqrt(2 * v.effective))
    return [
        *_worst("the mean lies off the value in the first column", v.names, shift, biased, "{:+.2f} sigma"),
        *_worst("warning: sigma differs from first order", v.names, 100 * curved, bent, "{:+.0f} %"),
    ]


def _worst(said: str, names: Sequence[str], values: Array, which: Mask, text: str) -> list[str]:
    """Return a sentence with the three largest of the values, none if there is none."""
    order = [int(i) for i in np.argsort(-np.abs(values)) if which[i]]
    words = [f"{names[i]} {text.format(values[i])}" for i in order]
    return [f"{said}: {listed(words, 3)}"] if order else []


def _heavy_tails(v: Variability) -> list[str]:
    """Return a warning where a few draws dominate the sigma: it far exceeds half the width of the central 68 %."""
    central = (v.quantile(0.8413) - v.quantile(0.1587)) / 2
    heavy = [
        f"{name} {plain(float(shown([name], central[i : i + 1])[0]), 2)}"
        for i, name in enumerate(v.names)
        if name not in EXTERNALS and v.sigma[i] > 1.3 * central[i]
    ]
    if not heavy:
        return []
    return [f"warning: a few extreme draws make sigma; half the width of the central 68 %: {', '.join(heavy)}"]


def _sigma_text(sigma: float) -> str:
    return f"{sigma:.3g}" if np.isfinite(sigma) else "unseen"
