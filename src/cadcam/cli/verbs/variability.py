"""`cadcam variability`: the variability of each parameter of a calibration, by three methods, with figures."""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cadcam.cli.arguments import (
    Verbs,
    add_json,
    add_points_options,
    numbers,
    read_points_as_asked,
    real,
    refuse,
    seed,
    verb,
    whole,
)
from cadcam.cli.estimating import add_estimate_options, estimate_as_asked
from cadcam.cli.output import check_folder, print_json, print_tables, progress, say, say_written, working
from cadcam.errors import BadValue

if TYPE_CHECKING:
    from cadcam.calibrate.variability.alternating import Alternating
    from cadcam.calibrate.variability.methods import FirstOrder, Variability
    from cadcam.calibrate.variability.projection_map import ProjectionMap
    from cadcam.camera.estimate import CameraEstimate
    from cadcam.report.table import Table

_EXAMPLES = """\
  cadcam variability points.csv --size 768x576                             both methods beside first order
  cadcam variability points.csv --photo photo.png --plots figures          ... with distributions, correlations, a map
  cadcam variability points.csv --size 768x576 --fix skew=0 --fix aspect=1   what is gained by knowing two parameters
  cadcam variability points.csv --size 768x576 --points-sigma 0.2          world points known to 0.2 mm a coordinate
  cadcam variability points.csv --size 768x576 --plane 0,0,1,0 --plots f   the map on the plane Z = 0
  cadcam variability table_2_7.csv --columns U1,V1 --size 768x576 --method dlt-c23 --sigma 0.5122
                                                                           the dissertation's Tables 2.14 and 2.15

how to read it:
  sigma above what you need   the points do not determine the parameter: add points, or hold it with --fix
  a correlation near 1        the pair trades off: neither is known alone, but their joint effect is (see the map)
  mean off the exact value    the estimator is biased at this noise: the linear transforms are, least squares hardly is
  sigma unlike first order    the noise is so large, or the points so few, that intervals of 2 sigma mislead
"""
_DESCRIPTION = """\
Say how much each parameter of a calibration would change if the points were measured again.
First order: from the derivative of the estimate with respect to the pixels. Method A, Monte Carlo: pixels (and on
request world points) are perturbed and the camera is estimated again, thousands of times. Method B, Markov chain:
cameras are drawn by their likelihood given the pixels as measured. Where the noise is small the three agree; where
they do not, the table says so. The noise is that of the residuals unless --sigma states it. --seed repeats a study
exactly."""


_STEPS = 1_000_000  # as many as the thesis took
_MOST = 10_000_000  # draws or steps: a gigabyte of them


@dataclass(frozen=True, slots=True, eq=False)
class _Studies:
    """All requested studies; unmixed: why Method B, not asked for by --steps, has no result."""

    first: FirstOrder
    first_markov: FirstOrder
    monte_carlo: Variability | None
    markov: Variability | None
    alternating: Alternating | None
    map: ProjectionMap
    unmixed: str = ""

    @property
    def sampled(self) -> dict[str, Variability]:
        """Return those of both methods that were made, by name."""
        both = {"Monte Carlo": self.monte_carlo, "Markov chain": self.markov}
        return {name: study for name, study in both.items() if study is not None}


def add_to(verbs: Verbs) -> None:
    """Add the verb."""
    parser = verb(
        verbs,
        "variability",
        run,
        short="points file -> how stable each parameter is: sigmas, correlations, figures",
        description=_DESCRIPTION,
        examples=_EXAMPLES,
    )
    parser.add_argument("points", metavar="POINTS", help="points file")
    add_estimate_options(parser)
    _add_study_options(parser.add_argument_group("study"))
    where = parser.add_argument_group("uncertainty of projections").add_mutually_exclusive_group()
    where.add_argument("--depth", type=real, metavar="MM", help="for points at this depth (default: the points' mean)")
    where.add_argument("--plane", metavar="NX,NY,NZ,D", help="for points p on the plane NX X + NY Y + NZ Z = D, mm")
    output = parser.add_argument_group("output")
    output.add_argument("--plots", metavar="FOLDER", help="write figures there (extra: cadcam[plots])")
    output.add_argument("--format", default="png", choices=("png", "svg", "pdf"), help="of the figures (default png)")
    add_points_options(parser)
    add_json(parser)


def _add_study_options(group: argparse._ArgumentGroup) -> None:
    group.add_argument(
        "--draws", type=whole, default=2000, metavar="N", help="synthetic sets of Method A (default 2000; 0: none)"
    )
    group.add_argument(
        "--steps",
        type=whole,
        metavar="N",
        help="Markov steps of Method B (default 1000000, with free lens terms 200000, with --points-sigma 0: none)",
    )
    group.add_argument(
        "--points-sigma", type=real, default=0.0, metavar="MM", help="noise of a world coordinate too (Method A)"
    )
    group.add_argument("--seed", type=seed, default=0, metavar="N", help="seed of the random numbers (default 0)")
    group.add_argument(
        "--alternate",
        metavar="MM,DEG",
        help="also: another pose for every draw, within +-MM and +-DEG of the estimated one (Table 2.17)",
    )
    group.add_argument(
        "--unseen", action="store_true", help="with --alternate: keep poses that do not see the points (--method dlt*)"
    )


def run(arguments: argparse.Namespace) -> None:
    """Estimate, vary, print, draw."""
    _check(arguments)
    observations = read_points_as_asked(arguments, arguments.points)
    with working(f"estimating a camera from {len(observations)} points"):
        estimate = estimate_as_asked(arguments, observations)
    studies = _studied(arguments, estimate)
    if studies.unmixed:
        say(f"Method B is left out: {studies.unmixed}")
    written = _written(arguments, studies) if arguments.plots else []
    if arguments.json:
        print_json(_as_json(studies))
    else:
        print_tables(_tables(arguments, studies))
    say_written(*written)


def _check(arguments: argparse.Namespace) -> None:
    """Refuse before the work what would fail after it."""
    for name, least in (("draws", 100), ("steps", 10_000)):
        value = getattr(arguments, name)
        if value and not least <= value <= _MOST:
            raise BadValue(f"--{name}", value, f"{least} to {_MOST}, or 0 to leave that method out")
    if arguments.points_sigma < 0:
        raise BadValue("--points-sigma", f"{arguments.points_sigma:g}", "0 mm or more")
    if arguments.points_sigma and arguments.steps:
        raise BadValue(
            "--points-sigma", f"{arguments.points_sigma:g} with Method B", "--steps 0: B has noise of pixels only"
        )
    if arguments.alternate is None:
        refuse(arguments, "--unseen", why="without --alternate", expected="both, or neither")
    if arguments.plots is None:
        refuse(arguments, "--format", why="without --plots", expected="both, or leave it out")
    if arguments.alternate:
        numbers("--alternate", arguments.alternate, 2, form="2 numbers MM,DEG, such as 30,3")
    if arguments.plots:
        from cadcam.report.figures import figure

        with figure(1, 1):  # raises at once where the extra is missing
            pass
        check_folder(arguments.plots)


def _studied(arguments: argparse.Namespace, estimate: CameraEstimate) -> _Studies:
    from cadcam.calibrate.variability.methods import first_order_variability
    from cadcam.calibrate.variability.projection_map import projection_map

    first = first_order_variability(estimate, sigma_mm=arguments.points_sigma, method=arguments.method)
    plane = numbers("--plane", arguments.plane, 4, form="NX,NY,NZ,D, D in mm") if arguments.plane else None
    map_ = projection_map(estimate, depth_mm=arguments.depth, plane=plane)
    monte_carlo = _monte_carlo(arguments, estimate) if arguments.draws else None
    markov, unmixed = _markov_if_mixed(arguments, estimate)
    return _Studies(
        first=first,
        first_markov=first_order_variability(estimate),
        map=map_,
        alternating=_alternating(arguments, estimate) if arguments.alternate else None,
        monte_carlo=monte_carlo,
        markov=markov,
        unmixed=unmixed,
    )


def _monte_carlo(arguments: argparse.Namespace, estimate: CameraEstimate) -> Variability:
    from cadcam.calibrate.variability.methods import BLOCK, monte_carlo_variability

    with progress("Method A", -(-arguments.draws // BLOCK)) as step:
        return monte_carlo_variability(
            estimate,
            rng=_rng(arguments, 0),
            draws=arguments.draws,
            sigma_mm=arguments.points_sigma,
            method=arguments.method,
            progress=step,
        )


def _steps(arguments: argparse.Namespace, estimate: CameraEstimate) -> int:
    """Return the number of Markov steps; a separate lens for every state makes them slow."""
    from cadcam.camera.extended_pinhole import NAMES

    if arguments.steps is not None or arguments.points_sigma:
        return arguments.steps or 0
    return _STEPS if set(estimate.free) <= set(NAMES) else _STEPS // 5


def _markov_if_mixed(arguments: argparse.Namespace, estimate: CameraEstimate) -> tuple[Variability | None, str]:
    """Return the result of Method B, None where it is not asked for; or why its chains, by default so long, have none.

    A length that was asked for has to do: then it is an error.
    """
    from cadcam.fit.sampling import NotMixed

    steps = _steps(arguments, estimate)
    if not steps:
        return None, ""
    try:
        return _markov(arguments, estimate, steps), ""
    except NotMixed as error:
        if arguments.steps is not None:
            raise
        return None, f"{error} (--steps, --fix)"


def _markov(arguments: argparse.Namespace, estimate: CameraEstimate, steps: int) -> Variability:
    from cadcam.calibrate.variability.methods import chains_for, markov_chain_variability, walk_of

    chains = chains_for(steps)
    walk = walk_of(steps, chains)
    with progress("Method B", walk.steps // walk.thin) as step:
        return markov_chain_variability(estimate, rng=_rng(arguments, 1), walk=walk, chains=chains, progress=step)


def _alternating(arguments: argparse.Namespace, estimate: CameraEstimate) -> Alternating:
    from cadcam.calibrate.variability.alternating import alternating_externals
    from cadcam.calibrate.variability.methods import BLOCK

    spread_mm, spread_deg = numbers("--alternate", arguments.alternate, 2)
    draws = arguments.draws or 2000
    with progress("alternating externals", -(-draws // BLOCK)) as step:
        return alternating_externals(
            estimate,
            rng=_rng(arguments, 2),
            spread_mm=spread_mm,
            spread_deg=spread_deg,
            draws=draws,
            method=arguments.method,
            visible=not arguments.unseen,
            progress=step,
        )


def _rng(arguments: argparse.Namespace, study: int) -> Any:
    """Return a study's own generator: leaving out one study does not change the others."""
    import numpy as np

    return np.random.default_rng([arguments.seed, study])


def _tables(arguments: argparse.Namespace, studies: _Studies) -> list[Table]:
    from cadcam.report import variability as report

    method = {"reprojection": "least squares", "dlt": "direct linear transform"}.get(
        arguments.method, "direct linear transform, C23 = 1"
    )
    first, tables = studies.first, []
    if studies.monte_carlo is not None:
        tables.append(report.monte_carlo_table(studies.monte_carlo, first, method=method))
    if studies.markov is not None:
        tables.append(report.markov_table(studies.markov, studies.first_markov))
    if not tables:
        tables.append(report.first_order_table(first))
    matrices = _matrices(studies)
    tables += [report.correlation_table(f"Correlations, {k}", first.names, m) for k, m in matrices.items()]
    if studies.alternating is not None:
        tables += report.alternating_tables(studies.alternating, first, method=method)
    return [*tables, report.map_table(studies.map)]


def _matrices(studies: _Studies) -> dict[str, Any]:
    sampled = {name: study.correlation for name, study in studies.sampled.items()}
    return sampled or {"first order": studies.first.correlation}


def _as_json(studies: _Studies) -> dict[str, Any]:
    from cadcam.report import variability as report

    document: dict[str, Any] = {"first_order": report.first_order_as_json(studies.first)}
    if studies.monte_carlo is not None:
        document["monte_carlo"] = report.variability_as_json(studies.monte_carlo)
    if studies.markov is not None:
        document["markov_chain"] = report.variability_as_json(studies.markov)
    if studies.unmixed:
        document["markov_chain_left_out"] = studies.unmixed
    if studies.alternating is not None:
        document["alternating_externals"] = report.variability_as_json(studies.alternating.errors)
    return document | {"projection": report.map_as_json(studies.map)}


def _written(arguments: argparse.Namespace, studies: _Studies) -> list[str]:
    from cadcam.report.variability_plots import write_plots

    return write_plots(arguments.plots, studies.sampled, studies.first, studies.map, kind=arguments.format)
