"""Rounded automata: six digits, the same order of boundaries, and idempotent."""

from __future__ import annotations

import numpy as np
import pytest

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.digits import rounded
from micah_plan.documents.model import load_model


def test_rounding_twice_changes_nothing_and_keeps_boundaries_in_order(repository) -> None:
    for name in ("microwave", "drawer", "cabinet", "stapler", "box"):
        automaton = load_model(repository / "models" / f"{name}.yaml")
        assert rounded(automaton) == automaton  # what is shipped is what learning rounds to
        check_automaton(automaton)
        for mode in automaton.modes:
            for pin in mode.pins:
                low, high = mode.invariant.interval(pin.coordinate)
                assert low <= pin.value <= high
            for joint in mode.joints:
                assert np.linalg.norm(joint.quaternion) == pytest.approx(1.0, abs=1e-9)


def test_nothing_moves_by_more_than_its_last_digit(repository) -> None:
    from micah_plan.api.learning import learn
    from micah_plan.exchange.load import load_recording

    recording = load_recording(repository / "examples" / "demonstrations" / "microwave.csv")
    learned = learn(recording)
    exact = learned.graph.edges[0].segments[0].joint
    ours = build_automaton(learned.graph).modes[0].joints[0]
    assert ours.position == pytest.approx(exact.position, rel=1e-5)
    assert ours.covariance == exact.covariance
