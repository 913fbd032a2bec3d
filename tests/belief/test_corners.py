"""Many Gaussians split at once, in closed form where there is one, against the quadrature of one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from micah_plan.belief import truncation as scalar
from micah_plan.belief.batch import truncation as batch
from micah_plan.belief.batch.corners import corner, half_plane

COUNT = 300


def joints(kind: str, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Means, factors and margins (weights, offsets) at start and end, of steps that go with any noise."""
    mean, factor = np.zeros((COUNT, 4)), rng.normal(size=(COUNT, 4, 4))
    before, after = rng.normal(size=(COUNT, 4)), rng.normal(size=(COUNT, 4))
    if kind == "a step with a little noise":
        after = before + 10.0 ** rng.uniform(-5, 0, size=(COUNT, 1)) * after
    if kind == "a known start":
        before = np.zeros((COUNT, 4))
    stds = [np.linalg.norm((w[:, None] @ factor)[:, 0], axis=1) for w in (before, after)]
    start = np.where(stds[0] == 0, 1.0, stds[0] * rng.uniform(-1.0, 6.0, COUNT))
    return mean, factor, before, start, after, stds[1] * rng.uniform(-6.0, 6.0, COUNT)


@pytest.mark.parametrize("kind", ["anything", "a step with a little noise", "a known start"])
def test_all_at_once_is_the_quadrature(kind: str) -> None:
    mean, factor, before, start, after, end = joints(kind, np.random.default_rng(4))
    together = batch.split(mean, factor, (before, start), (after, end))
    seen = 0
    for i in range(COUNT):
        alone = scalar.split(mean[i], factor[i], (before[i], start[i]), (after[i], end[i]))
        for one, all_of_them in zip(alone, together, strict=True):
            assert all_of_them.probability[i] == pytest.approx(one.probability, rel=1e-6, abs=1e-10)
            if one.probability < 1e-7:
                continue
            seen += 1
            np.testing.assert_allclose(all_of_them.mean[i], one.mean, rtol=0, atol=1e-6)
            found = all_of_them.factor[i] @ all_of_them.factor[i].T
            np.testing.assert_allclose(found, one.factor @ one.factor.T, rtol=1e-5, atol=1e-5)
    assert seen > COUNT


@pytest.mark.parametrize("offset", [-7.0, 0.0, 1.3, 6.5])
def test_a_half_plane_has_the_moments_of_the_truncated_normal(offset: float) -> None:
    moments = half_plane(np.array([-1.0]), np.array([offset]))
    center = moments.first[0, 0] / moments.mass[0]
    assert moments.mass[0] == pytest.approx(norm.sf(offset), rel=1e-12)
    assert center == pytest.approx(-norm.pdf(offset) / norm.sf(offset), rel=1e-12)
    assert moments.second[0, 0, 0] / moments.mass[0] == pytest.approx(1 - offset * center, rel=1e-12)


@pytest.mark.parametrize(("first", "second"), [(0.0, 0.0), (0.0, 1.2), (-0.7, 0.0), (1.5, -2.0), (2.5, 2.0)])
@pytest.mark.parametrize("angle", [0.3, 1.2, 2.8])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_corner_has_the_mass_of_the_bivariate_normal(first: float, second: float, angle: float, sign: float) -> None:
    normal = np.array([np.cos(angle), np.sin(angle)])
    moments = corner(np.array([sign]), np.array([first]), normal[None], np.array([second]))
    tilt = sign * normal[0]
    expected = multivariate_normal.cdf([-first, -second], cov=[[1.0, tilt], [tilt, 1.0]], abseps=1e-10, releps=1e-10)
    assert moments.mass[0] == pytest.approx(expected, abs=1e-8)
    grid = np.linspace(-9.0, 9.0, 901)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    density = np.exp(-0.5 * (x**2 + y**2)) / (2 * np.pi) * (grid[1] - grid[0]) ** 2
    density *= (sign * x > first) & (normal[0] * x + normal[1] * y > second)
    np.testing.assert_allclose(moments.first[0], [(density * x).sum(), (density * y).sum()], atol=1e-2)
    mixed = (density * x * y).sum()
    pairs = [[(density * x * x).sum(), mixed], [mixed, (density * y * y).sum()]]
    np.testing.assert_allclose(moments.second[0], pairs, atol=2e-2)
