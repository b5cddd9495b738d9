"""Section 2.4 of the dissertation reproduced: its tables beside ours, and the figures of docs/thesis/variability.md.

    python benchmarks/variability.py ../shared/thesis/tables/table_2_7.csv [folder for the figures]

The points file is Table 2.7 (X,Y,Z,U1,V1,U2,V2), both camera positions. Printed numbers stand in this script. The noise
is the dissertation's, sqrt(sum of squares/22) of its own transform.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from cadcam.arrays import Array
from cadcam.calibrate.points.camera import Method, calibrate_camera
from cadcam.calibrate.variability.alternating import alternating_externals
from cadcam.calibrate.variability.methods import (
    FirstOrder,
    Variability,
    first_order_variability,
    log_likelihood,
    markov_chain_variability,
    monte_carlo_variability,
    walk_of,
)
from cadcam.calibrate.variability.projection_map import projection_map
from cadcam.calibrate.variability.repeated import model_of
from cadcam.camera.estimate import CameraEstimate
from cadcam.camera.extended_pinhole import NAMES
from cadcam.camera.lens import BrownConrady
from cadcam.files.points import read_points
from cadcam.fit.sampling import Walk, effective_size, metropolis
from cadcam.report.variability import shown
from cadcam.report.variability_plots import write_plots

SIZE = (768, 576)
# Tables 2.14 and 2.19: mean and standard deviation by Method A; then by Method B (position 1 only)
PRINTED_A = {
    1: ((8.31, 1.09), (415.24, 1.33), (-216.14, 6.09), (-8.91, 0.48), (-9.50, 0.52), (-2.33, 0.10), (1.00727, 0.00209),
        (801.05, 5.48), (0.00651, 0.11861), (320.28, 7.29), (356.34, 6.67)),
    2: ((6.07, 1.22), (204.85, 1.03), (-215.64, 6.64), (6.69, 0.55), (-9.61, 0.60), (0.230, 0.116), (1.00534, 0.00253),
        (799.93, 6.00), (-0.28261, 0.14413), (318.34, 8.31), (307.32, 7.59)),
}  # fmt: skip
PRINTED_B = ((8.06, 1.25), (416.01, 1.33), (-213.24, 6.01), (-9.46, 0.57), (-9.64, 0.51), (-2.43, 0.12),
             (1.00773, 0.00233), (803.01, 5.26), (-0.00963, 0.13088), (322.66, 7.08), (348.93, 7.96))  # fmt: skip
PRINTED_ALTERNATING = (0.00241, 2.17, 0.12501, 2.18, 2.14)  # Table 2.17: standard deviations of the internals


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("points", type=Path, help="Table 2.7 as a points file")
    parser.add_argument("figures", nargs="?", type=Path, help="folder for the figures")
    given = parser.parse_args()
    seen = {i: read_points(given.points, columns=(f"U{i}", f"V{i}")) for i in (1, 2)}
    linear = {i: calibrate_camera(o, SIZE, method="dlt-c23") for i, o in seen.items()}
    best = {i: calibrate_camera(o, SIZE) for i, o in seen.items()}
    noise = {i: float(np.sqrt(e.sum_of_squares / 22)) for i, e in linear.items()}
    studies = {}
    for i in (1, 2):
        studies[i] = monte_carlo_variability(linear[i], rng=rng(i), draws=2000, sigma_px=noise[i], method="dlt-c23")
        method_a(i, noise[i], studies[i])
    chain = markov_chain_variability(best[1], rng=rng(3), sigma_px=noise[1])
    method_b(noise[1], chain, best[1], linear[1])
    unpreconditioned(noise[1], best[1])
    alternating(noise[1], best[1], linear[1])
    radial(best, {i: calibrate_camera(o, SIZE, lens=BrownConrady(), free_lens=("k1",)) for i, o in seen.items()})
    if given.figures is not None:
        figures(given.figures, noise[1], best[1], chain)


def rng(study: int) -> np.random.Generator:
    return np.random.default_rng([2, study])


def method_a(position: int, noise: float, study: Variability) -> None:
    print(f"Method A, position {position}: 2000 sets at {noise:.4f} px, by the dissertation's transform")
    print(f"{'':8s}{'exact':>10s}{'mean':>10s}{'printed':>10s}{'sigma':>10s}{'printed':>10s}{'min':>10s}{'max':>10s}")
    columns = (study.exact, study.mean, study.sigma, study.minimum, study.maximum)
    exact, mean, sigma, low, high = (shown(NAMES, c) for c in columns)
    for k, name in enumerate(NAMES):
        d = 5 if sigma[k] < 0.01 else 3
        their_mean, their_sigma = PRINTED_A[position][k]
        numbers = (exact[k], mean[k], their_mean, sigma[k], their_sigma, low[k], high[k])
        print(f"{name:8s}" + "".join(f"{x:10.{d}f}" for x in numbers))
    print()


def method_b(noise: float, study: Variability, best: CameraEstimate, linear: CameraEstimate) -> None:
    first = first_order_variability(best, sigma_px=noise)
    mean, sigma, expected = shown(NAMES, study.mean), shown(NAMES, study.sigma), shown(NAMES, first.sigma)
    steps = study.draws.shape[0] * walk_of(1_000_000).steps
    print(f"Method B, position 1: {steps} Metropolis steps at {noise:.4f} px; R-hat {study.r_hat.max():.4f}, effective "
          f"{study.effective.min():.0f} of them")  # fmt: skip
    print(f"{'':8s}{'mean':>10s}{'printed':>10s}{'off/sigma':>10s}{'sigma':>10s}{'printed':>10s}{'first order':>13s}")
    for k, name in enumerate(NAMES):
        d = 5 if sigma[k] < 0.01 else 3
        their_mean, their_sigma = PRINTED_B[k]
        off = (their_mean - mean[k]) / sigma[k]
        print(f"{name:8s}{mean[k]:10.{d}f}{their_mean:10.{d}f}{off:10.2f}{sigma[k]:10.{d}f}{their_sigma:10.{d}f}"
              f"{expected[k]:13.{d}f}")  # fmt: skip
    theirs = np.array([m for m, _ in PRINTED_B]) / shown(NAMES, np.ones(len(NAMES)))
    for centre, estimate in (("least squares", best), ("its transform's camera", linear)):
        print(f"printed means about {centre}: as of {implied(theirs, first, estimate.values):.1f} independent draws")
    print(f"our means about least squares: as of {implied(study.mean, first, best.values):.0f}\n")


def implied(mean: Array, first: FirstOrder, centre: Array) -> float:
    """Return how many independent draws have a mean as far off: expected chi-square by squared distance."""
    off = mean - centre
    return len(off) / float(off @ np.linalg.solve(first.covariance, off))


def unpreconditioned(noise: float, best: CameraEstimate) -> None:
    """Print what steps of each parameter by itself are worth, of a size that is accepted 23 % of the time."""
    first = first_order_variability(best, sigma_px=noise)
    model, state = model_of(best)
    density = log_likelihood(model, state, noise)
    generator = rng(4)
    factor = np.linalg.cholesky(first.covariance)
    starts = first.exact + generator.standard_normal((64, len(first.exact))) @ factor.T
    print("Effective draws of a million Metropolis steps, started where they should end")
    for label, shape, steps in (("shaped by the covariance", factor, 15_000), ("each parameter by itself",
                                np.diag(first.sigma), 60_000)):  # fmt: skip
        kept = metropolis(density, starts, np.asarray(shape), Walk(steps, 1000, 10), rng=generator)
        size = effective_size(kept.draws) / (64 * steps) * 1e6
        print(f"{label:28s}{size.min():8.0f}")
    print()


def alternating(noise: float, best: CameraEstimate, linear: CameraEstimate) -> None:
    print("Alternating externals: sigma of the internals; correlations of the errors; the largest with the drawn poses")
    print(f"{'':46s}{'aspect':>9s}{'focal':>8s}{'skew':>8s}{'U0':>8s}{'V0':>8s}{'b-U0':>7s}{'a-V0':>7s}{'drawn':>7s}")
    print(f"{'Table 2.17, 2.18 (range not printed)':46s}" + row(np.array(PRINTED_ALTERNATING)) + f"{'':14s}{0.06:7.2f}")
    kinds: list[tuple[str, Method, int, int, bool]] = [
        ("least squares", "reprojection", mm, deg, True) for mm, deg in ((30, 3), (200, 10), (600, 30))
    ]
    kinds += [("C23 = 1", "dlt-c23", 200, 10, True), ("normalised transform", "dlt", 200, 10, True)]
    kinds += [("normalised, seen or not", "dlt", 100, 180, False), ("C23 = 1, seen or not", "dlt-c23", 100, 180, False)]
    for label, method, mm, deg, visible in kinds:
        study = alternating_externals(
            best if method == "reprojection" else linear,
            rng=rng(5),
            spread_mm=mm,
            spread_deg=deg,
            sigma_px=noise,
            method=method,
            visible=visible,
        )
        sigma, r = shown(NAMES, study.errors.sigma)[6:], study.errors.correlation
        drawn = np.abs(study.correlation_with_drawn[:6, 6:]).max()
        name = f"{label}, +-{mm} mm, +-{deg} deg"
        print(f"{name:46s}{row(sigma)}{r[4, 9]:7.2f}{r[3, 10]:7.2f}{drawn:7.2f}")
    print()


def row(sigma: Array) -> str:
    return f"{sigma[0]:9.4f}{sigma[1]:8.2f}{sigma[2]:8.3f}{sigma[3]:8.2f}{sigma[4]:8.2f}"


def radial(best: dict[int, CameraEstimate], better: dict[int, CameraEstimate]) -> None:
    print("The same points with one radial term: residual, focal length and principal point of both positions")
    for label, both in (("pinhole", best), ("with k1", better)):
        for i, e in both.items():
            numbers = "".join(f"   {n} {e.value(n):7.2f} +- {e.sigma(n):.2f}" for n in ("focal", "U0", "V0"))
            print(f"{label}, position {i}   residual {e.thesis_residual:.3f}{numbers}")
    for i in (1, 2):
        gain = best[i].sum_of_squares - better[i].sum_of_squares
        print(f"F of k1, position {i}: {gain / (better[i].sum_of_squares / better[i].dof):.0f} (1 and {better[i].dof})")
    print()


def figures(folder: Path, noise: float, best: CameraEstimate, chain: Variability) -> None:
    studies = {
        "Monte Carlo": monte_carlo_variability(best, rng=rng(6), draws=10_000, sigma_px=noise),
        "Markov chain": chain,
    }
    for path in write_plots(folder, studies, first_order_variability(best, sigma_px=noise), projection_map(best)):
        print(f"wrote {path}")


if __name__ == "__main__":
    main()
