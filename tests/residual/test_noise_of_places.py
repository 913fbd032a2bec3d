"""Where a sensor sees better at some places than at others, errors are judged by what it sees there."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic
from micah_plan.automaton.sensing import Light
from micah_plan.automaton.tracks import tracks
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.examined import examined
from micah_plan.residual.prediction import first_belief
from micah_plan.residual.row_ends import annotated_rows

LENGTH, AT, GROWTH, STD, MOVED = 1.0, 0.2, 0.1, 0.002, 0.001


def slide(growth=GROWTH):
    """Slides over a metre, seen best at 0.2 m."""
    only = Segment(
        prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0, 0, 99, 0.0, LENGTH, (0.0, LENGTH), 0.001, 0.002, 0.0, 1.0
    )
    made = build_automaton(KinematicGraph((KinematicEdge(BASE, "part", (only,)),)))
    light = Light(((0, AT),), (growth,)) if growth else None
    return replace(made, noise=replace(made.noise, process_std=(MOVED,), observation_std=(STD,), light=light))


def recorded(seed, growth=GROWTH, gain=1.0, runs=5, rows=40):
    """Runs to and fro between drawn places; commands are known exactly, and only the measurement is noise."""
    rng = np.random.default_rng(seed)
    z, u = np.zeros((runs, rows)), np.zeros((runs, rows))
    for run in range(runs):
        c, goal = rng.uniform(0.1, 0.9, 2)
        for k in range(rows):
            z[run, k] = c + np.hypot(STD, growth * (c - AT)) * rng.standard_normal()
            if abs(goal - c) < 0.02:
                goal = rng.uniform(0.1, 0.9)
            u[run, k] = np.clip(goal - c, -0.05, 0.05) * rng.uniform(0.3, 1.0)
            c = float(np.clip(c + gain * u[run, k] + MOVED * rng.standard_normal(), 0.0, LENGTH))
    position, action = np.zeros((z.size, 3)), np.zeros((z.size, 3))
    position[:, 0], action[:, 0] = z.ravel(), u.ravel()
    return Recording(
        time=np.tile(0.1 * np.arange(rows), runs),
        position=position,
        quaternion=np.tile([0.0, 0.0, 0.0, 1.0], (z.size, 1)),
        action=action,
        run=np.repeat(np.arange(runs), rows),
    )


def test_the_noise_of_a_row_is_that_of_its_place_and_not_of_what_was_read() -> None:
    """A filter knows the place better than one measurement does, so its stds are nearer to those of the true place."""
    model, recording = slide(0.4), recorded(3, growth=0.4)
    sensing = model.sensing(model.modes[0])
    true = tracks(model, recorded(3, growth=0.0))  # the same draws
    seen = tracks(model, recording)
    away, naive = [], []
    for own, read in zip(true, seen, strict=True):
        truth = sensing.std_at(own.x)
        away.append(np.abs(np.log(annotated_rows(model, read).stds / truth))[10:])
        naive.append(np.abs(np.log(sensing.std_at(read.x) / truth))[10:])
    assert np.median(np.concatenate(away)) < 0.7 * np.median(np.concatenate(naive))


def test_a_first_measurement_is_believed_as_far_as_its_place_allows() -> None:
    (track, *_) = tracks(slide(), recorded(0))
    # The last one lies outside of the range, by less than it is uncertain by.
    for place, std in ((AT, STD), (0.9, np.hypot(STD, 0.7 * GROWTH)), (1.15, np.hypot(STD, 0.95 * GROWTH))):
        at = replace(track, x=np.full_like(track.x, place))
        assert np.sqrt(first_belief(slide(), at).covariance[0, 0]) == pytest.approx(std, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("growth", [0.0, GROWTH])
def test_innovations_over_their_spread_are_equally_large_everywhere(growth) -> None:
    (model,) = examined(slide(), recorded(1, growth=growth)).models
    rows = model.data.counted
    own = model.errors(model.nominal, "filter") / model.spread(model.nominal)
    near = np.abs(model.data.z - AT) < 0.25
    ratio = np.std(own[rows & near]) / np.std(own[rows & ~near])
    # Where the log knows no dark places, the likelihood takes noise that is the same everywhere.
    assert ratio == pytest.approx(1.0, abs=0.25)
    assert np.ptp(model.data.noise) > 1.0 if growth else np.ptp(model.data.noise) == 0.0


@pytest.mark.slow
def test_nothing_is_found_where_only_the_noise_depends_on_the_place() -> None:
    assert examined(slide(), recorded(2)).is_noise


@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=pytest.mark.evidence if seed else pytest.mark.slow) for seed in range(3)]
)
def test_a_gain_is_found_behind_noise_that_depends_on_the_place(seed) -> None:
    honest, weak = calibrate(slide(), recorded(seed)), calibrate(slide(), recorded(seed, gain=0.75))
    assert honest.verdict == "none"
    assert weak.verdict == "explained"
    ((gain,), (low, high)) = weak.effects[0].effect.values, weak.effects[0].interval[0]
    assert "gain" in (weak.effects[0].effect.name, *weak.effects[0].tied)
    assert low < 0.75 < high
    assert gain == pytest.approx(0.75, abs=0.06)
