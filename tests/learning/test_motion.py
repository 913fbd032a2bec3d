"""The filter of configurations against the density of all rows at once."""

from __future__ import annotations

import numpy as np
from scipy.stats import multivariate_normal

from micah_plan.learning.segmenting.motion import innovations_of
from micah_plan.learning.segmenting.noise import NoiseScales


def test_innovations_are_those_of_the_normal_density_of_all_rows() -> None:
    """Configurations on a random walk with white noise and two wanders, as one dense covariance given the first row."""
    rng, n = np.random.default_rng(0), 12
    white, fast, slow, fast_kept, slow_kept = rng.uniform(0.1, 0.9, (5, 2))
    walk = np.array([[0.0, 0.3, 2.0], [0.1, 0.0, 0.5]])
    scale = rng.uniform(0.5, 2.0, (2, n))
    rows = np.cumsum(rng.normal(size=(2, n)), axis=1)
    along = NoiseScales(white, fast, slow, fast_kept, slow_kept)
    innovation, variance = innovations_of(rows[..., None], along, np.broadcast_to(walk, (n - 1, 2, 3)), scale)

    index = np.arange(n)
    apart, common = np.abs(index[:, None] - index), np.minimum(index[:, None], index)
    for h in range(2):
        # The slow wander goes with the part: what is new of it in a row stays.
        renewed = slow[h] * (1 - slow_kept[h] ** 2)
        noise = white[h] * scale[h]
        noise[0] = white[h]
        for g in range(3):
            given = (walk[h, g] + renewed) * common + fast[h] * fast_kept[h] ** apart + np.diag(noise)
            # Where the first row is, is not known at all: only differences from it tell.
            of_differences = np.eye(n)[1:] - np.eye(n)[0]
            covariance = of_differences @ given @ of_differences.T
            dense = multivariate_normal.logpdf(rows[h, 1:] - rows[h, 0], cov=covariance)
            s, v = variance[:, h, g] + walk[h, g], innovation[0, :, h, g]
            np.testing.assert_allclose(-0.5 * (np.log(2 * np.pi * s) + v**2 / s).sum(), dense, rtol=1e-10)
