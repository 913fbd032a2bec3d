"""Steps of many objects at once are those of each by itself, through every event of every shipped problem."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from reference.hybrid_step import step

from micah_plan.automaton.drawn_thresholds import threshold_stds, with_boundaries
from micah_plan.automaton.hybrid import Edge, HybridAutomaton
from micah_plan.automaton.input_memory import without_memory_states
from micah_plan.automaton.region import Region
from micah_plan.automaton.step_noise import drawn_gains, uncertain_gains, with_gains
from micah_plan.automaton.transition import TransitionBatch
from micah_plan.documents.kind import kind_of
from micah_plan.documents.problem import load_problem
from micah_plan.planning.limits import limits_of
from micah_plan.task.problem import Problem

FOLDER = Path(__file__).parents[2] / "problems"
PROBLEMS = sorted(path.name for path in FOLDER.glob("*.yaml") if kind_of(path) == "problem")
COUNT = 150


def same_as_one_by_one(
    automaton: HybridAutomaton, modes: np.ndarray, x: np.ndarray, u: np.ndarray, pushed: np.ndarray, seed: int
) -> tuple[int, int]:
    """How many of the steps had an event, and the largest number of events in a step."""
    rng = np.random.default_rng(seed)
    stds = threshold_stds(automaton)
    shifts = stds * rng.standard_normal((len(x), stds.size))
    gains = drawn_gains(automaton, rng, len(x))
    batch = TransitionBatch(automaton, shifts, gains)
    ends, states = batch.step(modes, x, u, pushed)
    happened = [list[tuple[str, float]]() for _ in modes]
    for number, event in batch.step_with_events(modes, x, u, pushed).events:
        happened[number].append((event.name, event.fraction))
    names, events = [mode.name for mode in automaton.modes], []
    for i, mode in enumerate(modes):
        own = with_gains(automaton, gains[i]) if uncertain_gains(automaton) else automaton
        after = step(with_boundaries(own, shifts[i]), names[mode], x[i], u[i], pushed[i])
        assert names[ends[i]] == after.mode
        assert states[i] == pytest.approx(after.x, abs=1e-10)
        events.append(len(after.events))
        assert [name for name, _ in happened[i]] == [event.name for event in after.events]
        assert [at for _, at in happened[i]] == pytest.approx([event.fraction for event in after.events], abs=1e-9)
    return sum(map(bool, events)), max(events)


def around_guards(problem: Problem, automaton: HybridAutomaton, rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """Modes, states within reach of a guard of theirs, inputs and disturbances, (COUNT, ...) each."""
    limits = limits_of(problem)
    left = [i for i, mode in enumerate(automaton.modes) if automaton.edges_from(mode.name)]
    modes = rng.choice(left or range(len(automaton.modes)), COUNT)
    x = rng.uniform(limits.lower, limits.upper, (COUNT, automaton.n))
    u = rng.uniform(-2.0, 2.0, (COUNT, automaton.m)) * limits.max_step
    u[: COUNT // 5] = 0.0
    for i, mode in enumerate(modes):
        guards = [e.guard.half_spaces for e in automaton.edges_from(automaton.modes[mode].name)]
        guards = [rows for guard in guards if (rows := [h for h in guard if any(h.a)])]
        if guards:
            rows = guards[rng.integers(0, len(guards))]
            rng.shuffle(rows)
            for h in rows:  # inside of all but the last
                a = np.array(h.a)
                margin = rng.choice([0.0, 0.3, -0.3, -0.9]) * float(np.abs(a) @ limits.speed)
                missing = h.c + margin - a @ x[i] - np.array(h.b) @ u[i]
                if h is rows[-1] or missing > 0.0:
                    x[i] += a * (missing if h is rows[-1] else missing + abs(margin)) / (a @ a)
    pushed = 0.1 * limits.speed * rng.standard_normal((COUNT, automaton.n))
    return modes, x, u, pushed


@pytest.mark.sweep
@pytest.mark.parametrize("name", PROBLEMS)
def test_objects_near_the_guards_of_a_shipped_problem(repository: Path, name: str) -> None:
    problem = load_problem(repository / "problems" / name)
    automaton = without_memory_states(problem.automaton)
    drawn = around_guards(problem, automaton, np.random.default_rng(PROBLEMS.index(name)))
    eventful, most = same_as_one_by_one(automaton, *drawn, seed=1)
    assert most >= 1 or not automaton.edges
    assert eventful > COUNT // 10 or not automaton.edges


def test_a_guard_without_half_spaces_holds_everywhere(repository: Path) -> None:
    door = load_problem(repository / "problems" / "microwave_close.yaml").automaton
    first, last = door.modes[0].name, door.modes[-1].name
    always = HybridAutomaton(
        door.coordinates,
        door.inputs,
        door.links,
        door.parts,
        door.modes,
        (Edge(first, last, Region()), *door.edges, Edge(last, last, Region())),
        door.noise,
    )
    rng = np.random.default_rng(0)
    x, u = rng.uniform(0.2, 1.0, (20, 1)), rng.uniform(-0.1, 0.1, (20, 1))
    same_as_one_by_one(always, rng.integers(0, len(door.modes), 20), x, u, np.zeros_like(x), seed=2)
