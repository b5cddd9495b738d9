"""The brightness that a fitted light predicts: that of the normal distributions that it stands for, at any number."""

from __future__ import annotations

import numpy as np
import pytest

from cadcam.locate.quality import light as light_module
from cadcam.locate.quality.light import FittedLight

EPS = float(np.finfo(np.float64).eps)


@pytest.mark.parametrize("n", [0, 1, 5, 9, 200])
def test_brightness_is_the_product_of_both_distributions_without_inverting_matrices_of_all_surfaces(
    n: int, monkeypatch: pytest.MonkeyPatch, rng: np.random.Generator
) -> None:
    """What the light says of the surfaces, N(m, A), times how bright surfaces are, N(mean, t), with dense matrices.

    Each of the two inversions rounds by the condition of what it inverts, at most (a + |A|)/a and |A|/a.
    """
    root = rng.normal(size=(9, 9))
    light = FittedLight(0.2 * rng.normal(size=9), 0.01 * root @ root.T, {0: 1.0, 1: 0.7}, 0.5, 0.01, 0.4, 0.1)
    normal = rng.normal(size=(n, 3))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    color = rng.integers(0, 3, n).astype(np.int32)
    gain = np.array([light.gain.get(int(c), 1.0) for c in color])
    by = gain[:, None] * light_module._basis(normal)
    own = light.scale**2 + (light_module._HIGHER_TERMS * (light.mean + 2 * light.spread)) ** 2
    A = by @ light.covariance @ by.T + own * np.eye(n)
    told = np.linalg.inv(A)
    covariance = np.linalg.inv(told + np.eye(n) / light.spread**2)
    expected = covariance @ (told @ (by @ light.form) + light.mean / light.spread**2)

    inverted: list[int] = []
    plain = np.linalg.inv
    monkeypatch.setattr(np.linalg, "inv", lambda a: inverted.append(len(a)) or plain(a))
    tone, stated = light.brightness_and_covariance(normal, color)

    assert max(inverted, default=0) <= 9
    rounding = 8 * EPS * max(n, 1) * (1 + np.linalg.norm(A) / own)
    np.testing.assert_allclose(tone, expected, atol=rounding)
    np.testing.assert_allclose(stated, covariance, atol=rounding * light.spread**2)
