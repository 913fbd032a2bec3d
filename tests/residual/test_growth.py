"""What is taken into a model: what helps single steps, adds up to less, and does not rest on one run alone."""

from __future__ import annotations

import numpy as np
import planted_effects as plants
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.joint import prismatic
from micah_plan.message import codes_of
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.contenders import is_confirmed


@pytest.mark.parametrize(
    ("gains", "expected"),
    [
        ([4.0, 4.0, 4.0, 4.0, 4.0], True),
        ([0.3, 16.0, 29.0, -0.2, 0.1], True),  # two runs that are held out from each other
        ([0.0, 0.0, 40.0, 0.0, 0.0], False),  # one run alone may be an accident
        ([20.0, -9.0, 15.0, -8.0, 2.0], False),  # as much lost elsewhere
        ([0.4, 0.4, 0.4, 0.4, 0.1], False),
    ],
)
def test_evidence_must_come_from_more_than_one_run_and_not_be_lost_in_others(gains, expected) -> None:
    assert is_confirmed(np.array(gains)) is expected


@pytest.mark.parametrize(
    ("gains", "by_itself", "expected"),
    [
        ([4.0, 4.0, 4.0, 4.0, 65.0], [0.0, 0.0, 0.0, 0.0, 60.0], False),  # all runs seem less noisy
        ([4.0, 4.0, 20.0, 20.0, 20.0], [0.0, 0.0, 18.0, 18.0, 18.0], True),
        ([4.0, 4.0, 4.0, 4.5, 65.0], [0.0, 0.0, 0.0, 2.0, 60.0], False),  # the end of one run, and the last
        ([0.0, 0.0, 0.0, 0.0, 65.0], [0.0, 0.0, 9.0, 9.0, 60.0], False),  # others show it, but not beside the rest
    ],
)
def test_what_acts_in_one_run_alone_is_not_borne_out_by_others(gains, by_itself, expected) -> None:
    assert is_confirmed(np.array(gains), [np.array(by_itself)]) is expected


def drawer_with_two_effects(seed):
    """Runs of one or two long steps that go too far, then short ones that move nothing: their sums nearly agree."""
    rng = np.random.default_rng(seed)
    columns = {name: [] for name in ("time", "position", "action", "run")}
    for run in range(6):
        c, x, a = 0.0, [], []
        for u in (0.09, 0.05, 0.009, 0.008, 0.0005, 0.0001, 0.0, 0.0, 0.0):
            x.append(c + 0.0003 * rng.standard_normal())
            a.append(u)
            c += u * (1.1 + 0.02 * rng.standard_normal()) if u > 0.012 else 0.0
        columns["time"].append(np.arange(9.0))
        columns["position"].append(np.stack([x, np.zeros(9), np.zeros(9)], axis=1))
        columns["action"].append(np.stack([[*a[:-1], np.nan], np.zeros(9), np.zeros(9)], axis=1))
        columns["run"].append(np.full(9, run))
    return Recording(**{name: np.concatenate(rows) for name, rows in columns.items()}, has_run=True)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, *(pytest.param(one, marks=pytest.mark.evidence) for one in (0, 1))])
def test_no_calibration_makes_the_rollout_worse(seed) -> None:
    slide = Segment(prismatic((1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), 0, 0, 9, 0.0, 0.4, (0.0, 0.4), 0.001, 0.003, 0.0, 1.0)
    drawer = build_automaton(KinematicGraph((KinematicEdge(BASE, "drawer", (slide,)),)))
    found = calibrate(drawer, drawer_with_two_effects(seed))
    assert found.effects
    assert found.after.rollout <= 1.02 * found.before.rollout
    if not all(effect.is_added for effect in found.effects):
        assert found.verdict in ("partly", "unexplained")
        assert "effects_not_added" in codes_of(found.notes)
        assert found.automaton == drawer


def test_planted_runs_read_the_first_row_as_all_others() -> None:
    z, _ = plants.runs_of(plants.stretched, 1, 30, 4, noise=0.0, disturbance=0.0)[0]
    plain, _ = plants.runs_of(plants.honest, 1, 30, 4, noise=0.0, disturbance=0.0)[0]
    assert z == pytest.approx(1.1 * plain)
