"""Many Gaussians split at once, in closed form where there is one, against the quadrature of one after the other."""

from __future__ import annotations

import numpy as np
import pytest
from scalar_belief import scalar_truncation as scalar
from scipy.stats import multivariate_normal, norm

from micah_plan.belief.truncation import MASS, XX, XY, YY, Margins, X, Y, half_planes, split, wedges

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
    rows = np.array([np.einsum("pi,pik->kp", weights, factor) for weights in (before, after)])
    margins = Margins(np.array([-start, -end]), rows)  # the means are 0
    together = split(mean.T, factor.transpose(1, 2, 0), margins)
    can, seen = margins.can_cross(np.ones(COUNT)), 0
    for i in range(COUNT):
        alone = scalar.split(mean[i], factor[i], (before[i], start[i]), (after[i], end[i]))
        if not can[i]:  # filters do not ask then
            assert alone[0].probability < 1e-10
            continue
        for number, one in enumerate(alone):
            assert together.probability[number, i] == pytest.approx(one.probability, rel=1e-6, abs=1e-10)
            if one.probability < 1e-7:
                continue
            seen += 1
            np.testing.assert_allclose(together.mean[number, :, i], one.mean, rtol=0, atol=1e-6)
            root = together.factor[number, :, :, i]
            np.testing.assert_allclose(root @ root.T, one.factor @ one.factor.T, rtol=1e-5, atol=1e-5)
    assert seen > COUNT


@pytest.mark.parametrize("offset", [-7.0, 0.0, 1.3, 6.5])
def test_a_half_plane_has_the_moments_of_the_truncated_normal(offset: float) -> None:
    moments = half_planes(np.array([offset]))
    for side, sign in ((0, 1.0), (1, -1.0)):  # above the offset, and below it
        mass, center, second = (moments[of, side, 0] for of in (MASS, X, XX))
        center, second = center / mass, second / mass
        assert mass == pytest.approx(norm.sf(sign * offset), rel=1e-12)
        assert center == pytest.approx(sign * norm.pdf(offset) / norm.sf(sign * offset), rel=1e-12)
        assert second == pytest.approx(1 + offset * center, rel=1e-12)
        assert moments[YY, side, 0] == pytest.approx(mass, rel=1e-12)
        assert moments[Y, side, 0] == moments[XY, side, 0] == 0.0


@pytest.mark.parametrize(("place", "height"), [(0.0, 0.0), (0.0, 1.2), (-0.7, 0.0), (1.5, -2.0), (2.5, 2.0)])
@pytest.mark.parametrize(("left", "right"), [(0.4, 0.4), (1.2, -2.8), (-3.0, 0.1)])
def test_wedges_have_the_moments_of_the_bivariate_normal(
    place: float, height: float, left: float, right: float
) -> None:
    """Over slope (x - place) + spread (y - height) > 0, left and right of x = place."""
    spread, slopes = 0.8, np.array([[left], [right]])
    moments, _ = wedges(np.array([place]), slopes, np.array([spread]), -slopes * place - spread * height)
    grid = np.linspace(-9.0, 9.0, 900)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    density = np.exp(-0.5 * (x**2 + y**2)) / (2 * np.pi) * (grid[1] - grid[0]) ** 2
    for side, sign in ((0, -1.0), (1, 1.0)):
        slope = slopes[side, 0]
        size = np.hypot(slope, spread)
        tilt = sign * slope / size
        limits = [-sign * place, (-slope * place - spread * height) / size]
        expected = multivariate_normal.cdf(limits, cov=[[1.0, tilt], [tilt, 1.0]], abseps=1e-10, releps=1e-10)
        assert moments[MASS, side, 0] == pytest.approx(expected, abs=1e-8)
        inside = density * (sign * (x - place) > 0) * (slope * (x - place) + spread * (y - height) > 0)
        for of, value in ((X, x), (Y, y), (XX, x * x), (XY, x * y), (YY, y * y)):
            assert moments[of, side, 0] == pytest.approx((inside * value).sum(), abs=2e-2)
