"""What happens between the knots of a plan: where in a step a guard is crossed, which of several transitions comes
first, guards on state and input together, and paths around places that are too narrow for the belief.

Each problem that must be solved stands beside one that must not, or that is solved another way.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import micah_plan
from micah_plan.documents.problem import load_problem
from micah_plan.planning.pomdp_hd import plan
from micah_plan.planning.roll_outs import departure
from micah_plan.planning.solver import solve
from micah_plan.planning.verification import verify
from micah_plan.task.problem import Problem

SLIDE = """
      rail: {kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}
      hand: {kind: prismatic, position: [0, 0, 0], axis: [0, 0, 1]}
"""
PLANE = """\
format: micah-plan/model/1
coordinates: {x: m, z: m}
inputs: {x: m, z: m}
links:
  - {parent: base, child: rail, coordinate: x}
  - {parent: rail, child: hand, coordinate: z}
noise:
  process_std: {x: 0.001, z: 0.001}
  observation_std: {x: 0.003, z: 0.003}
"""
OVER = f"""\
modes:
  over:
    joints: &j {SLIDE}
    step: {{x: input x, z: input z}}
    invariant: [z >= 0.0, z <= 0.4, x >= -0.4, x <= 0.4]
"""
# A slot in a plate; what comes down beside it hits the plate.
SLOT = (
    PLANE
    + OVER
    + """\
  inside: {joints: *j, step: {x: input x, z: input z}, invariant: [z <= 0.0, z >= -0.2, x >= -0.045, x <= 0.045]}
  hit: {joints: *j, step: {}, invariant: []}
transitions:
  - {source: over, target: inside, guard: [z <= 0.0, x >= -0.04, x <= 0.04]}
  - {source: over, target: hit, guard: [z <= 0.0]}
  - {source: inside, target: hit, guard: [x >= 0.045]}
  - {source: inside, target: hit, guard: [x <= -0.045]}
"""
)
# A hole in a table: what is put down above it falls, as that transition is listed first.
HOLE = (
    PLANE
    + OVER
    + """\
  stands: {joints: *j, step: {}, invariant: [], pins: {z: {value: 0.0, std: 0.001}}}
  fallen: {joints: *j, step: {}, invariant: []}
transitions:
  - {source: over, target: fallen, guard: [z <= 0.0, x >= -0.05, x <= 0.05]}
  - {source: over, target: stands, guard: [z <= 0.0]}
"""
)
# Let go of at more than 5 mm it drops: a guard on input and state, listed before the one on the input alone.
GENTLY = """\
format: micah-plan/model/1
coordinates: {z: m}
inputs: {z: m, grip: m}
links: [{parent: base, child: hand, coordinate: z}]
noise: {process_std: {z: 0.0005}, observation_std: {z: 0.002}}
modes:
  carries:
    joints: &j {hand: {kind: prismatic, position: [0, 0, 0], axis: [0, 0, 1]}}
    step: {z: input z}
    invariant: [z >= 0.0, z <= 0.4]
  stands: {joints: *j, step: {z: input z}, invariant: [z >= 0.0, z <= 0.4]}
  dropped: {joints: *j, step: {}, invariant: []}
transitions:
  - {source: carries, target: dropped, guard: [input grip < -0.005, z > 0.005]}
  - {source: carries, target: stands, guard: [input grip < -0.005]}
  - {source: carries, target: carries, guard: [z < 0.0], reset: {z: 0.0}}
"""
# Near the wall, beyond x = 0.3, one may not go faster than 12 mm per step.
SLOWLY = """\
format: micah-plan/model/1
coordinates: {x: m}
inputs: {x: m}
links: [{parent: base, child: hand, coordinate: x}]
noise: {process_std: {x: 0.001}, observation_std: {x: 0.003}}
modes:
  free:
    joints: &j {hand: {kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}}
    step: {x: input x}
    invariant: [x >= -0.1, x <= 1.0]
  broken: {joints: *j, step: {}, invariant: []}
transitions:
  - {source: free, target: broken, guard: [input x > 0.012, x >= 0.3]}
"""
# A wall with a gap of 36 mm on the way, and an open side 0.35 m away.
GAP = (
    PLANE.replace("0.001, z: 0.001", "0.005, z: 0.005").replace("0.003, z: 0.003", "0.01, z: 0.01")
    + f"""\
modes:
  free:
    joints: &j {SLIDE}
    step: {{x: input x, z: input z}}
    invariant: [x >= -0.5, x <= 0.5, z >= -0.3, z <= 0.9]
  damaged: {{joints: *j, step: {{}}, invariant: []}}
transitions:
  - {{source: free, target: damaged, guard: [x >= -0.04, x <= 0.04, z >= 0.018, z <= 0.4]}}
  - {{source: free, target: damaged, guard: [x >= -0.04, x <= 0.04, z <= -0.018]}}
"""
)


def problem_of(folder: Path, model: str, rest: str) -> Problem:
    (folder / "model.yaml").write_text(model, encoding="utf-8")
    (folder / "problem.yaml").write_text("format: micah-plan/problem/1\nmodel: model.yaml\n" + rest, encoding="utf-8")
    return load_problem(folder / "problem.yaml")


def in_slot(folder: Path) -> Problem:
    return problem_of(
        folder,
        SLOT,
        """\
start: {mean: {x: -0.31, z: 0.23}, std: {x: 0.003, z: 0.003}, mode: over}
goal: {target: {z: {value: -0.1, tolerance: 0.02}}, modes: [inside]}
planner: {max_step: {x: 0.05, z: 0.05}}
""",
    )


def on_table(folder: Path, x: float) -> Problem:
    return problem_of(
        folder,
        HOLE,
        f"""\
start: {{mean: {{x: {x}, z: 0.2}}, std: {{x: 0.003, z: 0.003}}, mode: over}}
goal: {{target: {{z: {{value: 0.0, tolerance: 0.01}}}}, modes: [stands]}}
planner: {{max_step: {{x: 0.03, z: 0.03}}}}
""",
    )


def follows(problem: Problem, found) -> bool:
    return found.trajectory is not None and departure(problem, found.trajectory) is None


@pytest.mark.sweep
@pytest.mark.parametrize("seed", range(3))
def test_the_side_of_a_slot_is_kept_where_the_plate_is_crossed_not_only_at_the_next_knot(tmp_path, seed) -> None:
    problem = in_slot(tmp_path)
    found = solve(problem, seed=seed)
    assert found.outcome == "solved", found.reason
    assert found.mode_sequence == ("over", "inside")
    assert follows(problem, found)
    (crossing,) = np.flatnonzero(found.trajectory.is_transition)
    assert (np.abs(found.trajectory.means[crossing - 1 : crossing + 1, 0]) <= 0.04).all()


def test_a_slot_that_is_too_narrow_for_the_noise_is_not(tmp_path) -> None:
    problem = in_slot(tmp_path)
    noisy = replace(problem.automaton.noise, process_std=(0.04, 0.04))
    found = solve(replace(problem, automaton=replace(problem.automaton, noise=noisy)), advise=False)
    assert found.outcome != "solved"


@pytest.mark.sweep
@pytest.mark.parametrize("x", [0.01, -0.03, 0.3])
def test_what_is_listed_first_happens_first(tmp_path, x) -> None:
    problem = on_table(tmp_path, x)
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert follows(problem, found)
    assert abs(found.trajectory.means[-1, 0]) > 0.05


def test_listed_the_other_way_round_it_stands_where_it_is(tmp_path) -> None:
    problem = on_table(tmp_path, 0.01)
    edges = problem.automaton.edges[::-1]
    found = solve(replace(problem, automaton=replace(problem.automaton, edges=edges)))
    assert found.outcome == "solved", found.reason
    assert found.trajectory.means[-1, 0] == pytest.approx(0.01, abs=1e-3)


def test_a_table_that_is_all_hole_has_no_plan(tmp_path) -> None:
    problem = on_table(tmp_path, 0.01)
    first, second = problem.automaton.edges
    everywhere = replace(first, guard=replace(first.guard, half_spaces=first.guard.half_spaces[:1]))
    model = replace(problem.automaton, edges=(everywhere, replace(second, target="stands")))
    assert solve(replace(problem, automaton=model), advise=False).outcome != "solved"


def test_a_plan_preceded_by_other_transitions_is_reported_without_blaming_the_noise(tmp_path) -> None:
    problem = on_table(tmp_path, 0.01)
    solid = replace(problem, automaton=replace(problem.automaton, edges=problem.automaton.edges[1:]))
    found = plan(solid)
    assert found.trajectory is not None
    refused = verify(problem, found)
    assert refused.outcome == "not_verified"
    assert "even without noise" in refused.reason
    assert "'fallen'" in refused.reason
    assert "noise or" not in refused.reason
    assert verify(solid, found).outcome == "solved"


def test_the_hand_goes_down_before_it_lets_go(tmp_path) -> None:
    problem = problem_of(
        tmp_path,
        GENTLY,
        """\
start: {mean: {z: 0.2}, std: {z: 0.002}, mode: carries}
goal: {target: {z: {value: 0.1, tolerance: 0.02}}, modes: [stands]}
planner: {max_step: {z: 0.02, grip: 0.01}}
""",
    )
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert follows(problem, found)
    assert found.trajectory.means[found.trajectory.modes.index("stands"), 0] < 0.005


@pytest.mark.parametrize(("goal", "slow"), [(0.5, True), (0.25, False)])
def test_a_speed_limit_near_the_wall_slows_down_what_goes_there(tmp_path, goal, slow) -> None:
    problem = problem_of(
        tmp_path,
        SLOWLY,
        f"""\
start: {{mean: {{x: 0.0}}, std: {{x: 0.003}}, mode: free}}
goal: {{target: {{x: {{value: {goal}, tolerance: 0.02}}}}, modes: [free]}}
planner: {{max_step: {{x: 0.05}}}}
""",
    )
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert bool(found.trajectory.inputs[:, 0].max() > 0.012) is not slow


@pytest.mark.slow
@pytest.mark.parametrize(("share", "detour"), [(1.0, True), (0.1, False)])
def test_the_belief_chooses_between_a_gap_and_the_way_around(tmp_path, share, detour) -> None:
    problem = problem_of(
        tmp_path,
        GAP,
        """\
start: {mean: {x: -0.4, z: 0.0}, std: {x: 0.005, z: 0.005}, mode: free}
goal: {target: {x: {value: 0.4, tolerance: 0.04}, z: {value: 0.0, tolerance: 0.04}}, modes: [free]}
planner: {max_step: {x: 0.05, z: 0.05}}
""",
    )
    noise = replace(problem.automaton.noise, process_std=(0.005 * share,) * 2, observation_std=(0.01 * share,) * 2)
    found = solve(replace(problem, automaton=replace(problem.automaton, noise=noise)))
    assert found.outcome == "solved", found.reason
    assert bool(found.trajectory.means[:, 1].max() > 0.4) is detour


def blocks(count: int, settings: str = "") -> tuple[str, str]:
    """One hand that moves things one by one: model and rest of the problem."""
    names = [f"b{i}" for i in range(count)]
    joint = "{kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}"
    joints = ", ".join(f"{name}: {joint}" for name in ("hand", *names))
    inside = ", ".join(f"{name} >= -0.5, {name} <= 2.0" for name in ("hand", *names))
    links = "\n".join(f"  - {{parent: base, child: {name}, coordinate: {name}}}" for name in ("hand", *names))

    def each(value: str) -> str:
        return "{" + ", ".join(f"{name}: {value}" for name in ("hand", *names)) + "}"

    held = "\n".join(
        f"  has_{name}: {{joints: *j, step: {{hand: input hand, {name}: input hand}}, invariant: [{inside}]}}"
        for name in names
    )
    edges = "\n".join(
        f"  - {{source: free, target: has_{name}, guard: "
        f"[input grip > 0.005, hand - {name} >= -0.012, hand - {name} <= 0.012]}}\n"
        f"  - {{source: has_{name}, target: free, guard: [input grip < -0.005]}}"
        for name in names
    )
    model = f"""\
format: micah-plan/model/1
coordinates: {each("m")}
inputs: {{hand: m, grip: m}}
links:
{links}
noise: {{process_std: {each("0.0005")}, observation_std: {each("0.002")}}}
modes:
  free: {{joints: &j {{{joints}}}, step: {{hand: input hand}}, invariant: [{inside}]}}
{held}
transitions:
{edges}
"""
    start = ", ".join(f"b{i}: {0.15 * i:g}" for i in range(count))
    target = ", ".join(f"b{i}: {{value: {1.0 + 0.12 * i:g}, tolerance: 0.012}}" for i in range(count))
    rest = f"""\
start: {{mean: {{hand: 0.4, {start}}}, std: {each("0.002")}, mode: free}}
goal: {{target: {{{target}}}, modes: [free]}}
planner: {{max_step: {{hand: 0.12, grip: 0.01}}, revisits: {count}, max_knots: 250{settings}}}
"""
    return model, rest


@pytest.mark.slow
@pytest.mark.parametrize(
    "count", [2, pytest.param(4, marks=pytest.mark.evidence), pytest.param(5, marks=pytest.mark.evidence)]
)
def test_one_hand_moves_several_things(tmp_path, count) -> None:
    problem = problem_of(tmp_path, *blocks(count))
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    assert {name for name in found.mode_sequence if name != "free"} == {f"has_b{i}" for i in range(count)}


def test_a_search_that_its_limit_ended_reports_it(tmp_path) -> None:
    found = solve(problem_of(tmp_path, *blocks(3, ", search_limit: 20")), advise=False)
    assert found.outcome == "no_plan"
    assert "stopped after 20 linear programmes" in found.reason
    assert "search_limit" in found.reason


def test_a_mode_that_ties_a_coordinate_is_entered_where_the_tie_holds(tmp_path) -> None:
    tied = SLOT.replace("{x: m, z: m}\ninputs", "{x: m, z: m, lid: rad}\ninputs")
    tied = tied.replace("coordinate: z}\n", "coordinate: z}\n  - {parent: base, child: lid, coordinate: lid}\n")
    tied = tied.replace("z: 0.001}", "z: 0.001, lid: 0.0}").replace("z: 0.003}", "z: 0.003, lid: 0.05}")
    joint = "      lid: {kind: revolute, position: [0, 0, 0], axis: [0, 1, 0], center: [0, 0, 0]}\n"
    tied = tied.replace("axis: [0, 0, 1]}\n", "axis: [0, 0, 1]}\n" + joint)
    tied = tied.replace("x <= 0.4]\n", "x <= 0.4]\n    pins: {lid: {value: 0.0, std: 0.005}}\n")
    tied = tied.replace("x <= 0.045]}", "x <= 0.045], ties: {lid: -5.0*z}}")
    tied = tied.replace(
        "inside: {joints: *j, step: {x: input x, z: input z}",
        "inside: {joints: *j, step: {x: input x, z: input z, lid: -5.0*input z}",
    )
    problem = problem_of(
        tmp_path,
        tied,
        """\
start: {mean: {x: -0.31, z: 0.23, lid: 0.0}, std: {x: 0.003, z: 0.003, lid: 0.005}, mode: over}
goal: {target: {z: {value: -0.1, tolerance: 0.02}}, modes: [inside]}
planner: {max_step: {x: 0.05, z: 0.05}}
""",
    )
    found = micah_plan.solve(problem)
    assert found.plan.outcome == "solved", found.plan.reason
    found.save(tmp_path / "plan.json")
    means, modes = found.plan.trajectory.means, found.plan.trajectory.modes
    inside = np.array([mode == "inside" for mode in modes])
    assert means[inside, 2] == pytest.approx(-5.0 * means[inside, 1], abs=1e-6)


# A flap that falls shut by 0.04 rad per step unless somebody holds it; the hand goes through below it.
FLAP = """\
format: micah-plan/model/1
coordinates: {hand: m, flap: rad}
inputs: {hand: m, flap: rad}
links:
  - {parent: base, child: tray, coordinate: hand}
  - {parent: base, child: flap, coordinate: flap}
noise: {process_std: {hand: 0.001, flap: 0.004}, observation_std: {hand: 0.003, flap: 0.01}}
modes:
  free:
    joints: &j
      tray: {kind: prismatic, position: [0.4, 0, 0], axis: [0, 1, 0]}
      flap: {kind: revolute, position: [0, 0.4, 0], axis: [0, 0, 1], center: [0, 0.4, 0]}
    step: {hand: input hand, flap: input flap - 0.04}
    invariant: [flap >= 0.0, flap <= 1.5, hand >= -0.2, hand <= 1.0]
  caught: {joints: *j, step: {}, invariant: []}
transitions:
  - {source: free, target: free, guard: [flap < 0.0], reset: {flap: 0.0}}
  - {source: free, target: caught, guard: [hand >= 0.3, hand <= 0.5, flap <= 0.8]}
"""


def below_the_flap(folder: Path, strongest: float) -> Problem:
    return problem_of(
        folder,
        FLAP,
        f"""\
start: {{mean: {{hand: 0.0, flap: 0.05}}, std: {{hand: 0.003, flap: 0.02}}, mode: free}}
goal: {{target: {{hand: {{value: 0.8, tolerance: 0.03}}}}, modes: [free]}}
planner: {{max_step: {{hand: 0.06, flap: {strongest}}}}}
""",
    )


def test_what_falls_shut_is_held_open_while_something_passes(tmp_path) -> None:
    problem = below_the_flap(tmp_path, 0.1)
    assert [(e.name, e.coordinate, e.values, e.modes) for e in problem.automaton.effects] == [
        ("bias", "flap", (-0.04,), ("free",))
    ]
    found = solve(problem)
    assert found.outcome == "solved", found.reason
    hand, flap = found.trajectory.means.T
    assert (flap[(hand > 0.3) & (hand < 0.5)] > 0.8).all()


def test_a_hand_too_weak_to_hold_it_has_no_plan(tmp_path) -> None:
    assert solve(below_the_flap(tmp_path, 0.03), advise=False).outcome != "solved"


@pytest.mark.slow
def test_a_plan_opens_nothing_that_its_goal_does_not_need(tmp_path) -> None:
    model = """\
format: micah-plan/model/1
coordinates: {first: m, second: m}
inputs: {first: m, second: m}
links: [{parent: base, child: a, coordinate: first}, {parent: base, child: b, coordinate: second}]
noise: {process_std: {first: 0.002, second: 0.002}, observation_std: {first: 0.01, second: 0.01}}
modes:
  both shut: {joints: &j {a: &s {kind: prismatic, position: [0, 0, 0], axis: [1, 0, 0]}, b: *s}, step: {},
              invariant: [], pins: {first: {value: 0.0, std: 0.002}, second: {value: 0.0, std: 0.002}}}
  first open: {joints: *j, step: {first: input first}, invariant: [first >= 0, first <= 1],
               pins: {second: {value: 0.0, std: 0.002}}}
  second open: {joints: *j, step: {second: input second}, invariant: [second >= 0, second <= 1],
                pins: {first: {value: 0.0, std: 0.002}}}
  both open: {joints: *j, step: {first: input first, second: input second},
              invariant: [first >= 0, first <= 1, second >= 0, second <= 1]}
transitions:
  - {source: both shut, target: second open, guard: [input second > 0]}
  - {source: both shut, target: first open, guard: [input first > 0]}
  - {source: second open, target: both open, guard: [input first > 0]}
  - {source: first open, target: both open, guard: [input second > 0]}
  - {source: second open, target: both shut, guard: [second <= 0]}
  - {source: first open, target: both shut, guard: [first <= 0]}
  - {source: both open, target: first open, guard: [second <= 0]}
  - {source: both open, target: second open, guard: [first <= 0]}
"""
    problem = problem_of(
        tmp_path,
        model,
        """\
start: {mean: {first: 0.0, second: 0.0}, std: {first: 0.01, second: 0.01}, mode: both shut}
goal: {target: {first: {value: 0.5, tolerance: 0.05}}}
planner: {max_step: {first: 0.083, second: 0.083}}
""",
    )
    for seed in range(3):
        found = solve(problem, seed=seed)
        assert found.outcome == "solved", found.reason
        assert found.mode_sequence == ("both shut", "first open")
