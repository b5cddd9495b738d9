"""Parametric sample parts for examples, tests and benchmarks, without any file."""

from cadcam.cad.parts.bench import BENCH_POINTS, calibration_bench
from cadcam.cad.parts.bracket import machined_bracket
from cadcam.cad.parts.shipblock import ship_block

__all__ = ["BENCH_POINTS", "calibration_bench", "machined_bracket", "ship_block"]
