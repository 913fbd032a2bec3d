"""Random automata that `check` accepts go through every command, or are refused in one line; none is a bug of ours.

Of evidence are `MICAH_AUTOMATA` of them (30): `MICAH_AUTOMATA=2000 pytest -m evidence tests/test_random_automata.py`.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from reference.hybrid_step import step
from shell import exit_code

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Primitive,
    Reset,
)
from micah_plan.automaton.joint import Joint, prismatic, revolute, rigid, screw
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.sensing import Light
from micah_plan.cli.console import BAD_INPUT, NO_RESULT
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError

WEIGHTS = (-1.0, 0.0, 0.0, 0.5, 1.0)
PLACES = (-1.0, -0.2, 0.0, 0.3)
EFFECTS = ("gain", "bias", "delay", "lag", "backlash", "dead_zone", "saturation", "spring", "limit", "guard_shift",
           "direction_gain", "follow", "sensor_scale", "sensor_offset", "drift", "latch", "gravity",
           "stick_slip", "ramp")  # fmt: skip
PROBLEM = """
format: micah-plan/problem/1
model: model.yaml
start: {start}
goal: {{target: {target}}}
planner: {{max_step: {step}, max_knots: 15, samples_per_mode: 15, verification_trials: 50, solve_time_limit_s: 20}}
"""
EXPERIMENT = """
format: micah-plan/experiment/1
model: model.yaml
repetitions: 2
motions: [{{start: {start}, commands: {commands}}}]
"""


@st.composite
def half_spaces(draw: st.DrawFn, n: int, m: int, least: int = 0) -> Region:
    """Up to two half-spaces on states, inputs or both; often none at all, so that nothing is bounded."""
    rows = []
    for number in range(draw(st.integers(least, 2))):
        a = tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(n))
        b = tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(m)) if draw(st.booleans()) else (0.0,) * m
        a = a if any(a) or any(b) else (1.0, *a[1:])
        rows.append(HalfSpace(a, b, draw(st.sampled_from(PLACES)), draw(st.booleans()), f"h{number}"))
    return Region(tuple(rows))


def joint(kind: str) -> Joint:
    made = {
        "revolute": lambda: revolute((0, 0, 1), (0, 0, 0), (0.3, 0, 0)),
        "screw": lambda: screw((0, 1, 0), (0, 0, 0.1), 0.02, (0.3, 0, 0)),
        "prismatic": lambda: prismatic((1, 0, 0), (0, 0, 0)),
    }
    return made[kind]()


@st.composite
def modes(draw: st.DrawFn, name: str, joints: tuple[Joint, ...], n: int, m: int) -> Mode:
    """Some pin a coordinate, hold parts that move elsewhere, and measure in their own way."""
    rows = tuple(tuple(draw(st.sampled_from(WEIGHTS)) for _ in range(m)) for _ in range(n))
    pins = (Pin(0, draw(st.sampled_from((0.0, 0.3))), 0.001),) if draw(st.integers(0, 3)) == 0 else ()
    if pins:
        rows = ((0.0,) * m, *rows[1:])
        if draw(st.booleans()):
            joints = (rigid((0.3, 0, 0), fixed_at=pins[0].value), *joints[1:])
    own = ((0, draw(st.sampled_from((1e-4, 0.02)))),) if draw(st.integers(0, 3)) == 0 else ()
    return Mode(name, joints, rows, draw(half_spaces(n, m)), Region(), pins, own)


@st.composite
def effects(draw: st.DrawFn, coordinates: tuple[Coordinate, ...]) -> Effect:
    own = form(draw(st.sampled_from(EFFECTS)))
    names = [parameter.name for parameter in own.parameters]
    values = [draw(st.sampled_from((0.0, 0.05, 0.5, 1.0))) for _ in names]
    return Effect(own.name, draw(st.sampled_from(coordinates)).name, tuple(zip(names, values, strict=True)))


@st.composite
def automata(draw: st.DrawFn) -> HybridAutomaton:
    n, q = draw(st.integers(1, 2)), draw(st.integers(1, 3))
    m = draw(st.sampled_from((n, n, 1)))
    kinds = [draw(st.sampled_from(("revolute", "revolute", "screw", "prismatic"))) for _ in range(n)]
    joints = tuple(joint(kind) for kind in kinds)
    coordinates = tuple(Coordinate(f"c{i}", "m" if kind == "prismatic" else "rad") for i, kind in enumerate(kinds))
    edges = []
    chain = [(number, number + 1) for number in range(q - 1)]
    for source, target in chain + draw(st.lists(st.tuples(st.integers(0, q - 1), st.integers(0, q - 1)), max_size=3)):
        puts = source == target or draw(st.booleans())
        reset = Reset.to({0: draw(st.sampled_from((0.0, 0.3)))}, n) if puts else Reset()
        spread = draw(st.sampled_from((0.0, 0.0, 0.01)))
        edges.append(Edge(f"mode {source}", f"mode {target}", draw(half_spaces(n, m, 1)), reset, spread))
    handle = (0.1, 0.0, 0.0) if draw(st.booleans()) else None
    light = Light(((0, 0.2),), (draw(st.sampled_from((0.0, 0.5))),) * n) if draw(st.integers(0, 4)) == 0 else None
    solids = (Primitive("box", (0.1, 0.1, 0.1)),) if draw(st.booleans()) else ()
    automaton = HybridAutomaton(
        coordinates=coordinates,
        inputs=coordinates[:m],
        links=tuple(Link("base" if i == 0 else f"part {i - 1}", f"part {i}", i) for i in range(n)),
        parts=tuple(Part(f"part {i}", solids, handle) for i in range(n)),
        modes=tuple(draw(modes(f"mode {number}", joints, n, m)) for number in range(q)),
        edges=tuple(edges),
        noise=Noise((draw(st.sampled_from((0.0, 0.001))),) * n, (0.005,) * n, light),
    )
    for _ in range(draw(st.sampled_from((0, 0, 0, 1, 2)))):
        try:
            automaton = with_effect(automaton, draw(effects(coordinates)))
        except InputError:  # an effect that this model cannot have; it goes on without
            break
    return automaton


def run(folder: Path, line: str) -> int:
    return exit_code(*line.replace("@", f"{folder}/").split())


def write_uses(automaton: HybridAutomaton, seed: int, folder: Path) -> None:
    """A problem whose goal lies where random inputs lead, and an experiment that makes them."""
    rng, first = np.random.default_rng(seed), automaton.modes[0]
    u, x = rng.uniform(-0.08, 0.08, automaton.m), np.zeros(automaton.n)
    for candidate in rng.uniform(-0.5, 0.5, (50, automaton.n)):
        left = any(edge.guard.contains(candidate, 0 * u) for edge in automaton.edges_from(first.name))
        if first.invariant.contains(candidate, 0 * u) and not left and not first.pins:
            x = candidate
            break
    end, mode = x, first.name
    for _ in range(8):
        reached = step(automaton, mode, end, u)
        end, mode = np.array(reached.x), reached.mode
    assert np.isfinite(end).all()
    names, inputs = automaton.coordinate_names, automaton.input_names
    start = {"mean": dict(zip(names, x.tolist(), strict=True)), "std": dict.fromkeys(names, 0.01), "mode": first.name}
    moved = int(np.argmax(np.abs(end - x)))
    told = {
        "start": json.dumps(start),
        "target": json.dumps({names[moved]: {"value": float(end[moved]), "tolerance": 0.05}}),
        "step": json.dumps(dict.fromkeys(inputs, 0.1)),
        "commands": json.dumps({name: [float(value)] * 12 for name, value in zip(inputs, u, strict=True)}),
    }
    (folder / "problem.yaml").write_text(PROBLEM.format(**told))
    (folder / "experiment.yaml").write_text(EXPERIMENT.format(**told))


COMMANDS = (
    "diff @model.yaml @model.yaml",
    "show @model.yaml -o @model.html",
    "convert @model.yaml @model.urdf",
    "convert @model.yaml @model.xml",
    "new problem @new --model @model.yaml",
    "check @problem.yaml @experiment.yaml",
    "solve @problem.yaml -o @plan.json --html @plan.html --seed 1",
    "explain @plan.json",
    "execute @plan.json --trials 2 -o @runs.csv --html @runs.html --seed 1",
    "show @plan.json @runs.csv -o @both.html",
    "execute @experiment.yaml -o @moved.csv --seed 1",
    "predict @model.yaml @moved.csv --html @predicted.html",
    "calibrate @model.yaml @moved.csv -o @better.yaml",
    "learn @moved.csv -o @learned.yaml",
)


def goes_through(automaton: HybridAutomaton, seed: int, folder: Path) -> dict[str, int]:
    """Exit code by command line; empty for an automaton that the check refuses."""
    dump_model(automaton, folder / "model.yaml")
    if run(folder, "check @model.yaml"):
        return {}
    assert load_model(folder / "model.yaml") == automaton
    write_uses(automaton, seed, folder)
    ends = {}
    for line in COMMANDS:
        inputs = [word for word in re.split(" -o | --html | new ", line)[0].split() if word.startswith("@")]
        if all((folder / word[1:]).exists() for word in inputs):
            ends[line] = run(folder, line)
    return ends


def tried(automaton: HybridAutomaton, seed: int, folder: Path) -> None:
    """No command may end with a bug of ours, and those that ask nothing of a model must take it."""
    for line, code in goes_through(automaton, seed, folder).items():
        assert code in (0, NO_RESULT, BAD_INPUT), f"{line} ended with {code}"
        assert code == 0 or not line.startswith(("diff", "show")), f"{line} ended with {code}"


@pytest.mark.slow
@settings(max_examples=1, suppress_health_check=list(HealthCheck))
@given(automata(), st.integers(0, 1000))
def test_what_the_check_accepts_every_command_takes(
    tmp_path_factory: pytest.TempPathFactory, automaton: HybridAutomaton, seed: int
) -> None:
    tried(automaton, seed, tmp_path_factory.mktemp("model"))


@pytest.mark.evidence
@settings(
    max_examples=int(os.environ.get("MICAH_AUTOMATA", "30")),
    suppress_health_check=list(HealthCheck),
)
@given(automata(), st.integers(0, 1000))
def test_many_of_them(tmp_path_factory: pytest.TempPathFactory, automaton: HybridAutomaton, seed: int) -> None:
    tried(automaton, seed, tmp_path_factory.mktemp("model"))
