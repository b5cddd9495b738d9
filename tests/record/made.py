"""Sample records."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from cadcam.camera.pose_estimate import PoseEstimate
from cadcam.geometry.rigid import Rigid
from cadcam.record.record import Deviation, Record, Source

NOON = datetime(2026, 3, 2, 12, tzinfo=UTC)


def pose(rng: np.random.Generator) -> PoseEstimate:
    """Return a pose whose every number has all its bits."""
    A = rng.normal(size=(6, 6))
    B = rng.normal(size=(6, 6))
    freedom = np.linalg.qr(rng.normal(size=(6, 3)))[0]
    T = Rigid.exp(rng.normal(size=6) * [100, 100, 900, 1, 1, 1])
    return PoseEstimate(T, A @ A.T, B @ B.T, freedom, 37.5, rng.normal(size=(6, 1)))


def record(n: int = 0, **given: Any) -> Record:
    """Return the n-th part's record: measured n minutes after noon, its stiffener 0.1 n mm off, its face 0.2 deg."""
    deviations = (
        Deviation("stiffener", 0.1 * n, 0.25, lower=-1.0, upper=1.0, verdict="PASS"),
        Deviation("face", 0.2, 0.05, kind="angle", unit="deg", k=3.0, upper=0.5),
    )
    sources = (Source("photo", "pictures/ü 1.png", "ab" * 32), Source("cad", "bracket.step", "0c" * 32))
    values: dict[str, Any] = {
        "part": "bracket",
        "serial": f"S{n:03d}",
        "station": "cell 3",
        "time": NOON + timedelta(minutes=n),
        "verdict": "PASS",
        "reason": "all within",
        "quality": 0.9,
        "pose": pose(np.random.default_rng(n)),
        "deviations": deviations,
        "sources": sources,
    }
    return Record(**(values | given))
