"""The filter goes where the automaton goes, also where one transition is blocked because it was taken at that instant.

Models of these kinds were drawn at random; the filter was lost there, hundreds of its standard deviations away.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from reference.hybrid_step import step

from micah_plan import load
from micah_plan.automaton.hybrid import HybridAutomaton, Pin
from micah_plan.belief.filter import initial_belief, predict_belief, repeated_belief, update


def model(modes: dict, transitions: list, **noise: float) -> HybridAutomaton:
    """Two slides, one on the other; every mode is told by its steps."""
    joints = {f"part {i}": {"kind": "prismatic", "position": [0, 0, 0], "axis": [1 - i, i, 0]} for i in (0, 1)}
    links = [
        {"parent": parent, "child": f"part {i}", "coordinate": f"c{i}"} for i, parent in ((0, "base"), (1, "part 0"))
    ]
    steps = {name: {"joints": joints, "step": own, "invariant": []} for name, own in modes.items()}
    return load(
        {
            "coordinates": {"c0": "m", "c1": "m"},
            "inputs": {"c0": "m", "c1": "m"},
            "links": links,
            "noise": {
                "process_std": dict.fromkeys(("c0", "c1"), noise.get("process", 0.0)),
                "observation_std": {"c0": 0.005, "c1": 0.005},
            },
            "modes": steps,
            "transitions": transitions,
        }
    )


def both(automaton: HybridAutomaton, x: list[float], inputs: np.ndarray, mode: str) -> list[tuple]:
    """Mode and state by `step`, and the most likely ones of the filter, after each input; measured without noise."""
    belief, true, found = initial_belief(automaton, x, [0.01, 0.01], mode), np.array(x), []
    for u in inputs:
        now = step(automaton, mode, true, u)
        mode, true = now.mode, now.x
        belief = update(automaton, predict_belief(automaton, belief, u), true)
        likely = belief.most_likely
        found.append((mode, true, automaton.mode_names[likely], belief.means[likely, :2]))
    return found


def test_a_transition_to_its_own_mode_is_taken_once_and_then_a_wall() -> None:
    """It resets another coordinate than led to it, so the step goes on into its guard: it stops there."""
    clamp = {"source": "a", "target": "a", "guard": ["c1 >= 0"], "reset": {"c0": 0.3}}
    automaton = model({"a": {"c0": "input c0", "c1": "input c1"}}, [clamp])
    inputs = np.array([[0.0, 0.06]] * 6 + [[0.02, -0.05]] * 3)
    for _, true, _, believed in both(automaton, [0.1, -0.1], inputs, "a"):
        np.testing.assert_allclose(believed, true, atol=0.003)


def test_a_wall_at_an_uncertain_place_stays_where_it_is() -> None:
    """The part gives way, not the wall: what is pressed against it says where it is."""
    clamp = {"source": "a", "target": "a", "guard": ["c1 < 0"], "reset": {"c0": 0.3}, "threshold_std": 0.01}
    automaton = model({"a": {"c0": "input c0", "c1": "input c1"}}, [clamp], process=0.001)
    belief = initial_belief(automaton, [0.3, 0.05], [0.001, 0.001], "a")
    after = predict_belief(automaton, belief, [0.0, -0.2])
    assert after.means[0, 1] == pytest.approx(0.0, abs=1e-6)
    assert np.linalg.norm(after.factors[0, 1]) == pytest.approx(0.01, rel=0.01)


def test_a_mode_that_the_automaton_put_behind_its_own_guard_is_believed() -> None:
    """Both guards hold at 0, and no mode is entered twice at one instant: the modes take turns, step by step."""
    there = {"source": "a", "target": "b", "guard": ["c0 >= -0.4"], "reset": {"c0": 0.0}}
    back = {"source": "b", "target": "a", "guard": ["c0 <= 1"]}
    steps = {"a": {"c0": "-input c0"}, "b": {"c0": "-input c0", "c1": "-input c0"}}
    found = both(model(steps, [there, back]), [-0.5, 0.2], np.full((9, 2), -0.03), "a")
    assert "".join(mode for mode, *_ in found)[-4:] in ("abab", "baba")
    for mode, true, likely, believed in found:
        assert likely == mode
        np.testing.assert_allclose(believed, true, atol=0.003)


def test_a_mode_that_excludes_what_is_measured_is_lost() -> None:
    """All of the belief was in one mode: it stayed there, drawn back in front of its guard, however far that was."""
    edges = [{"source": "a", "target": "b", "guard": ["c0 >= 0.2"]}]
    edges += [{"source": "b", "target": "a", "guard": ["c0 < 0.2"]}]
    steps = {"c0": "input c0", "c1": "input c1"}
    automaton = model({"a": steps, "b": steps}, edges, process=0.001)
    start = initial_belief(automaton, [0.1, 0.0], [0.01, 0.01], "a")
    for place, mode in ((0.4, 1), (0.12, 0)):
        found = update(automaton, start, [place, 0.0])
        assert found.weights[mode] > 0.999
        assert abs(found.means[mode, 0] - place) < 0.08  # between what was believed and what is measured
        together = update(automaton, repeated_belief(automaton, start, 2), np.tile([place, 0.0], (2, 1)))
        np.testing.assert_allclose(together.weights, np.tile(found.weights, (2, 1)), atol=1e-9)
        np.testing.assert_allclose(together.means[:, mode], np.tile(found.means[mode], (2, 1)), atol=1e-9)


def test_a_pin_holds_what_a_reset_put_elsewhere() -> None:
    """As in the automaton, a mode has its pinned coordinates at their pins, whatever was known of them before."""
    into = {"source": "a", "target": "held", "guard": ["c1 >= 0"], "reset": {"c0": 0.3}}
    automaton = model({"a": {"c0": "input c0", "c1": "input c1"}, "held": {"c1": "input c1"}}, [into])
    pinned = replace(automaton.mode("held"), pins=(Pin(0, 0.1, 0.001),))
    automaton = replace(automaton, modes=(automaton.modes[0], pinned))
    for mode, true, likely, believed in both(automaton, [0.5, -0.05], np.full((3, 2), 0.04), "a"):
        assert likely == mode
        np.testing.assert_allclose(believed, true, atol=0.003)
