"""A template problem for an existing model: from near one end of its range toward the other."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.documents.problem import problem_from_text
from micah_plan.errors import InputError
from micah_plan.task.problem import Problem
from micah_plan.view.placement import coordinate_range, representative_state

_START, _GOAL = 0.1, 0.8
"""Shares of its range in the mode at which a coordinate begins and shall end."""
_SPREAD, _TOLERANCE, _STEP = 0.01, 0.04, 0.05
"""Standard deviation of the start, tolerance of the goal and largest step, in ranges."""
_NOISES = 4.0
"""The tolerance is at least this many standard deviations of a measurement."""
_RESERVED = ("true", "false", "null", "yes", "no", "on", "off")

_TEXT = """\
# yaml-language-server: $schema=problem.schema.json
# A first problem for the model beside it: all that moves in its mode '{mode}' goes most of its way. Try it:
#   micah-plan check problem.yaml
#   micah-plan solve problem.yaml -o plan.json --html plan.html
# Ranges in the model:
{ranges}
format: micah-plan/problem/1
model: model.yaml

# The initial belief: a Gaussian over the coordinates of the model [rad or m].
start:
  mean: {mean}
  std: {std}
  mode: {name}

# Any subset of the coordinates, and optionally the modes to end in.
goal:
  target:
{targets}
  # modes: [{modes}]

# The model's noise is that of the rows of a demonstration. Better say that of one control step and of your own tracker.
# noise:
#   process_std: {process}
#   observation_std: {observation}

# With which probability guards and limits hold along the plan, and roll-outs reach the goal.
confidence: 0.95

planner:
  max_step: {step}    # largest displacement per step
"""


def first_problem(automaton: HybridAutomaton) -> str:
    """The text of a problem file for the model in an adjacent ``model.yaml``.

    Raises:
        InputError: if nothing in the model can be moved.
    """
    mode, moved = _moving_mode(automaton)
    names = automaton.coordinate_names
    ranges = {i: coordinate_range(automaton, mode, i)[:2] for i in moved}
    length = {i: high - low for i, (low, high) in ranges.items()}
    mean = representative_state(automaton, mode)
    spread = [max(automaton.noise.observation_std[i], 1e-6) for i in range(automaton.n)]
    targets = []
    for i in moved:
        mean[i] = ranges[i][0] + _START * length[i]
        spread[i] = _SPREAD * length[i]
        tolerance = max(_TOLERANCE * length[i], _NOISES * automaton.noise.observation_std[i])
        value = ranges[i][0] + _GOAL * length[i]
        targets.append(f"    {_plain(names[i])}: {{value: {value:.4g}, tolerance: {tolerance:.2g}}}")
    for tie in mode.ties:
        mean[tie.coordinate] = float(tie.value(np.asarray(mean)))
    steps = {
        named.name: max(_STEP * length[i] for i in moved if mode.B[i][j])
        for j, named in enumerate(automaton.inputs)
        if any(mode.B[i][j] for i in moved)
    }
    return _TEXT.format(
        mode=mode.name,
        name=_plain(mode.name),
        ranges="\n".join(f"#   {names[i]}: {low:.4g} to {high:.4g}" for i, (low, high) in ranges.items()),
        mean=_mapping(names, mean),
        std=_mapping(names, spread),
        targets="\n".join(targets),
        modes=", ".join(_plain(each.name) for each in automaton.modes),
        process=_mapping(names, automaton.noise.process_std),
        observation=_mapping(names, automaton.noise.observation_std),
        step=_mapping(list(steps), steps.values()),
    )


def problem_for(automaton: HybridAutomaton, source: str = "problem.yaml") -> Problem:
    """The problem of `first_problem` as a value.

    Args:
        automaton: the model.
        source: name of the file that it would be in, for messages.

    Raises:
        InputError: if nothing in the model can be moved.
    """
    return problem_from_text(first_problem(automaton).encode(), source, automaton)


def _moving_mode(automaton: HybridAutomaton) -> tuple[Mode, list[int]]:
    """(first mode with movable coordinates, these coordinates without tied ones)."""
    for mode in automaton.modes:
        following = {tie.coordinate for tie in mode.ties}
        moved = [i for i in np.flatnonzero(mode.driven & mode.free).tolist() if i not in following]
        if moved:
            return mode, moved
    raise InputError("nothing in this model can be moved", remedy="record the part while it is moved, and learn again")


def _mapping(names: Sequence[str], values: Iterable[float]) -> str:
    pairs = zip(names, values, strict=True)
    return "{" + ", ".join(f"{_plain(name)}: {value:.4g}" for name, value in pairs) + "}"


def _plain(name: str) -> str:
    """A name quoted for YAML."""
    plain = re.fullmatch(r"[A-Za-z_]\w*", name) and name.lower() not in _RESERVED
    return name if plain else json.dumps(name)
