"""Moments of what a guard cuts off: closed forms against the quadrature and against SciPy's distributions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from micah_plan.belief.plane_moments import MASS, XX, XY, YY, X, Y, half_planes, wedge
from micah_plan.belief.truncation import _integrate, _moments_of_shares, _Plane

COUNT = 300


@pytest.mark.parametrize("kind", ["anything", "a step with a little noise"])
def test_closed_forms_are_the_quadrature(kind: str) -> None:
    """Of starts in front of the guard and behind it."""
    rng = np.random.default_rng(4)
    plane = _Plane(
        m0=rng.uniform(-6.0, 1.0, COUNT),
        s0=np.ones(COUNT),
        m1=rng.uniform(-6.0, 6.0, COUNT),
        k=rng.uniform(0.2, 1.5, COUNT),
        t=10.0 ** rng.uniform(-5, 0, COUNT) if "little" in kind else rng.uniform(0.1, 2.0, COUNT),
    )
    inside = plane.m0 > 0
    together, alone = _moments_of_shares(plane, inside), _integrate(plane, inside)
    certain = np.maximum(together[MASS], alone[MASS]) > 1e-7
    assert certain.mean() > 0.5
    np.testing.assert_allclose(together[:, certain], alone[:, certain], rtol=1e-5, atol=1e-7)


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
@pytest.mark.parametrize("slope", [0.4, 1.2, -3.0])
def test_a_wedge_has_the_moments_of_the_bivariate_normal(place: float, height: float, slope: float) -> None:
    """Over slope (x - place) + spread (y - height) > 0, left of x = place."""
    spread = 0.8
    offset = -slope * place - spread * height
    moments, _ = wedge(*(np.array([value]) for value in (place, slope, spread, offset)))
    grid = np.linspace(-9.0, 9.0, 900)
    x, y = np.meshgrid(grid, grid, indexing="ij")
    density = np.exp(-0.5 * (x**2 + y**2)) / (2 * np.pi) * (grid[1] - grid[0]) ** 2
    size = np.hypot(slope, spread)
    tilt = -slope / size
    limits = [place, offset / size]
    expected = multivariate_normal.cdf(limits, cov=[[1.0, tilt], [tilt, 1.0]], abseps=1e-10, releps=1e-10)
    assert moments[MASS, 0] == pytest.approx(expected, abs=1e-8)
    inside = density * (x < place) * (slope * (x - place) + spread * (y - height) > 0)
    for of, value in ((X, x), (Y, y), (XX, x * x), (XY, x * y), (YY, y * y)):
        assert moments[of, 0] == pytest.approx((inside * value).sum(), abs=2e-2)
