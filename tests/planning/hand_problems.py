"""Problems of hands: one input that moves several coordinates, letting go, and taking hold elsewhere.

A model is written as a modeller writes it, from the expressions of the model file: the flow of each mode, its
invariant, and transitions as (source, target, guard). All coordinates are lengths along x.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from micah_plan.documents.problem import load_problem
from micah_plan.task.problem import Problem

GRIPS = ("grip", "take", "push")
Flow = Mapping[str, str]
Transition = tuple[str, str, Sequence[str]] | tuple[str, str, Sequence[str], Mapping[str, Any]]


def hand_problem(
    coordinates: Sequence[str],
    inputs: Sequence[str],
    modes: Mapping[str, tuple[Flow, Sequence[str]]],
    transitions: Sequence[Transition],
    start: Mapping[str, float],
    target: Mapping[str, float],
    *,
    mode: str,
    tolerance: float = 0.02,
    std: float = 0.004,
    planner: Mapping[str, Any] | None = None,
    goal_modes: Sequence[str] = (),
) -> Problem:
    """The problem of moving from the start's means to the target.

    Inputs that move coordinates are at most 0.05 m per step, those of fingers, 1.
    """
    slide = {"kind": "prismatic", "position": [0.0, 0.0, 0.0], "axis": [1.0, 0.0, 0.0]}
    joints = dict.fromkeys(coordinates, slide)
    model = {
        "format": "micah-plan/model/1",
        "coordinates": dict.fromkeys(coordinates, "m"),
        "inputs": dict.fromkeys(inputs, "m"),
        "links": [{"parent": "base", "child": name, "coordinate": name} for name in coordinates],
        "parts": {name: {} for name in ("base", *coordinates)},
        "noise": {
            "process_std": dict.fromkeys(coordinates, 0.0005),
            "observation_std": dict.fromkeys(coordinates, 0.003),
        },
        "modes": {
            name: {"joints": joints, "step": dict(flow), "invariant": list(invariant)}
            for name, (flow, invariant) in modes.items()
        },
        "transitions": [
            {"source": source, "target": end, "guard": list(guard), **(dict(*rest) if rest else {})}
            for source, end, guard, *rest in transitions
        ],
    }
    problem = {
        "format": "micah-plan/problem/1",
        "model": "model.yaml",
        "start": {"mean": dict(start), "std": dict.fromkeys(coordinates, std), "mode": mode},
        "goal": {
            "target": {name: {"value": value, "tolerance": tolerance} for name, value in target.items()},
            **({"modes": list(goal_modes)} if goal_modes else {}),
        },
        "planner": {
            "max_step": {name: 1.0 if name in GRIPS else 0.05 for name in inputs},
            "verification_trials": 300,
            **(planner or {}),
        },
    }
    with TemporaryDirectory() as folder:
        Path(folder, "model.yaml").write_text(json.dumps(model))  # JSON is YAML
        Path(folder, "problem.yaml").write_text(json.dumps(problem))
        return load_problem(Path(folder, "problem.yaml"))


RANGES = ["hand >= 0.0", "hand <= 0.4", "rod >= -1.0", "rod <= 1.0"]


def pre_release_problem(start: float = 0.2, target: float = 0.5, hand: float = 0.0) -> Problem:
    """A hand that carries a rod, both moved by one input, in one mode."""
    both = {"hand": "input hand", "rod": "input hand"}
    mean = {"hand": hand, "rod": start}
    return hand_problem(
        ["hand", "rod"], ["hand"], {"carries": (both, RANGES)}, [], mean, {"rod": target}, mode="carries"
    )


def regrasping(
    start: float = 0.0, target: float = 0.5, offset: float = 0.1, mode: str = "holds", revisits: int = 1
) -> Problem:
    """A hand that reaches from 0 to 0.4 m and takes the rod within 0.1 m of its middle: it has to take hold again."""
    modes = {
        "free": ({"hand": "input hand"}, RANGES),
        "holds": ({"hand": "input hand", "rod": "input hand"}, RANGES),
    }
    near = ["hand - rod >= -0.1", "hand - rod <= 0.1"]
    transitions = [("free", "holds", ["input grip > 0.5", *near]), ("holds", "free", ["input grip < -0.5"])]
    return hand_problem(
        ["hand", "rod"],
        ["hand", "grip"],
        modes,
        transitions,
        {"hand": start + offset, "rod": start},
        {"rod": target},
        mode=mode,
        planner={"revisits": revisits},
    )


def two_holds() -> Problem:
    """The same with a mode per hold: at the rod's front, where it is taken first, and at its back."""
    both = {"hand": "input hand", "rod": "input hand"}
    modes = {
        "front": (both, [*RANGES, "hand - rod >= 0.0", "hand - rod <= 0.2"]),
        "free": ({"hand": "input hand"}, RANGES),
        "back": (both, [*RANGES, "hand - rod >= -0.2", "hand - rod <= 0.0"]),
    }
    transitions = [
        ("front", "free", ["input grip < -0.5"]),
        ("free", "back", ["input grip > 0.5", "hand - rod >= -0.12", "hand - rod <= -0.08"]),
        ("back", "free", ["input grip < -0.5"]),
    ]
    mean = {"hand": 0.1, "rod": 0.0}
    return hand_problem(
        ["hand", "rod"], ["hand", "grip"], modes, transitions, mean, {"rod": 0.45}, mode="front", tolerance=0.03
    )


def gears(target: float = 0.3) -> Problem:
    """Three coordinates on one input, one of them backwards, and a free one."""
    flow = {"a": "input hand", "b": "2.0*input hand", "c": "-0.5*input hand", "d": "input d"}
    ranges = [f"{name} {side}" for name in "abcd" for side in (">= -1.0", "<= 1.0")]
    mean = {"a": 0.0, "b": -0.2, "c": 0.1, "d": 0.4}
    return hand_problem(
        list("abcd"), ["hand", "d"], {"geared": (flow, ranges)}, [], mean, {"b": target, "d": -0.3}, mode="geared"
    )


def handing_over() -> Problem:
    """One hand reaches from 0 to 0.4 m, the other from 0.35 to 1 m: a rod goes from 0.1 to 0.9 m."""
    ranges = ["left >= 0.0", "left <= 0.4", "right >= 0.35", "right <= 1.0", "rod >= -1.0", "rod <= 2.0"]
    free = {"left": "input left", "right": "input right"}
    modes = {
        "by_left": ({**free, "rod": "input left"}, ranges),
        "free": (free, ranges),
        "by_right": ({**free, "rod": "input right"}, ranges),
    }
    transitions = [
        ("free", "by_left", ["input grip > 0.5", "left - rod >= -0.05", "left - rod <= 0.05"]),
        ("by_left", "free", ["input grip < -0.5"]),
        ("free", "by_right", ["input take > 0.5", "right - rod >= -0.05", "right - rod <= 0.05"]),
        ("by_right", "free", ["input take < -0.5"]),
    ]
    mean = {"left": 0.1, "right": 0.6, "rod": 0.1}
    names, inputs = ["left", "right", "rod"], ["left", "right", "grip", "take"]
    return hand_problem(names, inputs, modes, transitions, mean, {"rod": 0.9}, mode="free", planner={"revisits": 2})


def pusher() -> Problem:
    """A hand puts a rod where a pusher takes it: between 0.17 and 0.23 m, and only with the hand out of the way."""
    ranges = [*RANGES, "arm >= 0.0", "arm <= 0.8"]
    modes = {
        "free": ({"hand": "input hand", "arm": "input arm"}, ranges),
        "holds": ({"hand": "input hand", "rod": "input hand"}, ranges),
        "pushes": ({"arm": "input arm", "rod": "input arm"}, ranges),
    }
    transitions = [
        ("free", "holds", ["input grip > 0.5", "hand - rod >= -0.05", "hand - rod <= 0.05"]),
        ("holds", "free", ["input grip < -0.5"]),
        ("free", "pushes", ["input push > 0.5", "rod >= 0.17", "rod <= 0.23", "hand <= 0.1", "arm <= 0.05"]),
    ]
    return hand_problem(
        ["hand", "rod", "arm"],
        ["hand", "arm", "grip", "push"],
        modes,
        transitions,
        {"hand": 0.3, "rod": -0.02, "arm": 0.4},
        {"rod": 0.9},
        mode="free",
        planner={"revisits": 1},
    )


def around_a_block() -> Problem:
    """A hand carries a rod in the plane around a block that catches the rod, not the hand."""
    names = ["hx", "hy", "rx", "ry"]
    ranges = [f"{name} {side}" for name in names for side in (">= -1.0", "<= 1.0")]
    flow = {"hx": "input x", "hy": "input y", "rx": "input x", "ry": "input y"}
    modes = {"carries": (flow, ranges), "caught": ({}, ranges)}
    block = ["rx >= -0.2", "rx <= 0.2", "ry >= -0.4", "ry <= 1.0"]
    mean = {"hx": -0.6, "hy": 0.3, "rx": -0.6, "ry": 0.1}
    target = {"rx": 0.6, "ry": 0.1}
    return hand_problem(names, ["x", "y"], modes, [("carries", "caught", block)], mean, target, mode="carries")


def turning_a_cap(target: float = 2.3, revisits: int = 2) -> Problem:
    """A hand turns a cap by at most 0.9 at once, lets go, turns back, and takes hold again."""
    ranges = ["hand >= -0.1", "hand <= 0.8", "cap >= -0.5", "cap <= 4.0"]
    modes = {
        "free": ({"hand": "input hand"}, ranges),
        "holds": ({"hand": "input hand", "cap": "input hand"}, ranges),
    }
    transitions = [("free", "holds", ["input grip > 0.5"]), ("holds", "free", ["input grip < -0.5"])]
    return hand_problem(
        ["hand", "cap"],
        ["hand", "grip"],
        modes,
        transitions,
        {"hand": 0.3, "cap": 0.0},
        {"cap": target},
        mode="free",
        tolerance=0.05,
        planner={"revisits": revisits, "max_step": {"hand": 0.1, "grip": 1.0}, "max_knots": 100},
    )


def swinging_back(target: float = 0.4) -> Problem:
    """A thing is drawn out by its own input while a door is open (0.5 or more), and the door is to be back at 0."""
    ranges = ["door >= -0.1", "door <= 1.0", "thing >= -0.1", "thing <= 1.0"]
    modes = {
        "shut": ({"door": "input door"}, ranges),
        "open": ({"door": "input door", "thing": "input thing"}, ranges),
    }
    transitions = [("shut", "open", ["door >= 0.5"]), ("open", "shut", ["door < 0.5"])]
    return hand_problem(
        ["door", "thing"],
        ["door", "thing"],
        modes,
        transitions,
        {"door": 0.0, "thing": 0.0},
        {"door": 0.0, "thing": target},
        mode="shut",
        planner={"revisits": 1},
    )
