"""Variability studies as figures: distributions (Fig 2-6 to 2-9 of the thesis), correlations, projections."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.variability.methods import FirstOrder, Variability
from cadcam.calibrate.variability.projection_map import ProjectionMap
from cadcam.camera.extended_pinhole import EXTERNALS
from cadcam.report.figures import BLUE, GREEN, INK, ORANGE, figure, write_figure
from cadcam.report.variability import shown, unit

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 32  # as in the thesis
_STYLES = ((BLUE, True), (ORANGE, False))  # the first study filled, the second as an outline
_TOGETHER = (("X", "Y", "Z"), ("a", "b", "c"), ("focal", "U0", "V0"))
_LINES = ((BLUE, "-"), (ORANGE, "--"), (GREEN, "-."))


def write_plots(
    folder: str | os.PathLike[str],
    studies: Mapping[str, Variability],
    first: FirstOrder,
    map_: ProjectionMap,
    *,
    kind: str = "png",
) -> list[str]:
    """Write all figures into a folder and return their paths.

    studies: at most two, by their names in the legend. Raises `MissingExtra` without matplotlib.
    """
    names = first.names
    externals, internals = ([n for n in names if (n in EXTERNALS) == outer] for outer in (True, False))
    paths = []

    def path(name: str) -> Path:
        paths.append(str(Path(folder) / f"{name}.{kind}"))
        return Path(paths[-1])

    if studies and externals:
        write_distributions(path("distributions_externals"), studies, first, externals)
    if studies and internals:
        write_distributions(path("distributions_internals"), studies, first, internals)
    if studies and any(set(group) <= set(names) for group in _TOGETHER):
        write_together(path("distributions_together"), max(studies.values(), key=lambda v: len(v.values)))
    matrices = {label: v.correlation for label, v in studies.items()} or {"first order": first.correlation}
    write_correlations(path("correlations"), names, matrices)
    write_map(path("projection"), map_)
    return paths


def write_distributions(
    path: str | os.PathLike[str], studies: Mapping[str, Variability], first: FirstOrder, names: Sequence[str]
) -> None:
    """Write one histogram per parameter, with the normal curve of first order (Fig 2-6, 2-7)."""
    columns = min(3, len(names))
    rows = -(-len(names) // columns)
    with figure(2.5 * columns, 2.0 * rows + 0.4) as drawn:
        axes = drawn.subplots(rows, columns, squeeze=False).ravel()
        for ax, name in zip(axes, names, strict=False):
            _distribution(ax, name, studies, first)
        for ax in axes[len(names) :]:
            ax.set_axis_off()
        handles, labels = axes[0].get_legend_handles_labels()
        drawn.legend(handles, labels, loc="outside upper center", ncols=len(labels))
        write_figure(path, drawn)


def write_together(path: str | os.PathLike[str], study: Variability) -> None:
    """Write parameters of one kind on one scale, about their means, to compare their uncertainty (Fig 2-8, 2-9)."""
    groups = [g for g in _TOGETHER if set(g) <= set(study.names)]
    with figure(2.6 * len(groups), 2.4) as drawn:
        for ax, group in zip(drawn.subplots(1, len(groups), squeeze=False).ravel(), groups, strict=True):
            for name, (color, line) in zip(group, _LINES, strict=True):
                i = study.names.index(name)
                values = shown([name], study.values[:, i : i + 1])[:, 0]
                density, edges = np.histogram(values - values.mean(), BINS, density=True)
                ax.plot((edges[1:] + edges[:-1]) / 2, density, line, color=color, lw=1.6, label=name)
            ax.set_xlabel(f"off the mean, {unit(group[0])}")
            ax.set_ylabel(f"density, 1/{unit(group[0])}")
            ax.set_ylim(bottom=0)
            ax.legend(handlelength=2.4)
        write_figure(path, drawn)


def write_correlations(path: str | os.PathLike[str], names: Sequence[str], matrices: Mapping[str, Array]) -> None:
    """Write correlation matrices side by side, each entry with its number."""
    n, count = len(names), len(matrices)
    side = 0.36 * n + 0.9
    with figure(side * count + 0.7, side) as drawn:
        axes = drawn.subplots(1, count, squeeze=False).ravel()
        for ax, (label, matrix) in zip(axes, matrices.items(), strict=True):
            picture = ax.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
            for (i, j), value in np.ndenumerate(matrix):
                color = "white" if abs(value) > 0.6 else INK
                ax.text(j, i, _two_digits(value), ha="center", va="center", fontsize=6.5, color=color)
            ax.set_xticks(range(n), names, rotation=45, ha="right", rotation_mode="anchor")
            ax.set_yticks(range(n), names)
            ax.tick_params(length=0)
            ax.spines[:].set_visible(False)
            ax.set_title(label)
        drawn.colorbar(picture, ax=axes, shrink=0.85, aspect=28, label="correlation")
        write_figure(path, drawn)


def write_map(path: str | os.PathLike[str], m: ProjectionMap) -> None:
    """Write sigma over the picture with contours, colour scale and the calibration's points."""
    width, height = np.ptp(m.x), np.ptp(m.y)
    finite = m.sigma[np.isfinite(m.sigma)]
    # values far outside the points would leave a single colour for the region of interest
    top = float(min(finite.max(), 8 * np.median(finite)))
    with figure(6.4, 6.4 * height / width * 0.84 + 0.7) as drawn:
        ax = drawn.subplots()
        picture = ax.pcolormesh(m.x, m.y, m.sigma, cmap="viridis", vmin=0, vmax=top, shading="gouraud", rasterized=True)
        _contours(ax, m, _round_levels(float(finite.min()), top))
        ax.plot(*m.q.T, "+", color="#ffffff", mew=2.6, ms=8)
        ax.plot(*m.q.T, "+", color=ORANGE, mew=1.2, ms=7, label="points of the calibration")
        ax.set(xlim=(m.x[0], m.x[-1]), ylim=(m.y[-1], m.y[0]), aspect="equal", xlabel="x, px", ylabel="y, px")
        ax.set_title(f"Uncertainty of projections, points {m.surface}")
        above = "max" if finite.max() > top else "neither"
        drawn.colorbar(
            picture, cax=ax.inset_axes((1.03, 0, 0.04, 1)), label="sigma, px (worse direction)", extend=above
        )
        drawn.legend(loc="outside lower center", handletextpad=0.3)
        write_figure(path, drawn)


def _contours(ax: Axes, m: ProjectionMap, levels: Array) -> None:
    """Draw labelled lines of equal sigma, legible on any colour."""
    from matplotlib.patheffects import withStroke

    lines = ax.contour(m.x, m.y, m.sigma, levels=levels, colors="white", linewidths=0.9)
    outline = withStroke(linewidth=2.2, foreground=INK)
    for label in ax.clabel(lines, fontsize=8.5, fmt=lambda v: f"{v:g}"):
        label.set(path_effects=[outline], zorder=5)


def _distribution(ax: Axes, name: str, studies: Mapping[str, Variability], first: FirstOrder) -> None:
    for (label, study), (color, filled) in zip(studies.items(), _STYLES, strict=False):
        i = study.names.index(name)
        values = shown([name], study.values[:, i : i + 1])[:, 0]
        density, edges = np.histogram(values, BINS, density=True)
        style: dict[str, Any] = {"fill": True, "alpha": 0.35} if filled else {"fill": False, "lw": 1.4}
        ax.stairs(density, edges, color=color, label=label, **style)
    i = first.names.index(name)
    centre, sigma = (float(shown([name], v[i : i + 1])[0]) for v in (first.exact, first.sigma))
    x = np.linspace(centre - 4 * sigma, centre + 4 * sigma, 161)
    ax.plot(x, np.exp(-0.5 * ((x - centre) / sigma) ** 2) / (sigma * np.sqrt(2 * np.pi)), color=INK, lw=1.1,
            label="first order")  # fmt: skip
    ax.set_xlabel(f"{name}, {unit(name)}" if unit(name) else name)
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.set_ylim(bottom=0)
    ax.locator_params(axis="x", nbins=5)


def _round_levels(low: float, high: float) -> Array:
    """Return about seven round numbers between low and high."""
    raw = (high - low) / 7
    power = 10.0 ** np.floor(np.log10(raw)) if raw > 0 else 1.0
    step = next(power * s for s in (1, 2, 2.5, 5, 10) if power * s >= raw)
    return np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step


def _two_digits(value: float) -> str:
    """Return a correlation in its shortest form: .97, -.05, 1."""
    text = f"{value:.2f}"
    return {"1.00": "1", "-1.00": "-1"}.get(text, text.replace("0.", ".", 1).replace("-.00", ".00"))
