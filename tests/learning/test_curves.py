"""Curves that joints one after another, or the slow error of a tracker, could explain as well."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

ROWS = 140


def sweeps(times, rows=ROWS):
    """Share of the way, there and back so often; it slows down where it turns."""
    return 0.5 - 0.5 * np.cos(np.pi * times * np.linspace(0.0, 1.0, rows))


def seen(position, turned, seed, noise=0.001):
    """Poses at (n, 3) positions and rotation vectors in a drawn base frame, with noise."""
    rng = np.random.default_rng([seed, 4])
    base = Rotation.random(rng=rng)
    rotation = base * Rotation.from_rotvec(turned) * Rotation.from_rotvec(2 * noise * rng.standard_normal((ROWS, 3)))
    place = base.apply(position) + noise * rng.standard_normal((ROWS, 3))
    return Recording(0.1 * np.arange(ROWS), place, rotation.as_quat())


def tilting(tilt, times, seed):
    """Slides straight by 35 cm and tilts on the way."""
    s = sweeps(times)
    return seen(np.outer(s, [0.35, 0.0, 0.0]), np.outer(tilt * s, [0.0, 1.0, 0.3]) / np.hypot(1.0, 0.3), seed)


def cosine(seed, rows=ROWS):
    """Along a cosine once, and turned as the curve is."""
    x = np.linspace(0.0, 1.0, rows)
    slope = -0.12 * 2.0 * np.pi * np.sin(2.0 * np.pi * x)
    turned = np.outer(np.arctan(slope), [0.0, 0.0, 1.0])
    return seen(np.stack([x, 0.12 * np.cos(2.0 * np.pi * x), 0.0 * x], axis=1), turned, seed)


def chain(seed):
    """Two slides, one after another."""
    s = (
        np.clip(np.linspace(0.0, 2.0, ROWS), 0.0, 1.0)[:, None],
        np.clip(np.linspace(-1.0, 1.0, ROWS), 0.0, 1.0)[:, None],
    )
    rng = np.random.default_rng([seed, 9])
    ways = rng.normal(size=(2, 3))
    ways *= rng.uniform(0.2, 0.4, (2, 1)) / np.linalg.norm(ways, axis=1)[:, None]
    return seen(s[0] * ways[0] + s[1] * ways[1], np.zeros((ROWS, 3)), seed)


def answer(recording):
    """Kinds of the segments that move, in their order; a part that no joint holds is `none`."""
    (edge,) = learn_graph(recording).edges
    return ["none" if one.no_single_joint is not None else one.joint.kind for one in edge.segments if one.joint.moves]


@pytest.mark.parametrize(
    ("tilt", "times"),
    [(0.6, 2), pytest.param(0.6, 3, marks=pytest.mark.slow), pytest.param(0.7, 4, marks=pytest.mark.slow)],
)
def test_a_part_that_tilts_while_it_slides_moves_along_a_path(tilt, times) -> None:
    assert answer(tilting(tilt, times, seed=times)) == ["path"]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(3))
def test_a_part_that_slides_straight_does_not(seed) -> None:
    assert answer(tilting(0.0, 3, seed)) == ["prismatic"]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_a_curve_is_no_chain_of_joints(seed) -> None:
    assert answer(cosine(seed)) == ["none"]


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(4))
def test_a_chain_of_joints_is_no_curve(seed) -> None:
    assert answer(chain(seed)) == ["prismatic", "prismatic"]
