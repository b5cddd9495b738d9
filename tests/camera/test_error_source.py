"""What errors do to what is measured: those of one owner are one."""

from __future__ import annotations

import numpy as np

from cadcam.camera.error_source import ErrorSource, by_unit_errors, covariance_of, distinct_sources


def test_effects_of_one_owner_add_wherever_they_are_summed(rng: np.random.Generator) -> None:
    """Of a camera's errors two effects, told one by one: the last one alone counted."""
    root = rng.normal(size=(3, 2))  # singular, as of a calibration with a fixed parameter
    camera, hand = object(), object()
    one, again = (ErrorSource(name, root @ root.T, camera) for name in ("lens", "mount"))
    other = ErrorSource("hand-eye", np.eye(2), hand)
    effects = [(one, rng.normal(size=(5, 3))), (other, rng.normal(size=(5, 2))), (again, rng.normal(size=(5, 3)))]
    sources = distinct_sources([source for source, _ in effects])
    E, columns = by_unit_errors(effects, sources, (5,))
    assert [(c.start, c.stop) for c in columns] == [(0, 3), (3, 5)]
    np.testing.assert_allclose(E @ E.T, covariance_of(effects, 5), atol=1e-12)
