"""Well-formed files that say nonsense: each is refused with one line that says where, what was expected and found."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fnmatch import fnmatch
from pathlib import Path

import pytest
from attempts import told
from nonsense_corpus import CORPUS, replaced
from ruamel.yaml import YAML

from micah_plan.checking import check_file
from micah_plan.documents.model import load_model
from micah_plan.documents.problem import load_problem
from micah_plan.task.plausible import suspicions_of_problem

ROOT = Path(__file__).resolve().parents[2]
# One edit of a shipped file each: what is replaced, by what, where the line says it is, and what it says.
MODELS = {
    "handle out of this world": ("[0.03, 0.045, 0.0]\n    s", "[0.03, 1.0e300, 0.0]\n    s", "parts.door.handle.1"),
    "solid in another galaxy": ("size: [0.008, 0.2]", "size: [0.008, 2.0e20]", "parts.door.shapes.1.size.1"),
    "solid of rounding": ("size: [0.008, 0.2]", "size: [1.0e-300, 0.2]", "expected a number >= 1e-12"),
    "joint out of this world": ("position: [0.06975", "position: [1.06e306", "modes.rigid.joints.door.position.0"),
    "pin out of this world": ("value: 1.206", "value: -1.2e206 #", "expected a number >= -1e+06, found -1.2"),
    "vague pin": ("        std: *", "        std: 1.0e6", "modes.rigid.pins.door.std': expected a number <= 1000"),
    "vague threshold": ("threshold_std: *", "threshold_std: 1.0e6", "transitions.0.threshold_std"),
    "vague measurement": (
        "    door: 0.00449",
        "    door: 1.0e6 #",
        "noise.observation_std.door': expected a number <=",
    ),
    "vague motion": ("    door: 0.00044", "    door: 1.0e6 #", "noise.process_std.door': expected a number <= 1000"),
    "share of 7": ("explained: *", "explained: 7", "actions.explained': expected a number <= 1, found 7"),
    "indefinite channel": (" s\n        - [*", " s\n        - [-0.15", "actions.covariance': expected a symmetric"),
    "indefinite joint": (
        "- [3.0876053",
        "- [-3.0876053",
        "covariances.rigid.door.matrix': expected a symmetric positive semi-de",
    ),
    "unit of a joint": (
        "door: rad\ninputs",
        "door: m\ninputs",
        "key 'coordinates.door': coordinate door: expected the un",
    ),
    "unit of an input": (
        "  door: rad\nlinks",
        "  door: m\nlinks",
        "key 'inputs.door': input door: expected the unit rad of",
    ),
    "always left": (
        "guard: [door >= 1.2",
        "guard: [door >= -1.2",
        "transitions.0.guard': edge revolute -> rigid: its gua",
    ),
    "same transition twice": (
        "transitions:\n",
        "transitions:\n  - {source: rigid, target: revolute, guard: [input door < 0.0]}\n",
        "key 'transitions.3': edge rigid -> revolute: it has the same modes and guard as transition 0",
    ),
    "same effect twice": (
        "learned:\n",
        "effects:\n" + 2 * "  - {name: gain, coordinate: door, parameters: {gain: 0.9}}\n" + "learned:\n",
        "key 'effects.1': effect gain of door is there twice",
    ),
}
PROBLEMS = {
    "no step": ("max_step: {drawer: 0.03}", "max_step: {drawer: 1.0e-300}", "planner.max_step.drawer': expected a"),
    "giant step": ("max_step: {drawer: 0.03}", "max_step: {drawer: 1.0e300}", "expected a number <= 1e+06, found 1"),
    "vague start": ("std: {drawer: 0.01}", "std: {drawer: 1.0e6}", "start.std.drawer': expected a number <= 1000, fo"),
    "far start": ("mean: {drawer: 0.03}", "mean: {drawer: 1.0e300}", "start.mean.drawer': expected a number <= 1e+06"),
    "far goal": ("value: 0.25", "value: 1.0e300", "goal.target.drawer.value': expected a number <= 1e+06, found 1e+"),
    "any goal": ("tolerance: 0.01", "tolerance: 1.0e300", "goal.target.drawer.tolerance': expected a number <= 1e+0"),
    "far body": (
        "goal:",
        "scene: {b: {shapes: [{kind: sphere, size: [1]}], position: [1e99, 0, 0]}}\ngoal:",
        "posit",
    ),
}


def edited(folder: Path, name: str, before: str, after: str) -> Path:
    """A copy of a shipped file with the first of a text replaced; it can be used without that."""
    text = (ROOT / name).read_text().replace("../models", str(ROOT / "models"))
    path = folder / Path(name).name
    path.write_text(replaced(text, before, after))
    return path


@pytest.mark.parametrize("case", MODELS)
def test_a_nonsensical_model_is_refused(tmp_path: Path, case: str) -> None:
    before, after, said = MODELS[case]
    line = told(load_model, edited(tmp_path, "models/microwave.yaml", before, after))
    assert line.startswith(f"{tmp_path}/microwave.yaml, line ")
    assert said in line


@pytest.mark.parametrize("case", PROBLEMS)
def test_a_nonsensical_problem_is_refused(tmp_path: Path, case: str) -> None:
    before, after, said = PROBLEMS[case]
    line = told(load_problem, edited(tmp_path, "problems/drawer_open.yaml", before, after))
    assert line.startswith(f"{tmp_path}/drawer_open.yaml, line ")
    assert said in line


# Why each of these is taken as it is.
EXPLAINED = {
    "negative gain": "a motor that is wired the other way around",
    "force of a rocket": "what a hand may exert is for its owner to say",
}


SLOW = [case for i, case in enumerate(CORPUS) if i % 8]
QUICK = [pytest.param(case, marks=pytest.mark.slow if case in SLOW else ()) for case in CORPUS]


@pytest.mark.sweep
@pytest.mark.parametrize("case", QUICK)
def test_check_refuses_nonsense_or_warns_with_the_place(tmp_path: Path, case: str) -> None:
    name, before, after = CORPUS[case]
    text = (ROOT / name).read_text()
    folder = (ROOT / name).parent
    text = replaced(text, before, after)
    for beside in ("../../models", "../models", "../drawer_open"):
        text = text.replace(beside, str((folder / beside).resolve()))
    path = tmp_path / Path(name).name
    path.write_text(text.replace("simulated: microwave", f"simulated: {folder}/microwave"))
    found = check_file(path)
    if case in EXPLAINED:
        assert (found.faults, found.warnings) == ((), ())
        return
    assert found.faults or found.warnings
    for fault in found.faults:
        line = str(fault)
        assert len(line.splitlines()) == 1
        assert fault.source
        assert line.startswith(fault.source)
    for warning in found.warnings:
        assert ":" in warning


def test_the_corpus_is_large_and_nearly_all_of_it_is_reported() -> None:
    assert len(CORPUS) + len(MODELS) + len(PROBLEMS) >= 120
    assert len(EXPLAINED) <= 4


# Numbers that may be 10,000 times as large: what each says nothing else in its file bounds.
UNBOUNDED = (
    "learned.*.log_evidence",
    "learned.*.segments.*.rows.*",
    "models/cabinet.yaml learned.*.actions.delay",  # 3 ms, since its actions are in time: 30 s then
    "learned.*.actions.covariance.*.*",
    "covariances.*.*.matrix.*.*",  # a std 100 times as large: a joint that is hardly known
    "parts.*.shapes.*.position.*",
    "parts.*.shapes.*.size.*",
    "hold.*.shapes.*.position.*",
    "planner.candidates",
    "planner.weight_covariance",
    "planner.max_step.*",
    "start.std.*",
    "largest_force",
)
NUMBERED = (
    pytest.param("models/microwave.yaml", marks=pytest.mark.slow),
    pytest.param("models/cabinet.yaml", marks=pytest.mark.evidence),
    "models/parts/drawer.yaml",
    "problems/drawer_open.yaml",
    "problems/microwave_close.yaml",
    pytest.param("problems/stapler_on_books.yaml", marks=pytest.mark.evidence),
    "problems/walled_domain.yaml",
    "problems/key_by_touch.yaml",
    "problems/explore_handle.yaml",
    "problems/experiments/drawer.yaml",
)


def places(data: object, place: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    """Of all numbers but 0."""
    if isinstance(data, dict | list):
        for key, value in data.items() if isinstance(data, dict) else enumerate(data):
            yield from places(value, (*place, key))
    elif isinstance(data, int | float) and not isinstance(data, bool) and data:
        yield place


@pytest.mark.sweep
@pytest.mark.parametrize("name", NUMBERED)
def test_a_number_10_000_times_too_large_is_reported(tmp_path: Path, name: str) -> None:
    yaml = YAML(typ="safe", pure=True)
    for folder in ("models", "problems"):
        (tmp_path / folder).symlink_to(ROOT / folder)
    path = tmp_path / name.replace("models", "m", 1).replace("problems", "p", 1)
    path.parent.mkdir(parents=True)
    text = (ROOT / name).read_text()
    tried = set()
    for place in places(yaml.load(text)):
        key = ".".join("*" if isinstance(part, int) else str(part) for part in place)
        if key in tried:
            continue
        tried.add(key)
        data = inner = yaml.load(text)
        for part in place[:-1]:
            inner = inner[part]
        inner[place[-1]] *= 10_000
        with path.open("w") as file:
            yaml.dump(data, file)
        found = check_file(path)
        if not found.faults and not found.warnings:
            assert any(fnmatch(key, pattern) or fnmatch(f"{name} {key}", pattern) for pattern in UNBOUNDED), key
    assert len(tried) >= 4


@pytest.mark.sweep
@pytest.mark.parametrize(("position", "lines"), [(0.04, 0), (1.2, 0), (15.0, 1)])
def test_fingers_slide_or_turn(position: float, lines: int) -> None:
    """Only the file of the robot says which, so a finger may open by as much as a joint turns."""
    problem = load_problem(ROOT / "problems" / "stapler_on_books.yaml")
    assert problem.release is not None
    (name, _), *others = problem.release.fingers
    opened = replace(problem, release=replace(problem.release, fingers=((name, position), *others)))
    assert [line.startswith(f"release.fingers.{name}: ") for line in suspicions_of_problem(opened)] == [True] * lines
