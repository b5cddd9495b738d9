import numpy as np
from .test_measure_coverage import drawn, fixed


def test_tmp():
    z, square, length, chi2, dof = drawn(fixed, 3000, 77, lambda d: lambda eye, rng: eye.calibrated(rng))
    print((np.abs(z) < 1.96).mean(axis=0), z.mean(axis=0), z.std(axis=0), square.mean() / 6)
