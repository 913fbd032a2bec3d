"""A problem document and its model -> problem, and back to plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from micah_plan.automaton.contacts.product import COLLIDED
from micah_plan.automaton.hybrid import HybridAutomaton, Noise
from micah_plan.documents.hold_values import hold_data, hold_of
from micah_plan.documents.located import Located
from micah_plan.documents.model_values import by_name, light_of
from micah_plan.documents.problem_document import PROBLEM_FORMAT, GoalDocument, ProblemDocument, StartDocument
from micah_plan.documents.scene_values import grasp_data, grasp_of, robot_data, robot_of, scene_data, scene_of
from micah_plan.task.goal import Goal
from micah_plan.task.problem import Problem
from micah_plan.task.settings import PlannerSettings
from micah_plan.task.start import Start


def problem_of(
    document: ProblemDocument, automaton: HybridAutomaton, located: Located, folder: Path = Path()
) -> Problem:
    """The problem that a file describes, without its source and digests; whether it is possible is not checked here.

    Args:
        document: the validated layout.
        automaton: the model that it names.
        located: the data that the document was validated from, for the places in messages.
        folder: of the file; the robot and meshes are looked for from there.

    Raises:
        InputError: for unknown names of coordinates, inputs, modes or parts, for missing values, and for files of the
            robot and the scene that cannot be used.
    """
    planner = document.planner.model_dump(exclude={"max_step"})
    max_step = None
    if document.planner.max_step is not None:
        names = automaton.input_names
        max_step = tuple(by_name(document.planner.max_step, names, "input", located, ("planner", "max_step")))
    robot = robot_of(document.robot, located, folder)
    return Problem(
        automaton=replace(automaton, noise=_noise(document, automaton, located)),
        start=_start(document.start, automaton, located),
        goal=_goal(document.goal, automaton, located),
        settings=PlannerSettings(confidence=document.confidence, max_step=max_step, **planner),
        plant=document.plant.model_dump(exclude_none=True),
        scene=scene_of(document.scene, located, folder),
        robot=robot,
        grasp=grasp_of(document.grasp, robot, automaton, located),
        hold=hold_of(document.hold, list(document.scene), located),
    )


def problem_data(problem: Problem, model: str) -> dict[str, Any]:
    """The plain data of a problem file with every setting written out.

    Args:
        problem: its noise is that of its automaton and not repeated here.
        model: what to write as the name of the model file.
    """
    names = problem.automaton.coordinate_names
    settings = {key: value for key, value in vars(problem.settings).items() if key != "confidence"}
    if problem.settings.max_step is None:
        del settings["max_step"]
    else:
        inputs = problem.automaton.input_names
        settings["max_step"] = dict(zip(inputs, problem.settings.max_step, strict=True))
    start: dict[str, Any] = {
        "mean": dict(zip(names, problem.start.mean, strict=True)),
        "std": dict(zip(names, problem.start.std, strict=True)),
    }
    if problem.start.mode is not None:
        start["mode"] = problem.start.mode
    target = {names[index]: {"value": value, "tolerance": tol} for index, value, tol in problem.goal.target}
    return {
        "format": PROBLEM_FORMAT,
        "model": model,
        "start": start,
        "goal": {"target": target, "modes": list(problem.goal.modes)},
        "confidence": problem.settings.confidence,
        "planner": settings,
        "plant": dict(problem.plant),
        **({"scene": scene_data(problem.scene)} if problem.scene else {}),
        **({"robot": robot_data(problem.robot)} if problem.robot is not None else {}),
        **({"grasp": grasp_data(problem.grasp)} if problem.grasp is not None else {}),
        **hold_data(problem.hold),
    }


def _noise(document: ProblemDocument, automaton: HybridAutomaton, located: Located) -> Noise:
    """The model's noise, with the problem's where it states any."""
    names = automaton.coordinate_names
    values = {}
    for key in ("process_std", "observation_std"):
        own: Mapping[str, float] = getattr(document.noise, key)
        everything = {**dict(zip(names, getattr(automaton.noise, key), strict=True)), **own}
        values[key] = tuple(by_name(everything, names, "coordinate", located, ("noise", key)))
    own_light = light_of(document.noise.light, names, located, ("noise", "light"))
    return Noise(**values, light=automaton.noise.light if own_light is None else own_light)


def _start(start: StartDocument, automaton: HybridAutomaton, located: Located) -> Start:
    names = automaton.coordinate_names
    mean = tuple(by_name(start.mean, names, "coordinate", located, ("start", "mean")))
    std = tuple(by_name(start.std, names, "coordinate", located, ("start", "std")))
    modes = automaton.mode_names
    if start.mode is not None and start.mode not in modes:
        raise located.unknown(("start", "mode"), "mode", start.mode, modes)
    return Start(mean, std, start.mode)


def _goal(goal: GoalDocument, automaton: HybridAutomaton, located: Located) -> Goal:
    names = automaton.coordinate_names
    modes = automaton.mode_names
    for i, mode in enumerate(goal.modes):
        if mode not in modes:
            raise located.unknown(("goal", "modes", i), "mode", mode, modes)
    for name in goal.target:
        if name not in names:
            raise located.unknown(("goal", "target", name), "coordinate", name, names)
    target = tuple((names.index(name), wanted.value, wanted.tolerance) for name, wanted in goal.target.items())
    # An object that has hit something has not arrived, wherever it is.
    unharmed = tuple(mode for mode in modes if mode != COLLIDED) if COLLIDED in modes else ()
    return Goal(target, tuple(goal.modes) or unharmed)
