"""The stages as functions that take paths or values and return results that say what came out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from micah_plan.api import inputs, stages
from micah_plan.api.inputs import Measured, Modelled, Source
from micah_plan.api.results import (
    CalibrationResult,
    ExplorationResult,
    LearningResult,
    Page,
    PlanningResult,
    PredictionResult,
    Result,
    RunsResult,
    save_model,
)
from micah_plan.api.stages import Method
from micah_plan.automaton.hybrid import HybridAutomaton, Part
from micah_plan.errors import InputError
from micah_plan.learn.settings import LearnSettings
from micah_plan.quantities import Progress
from micah_plan.recording.value import Recording
from micah_plan.task.experiment import Scene
from micah_plan.task.plants import DEFAULT_PLANT
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from micah_plan.execution.plant import Plant, PlantMaker

load = inputs.load


def learn(
    recording: Measured,
    *,
    method: Method = "act-champ",
    seed: int = 0,
    parts: Source | Sequence[Part] = (),
    settings: LearnSettings | None = None,
    base: str | None = None,
    progress: Progress | None = None,
    **changes: Any,
) -> LearningResult:
    """A hybrid automaton from a recording, or the reason why there is none.

    Args:
        recording: a path, a recording, or executed runs.
        method: ``"act-champ"`` uses the actions, ``"champ"`` the poses alone.
        seed: of everything random; the same seed gives the same result.
        parts: shapes and handles of the parts: a path or values.
        settings: None: the defaults.
        base: a tracked part on which the object stands, as a door on a cart that is pushed: the model is in its frame.
        progress: called with a message and the fraction done.
        **changes: settings by name, e.g. ``kinds=("rigid", "prismatic")``.

    Raises:
        InputError: if the recording cannot be learned from, or a setting is none.
    """
    measured, shapes = inputs.demonstration_of(recording), inputs.parts_of(parts)
    chosen = inputs.learn_settings(settings, changes)
    result = stages.learn(
        measured, method=method, seed=seed, parts=shapes, settings=chosen, base=base, progress=progress
    )
    return LearningResult(result)


def solve(
    problem: Source | Problem | LearningResult | ExplorationResult | CalibrationResult | PlanningResult,
    *,
    model: Modelled | None = None,
    seed: int = 0,
    advise: bool = True,
    progress: Progress | None = None,
    **changes: Any,
) -> PlanningResult:
    """A plan that holds with the problem's confidence, or what is in the way.

    Args:
        problem: a path, a problem, or an earlier result whose problem is solved again; a model, or what learned one, is
            moved most of its way.
        model: to use instead of the problem's: a path, an automaton, or what `learn` or `calibrate` returned.
        seed: of everything random.
        advise: whether remedies name numbers, which takes further solutions.
        progress: called with a message and the fraction done.
        **changes: settings by name, e.g. ``confidence=0.99, max_knots=80``.

    Raises:
        InputError: if the problem or the model cannot be used, or a setting is none.
    """
    asked = inputs.problem_of(problem, model)
    asked = replace(asked, settings=inputs.planner_settings(asked, changes))
    return PlanningResult(stages.solve(asked, seed=seed, progress=progress, advise=advise), asked)


def execute(
    plan: Source | PlanningResult,
    *,
    plant: str | PlantMaker | Plant = DEFAULT_PLANT,
    trials: int = 1,
    seed: int = 0,
    replan_every: int | None = None,
    plant_parameters: Mapping[str, float] | None = None,
    start: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> RunsResult:
    """The runs of a plan in closed loop.

    Args:
        plan: a path or what `solve` returned.
        plant: ``"nominal"`` (the model itself), ``"mujoco"``, or a plant of your own: a class or an object.
        trials: how many.
        seed: of everything random; each trial has its own stream.
        replan_every: steps after which the rest of the plan is optimised again; 0: never; None: as the problem says.
        plant_parameters: physical parameters that differ from the problem's, e.g. ``{"friction": 25.0}``.
        start: where simulated trials truly start, by coordinate, whatever is believed [rad or m].
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the plan is no solution, or the plant cannot be used.
        MissingDependencyError: if the plant needs a library that is not installed.
        PlantError: if the machine cannot be reset.
    """
    chosen = inputs.plan_of(plan)
    problem = replace(chosen.problem, plant={**chosen.problem.plant, **(plant_parameters or {})})
    true = {problem.automaton.index(name): value for name, value in (start or {}).items()}
    problem = replace(problem, start=replace(problem.start, true=tuple({**dict(problem.start.true), **true}.items())))
    statistics = stages.execute(
        problem, chosen.plan, plant=plant, trials=trials, seed=seed, replan_every=replan_every, progress=progress
    )
    return RunsResult(statistics, PlanningResult(chosen.plan, problem))


def explore(
    scene: Source | Scene,
    *,
    plant: str | Callable[[Any], Plant] = DEFAULT_PLANT,
    seed: int = 0,
    progress: Progress | None = None,
) -> ExplorationResult:
    """Open what a hand holds without a model of it, and get one.

    Args:
        scene: a path, or what the hand may do.
        plant: ``"nominal"`` or ``"mujoco"``, with the object that the scene names; or what makes a plant of the scene.
        seed: of the plant; decisions draw nothing.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the scene or the plant cannot be used.
        PlantError: if the machine cannot be made or reset.
    """
    from micah_plan.documents.experiment import load_scene

    asked = scene if isinstance(scene, Scene) else load_scene(scene)
    return ExplorationResult(stages.explore(asked, plant=plant, seed=seed, progress=progress))


def predict(model: Modelled, recording: Measured, *, actions_as_learned: bool = False) -> PredictionResult:
    """Measured motion against the model's predictions, one step ahead and from the first row on.

    Args:
        model: a path of a model, problem or plan; an automaton; or a result that has one.
        recording: a path, a recording, or executed runs, with actions.
        actions_as_learned: whether actions act as they did in the demonstration that the model was learned from.

    Raises:
        InputError: if the recording has no actions or other parts than the model.
    """
    from micah_plan.residual.prediction import predict_recording

    automaton, measured = inputs.automaton_of(model), inputs.recording_of(recording, minimum_rows=2)
    if actions_as_learned:
        automaton = stages.for_demonstrations(automaton, measured)
    return PredictionResult(automaton, measured, predict_recording(automaton, measured))


def calibrate(model: Modelled, recording: Measured, *, progress: Progress | None = None) -> CalibrationResult:
    """What a model lacks in measured motion, and the model with it.

    Args:
        model, recording: as of `predict`.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if the recording has no actions, too few rows or other parts than the model.
    """
    from micah_plan.residual.calibrate import calibrate as calibrated

    automaton, measured = inputs.automaton_of(model), inputs.recording_of(recording, minimum_rows=2)
    return CalibrationResult(calibrated(automaton, measured, progress), automaton, measured)


def save(value: Any, path: Source) -> None:
    """Write a recording, a model, or what a result is about, at once or not at all.

    Raises:
        InputError: if the file cannot be written, or there is nothing to write.
    """
    from micah_plan.recording.read import write_recording

    if isinstance(value, Result):
        value.save(path)
    elif isinstance(value, HybridAutomaton):
        save_model(value, "", path)
    elif isinstance(value, Recording):
        write_recording(value, path)
    else:
        raise InputError(f"there is no file for a {type(value).__name__}", remedy="give a recording, model or result")


def show(value: Any, path: Source | None = None) -> Page:
    """The page of a recording, a model or a result: opened in the browser, or within a notebook.

    Args:
        value: what to show.
        path: where to write the page, and nothing is opened; None: a temporary file.

    Raises:
        InputError: if there is no page of such a value.
    """
    if isinstance(value, Result):
        return value.show(path)
    if isinstance(value, Recording):
        from micah_plan.view.recording_page import recording_page

        return Page(recording_page(value)).opened(path)
    if isinstance(value, HybridAutomaton):
        from micah_plan.view.model_page import model_page

        return Page(model_page(value)).opened(path)
    raise InputError(f"there is no page of a {type(value).__name__}", remedy="give a recording, model or result")
