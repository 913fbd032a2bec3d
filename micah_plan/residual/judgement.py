"""Assessment of prediction errors: noise floors, regressors that explain the rest, and mode changes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.link_motion import link_motions
from micah_plan.message import Message
from micah_plan.recording.value import Recording
from micah_plan.residual import messages
from micah_plan.residual.examined import Examined, examined
from micah_plan.residual.faulty_runs import FaultyRun, outlying_runs
from micah_plan.residual.held_out import HeldOut
from micah_plan.residual.prediction import RunPrediction
from micah_plan.residual.residual_test import FEWEST_ROWS, Circumstances, lagged_commands, whiteness_test


@dataclass(frozen=True)
class Floor:
    """Noise floors, root mean square: position [m], rotation [rad], configuration [rad or m].

    `coordinates` has the floor of each coordinate in its own unit; `configuration` combines them.
    """

    position: float
    rotation: float | None
    configuration: float
    coordinates: tuple[float, ...]


@dataclass(frozen=True)
class ModeChange:
    """A mode change, with its measured and its predicted time [s since the run's start]."""

    run: int
    mode: str
    measured: float | None
    predicted: float | None


@dataclass(frozen=True)
class Judgement:
    """Assessment of the errors of predicted runs.

    Attributes:
        one_step, rollout: floors; None with too few rows.
        is_noise: whether only noise remains (then `calibrate` finds nothing); None if uncertain.
        sentence: the same in words.
        follows: (coordinate, function, probability under noise) that innovations follow.
        correlation: of one-step errors with the next; 0 to -0.5 for noise.
        changes: of modes.
    """

    one_step: Floor | None
    rollout: Floor | None
    is_noise: bool | None
    sentence: str
    follows: tuple[tuple[str, str, float], ...]
    correlation: float
    changes: tuple[ModeChange, ...]


def judge(automaton: HybridAutomaton, recording: Recording, runs: Sequence[RunPrediction]) -> Judgement:
    """Assess the errors of predicted runs against their own noise.

    The test of innovations and of deviations from the joints is that of `calibrate`, as are the floors of noise.
    """
    changes = tuple(change for run in runs for change in _changes(run))
    errors = [[run.one_step.configuration[:, i] for run in runs] for i in range(automaton.n)]
    correlation = max(map(_correlation, errors), key=abs)
    if sum(len(run.v) for run in runs) < FEWEST_ROWS:
        return Judgement(None, None, None, messages.too_few_rows(), (), correlation, changes)
    examination = examined(automaton, recording)
    one_step, rollout = _floors(automaton, runs, examination.models)
    sentence = _sentence(examination, () if examination.is_noise else _outlying_runs_of(automaton, runs))
    late = f"{messages.actions_stored_late(examination.late)}. " if examination.late else ""
    follows = tuple(
        (model.data.coordinate, *follow)
        for model, test in examination.innovation_tests
        if test
        for follow in test.follows
    )
    return Judgement(one_step, rollout, examination.is_noise, late + sentence, follows, correlation, changes)


def _outlying_runs_of(automaton: HybridAutomaton, runs: Sequence[RunPrediction]) -> list[FaultyRun]:
    """Runs with outlying errors, one entry for each coordinate concerned."""
    numbers = list(dict.fromkeys(run.run for run in runs))
    faulty = []
    for i, coordinate in enumerate(automaton.coordinates):
        parts = [[run.one_step.configuration[:, i] for run in runs if run.run == number] for number in numbers]
        faulty += outlying_runs(numbers, [np.concatenate(part) for part in parts], coordinate.name, coordinate.unit)
    return faulty


def _sentence(examination: Examined, faulty: Sequence[FaultyRun]) -> Message:
    if examination.is_noise:
        return messages.errors_are_noise()
    regressors = [
        (model.data.coordinate, str(test))
        for model, test in examination.innovation_tests
        if test is not None and test.is_more
    ]
    findings: list[str] = [messages.errors_depend_on(regressors)] if regressors else []
    findings += map(str, (*examination.off_joint_error, *faulty))
    direct = [f"{finding.effect.name} of {finding.effect.coordinate}" for finding in examination.direct]
    findings += [messages.poses_ask_for(direct)] if direct else []
    if findings:
        return messages.errors_not_noise(findings)
    return messages.whiteness_inconclusive() if examination.models else messages.no_own_inputs()


def _circumstances(runs: Sequence[RunPrediction], i: int) -> Circumstances:
    # Places come from the row before, so that an error's own measurements have no part in them.
    places = [np.concatenate([run.x[:1, i], run.x[:-2, i] + run.v[:-1, i]]) for run in runs]
    steps = sum(len(run.v) for run in runs)
    return Circumstances(
        place=np.concatenate(places),
        command=np.concatenate([lagged_commands(run.v[:, i]) for run in runs]),
        time=np.concatenate([run.time[:-1] for run in runs]),
        order=np.arange(steps) / steps,
    )


def _correlation(errors: Sequence[Floats]) -> float:
    """Lag-1 autocorrelation of errors within runs."""
    every = np.concatenate(list(errors))
    centred = [error - every.mean() for error in errors]
    power = float(sum((error**2).sum() for error in centred))
    product = float(sum((error[1:] * error[:-1]).sum() for error in centred))
    return product / power if power > 1e-18 * len(every) else 0.0


def _floors(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], coordinates: Sequence[HeldOut]
) -> tuple[Floor | None, Floor | None]:
    """Noise floors of one step and of the roll-out; None unless every coordinate has its own input.

    Along the joints, floors are those of the models, as in `calibrate`. Across a joint, errors are those of its
    measured poses in both.
    """
    of_coordinate = {one.data.coordinate: one for one in coordinates}
    if not all(coordinate.name in of_coordinate for coordinate in automaton.coordinates):
        return None, None
    ordered = [of_coordinate[coordinate.name] for coordinate in automaton.coordinates]
    floors = [one.floors_without_explained_part() for one in ordered]
    steps, rolled = ([floor[k] for floor in floors] for k in (0, 1))
    along = np.array([steps, rolled])
    position = _with_transverse_errors(automaton, runs, along, 3, [run.one_step.offset for run in runs])
    turns = [run.one_step.turn for run in runs if run.one_step.turn is not None]
    is_turned = len(turns) == len(runs)
    rotation = _with_transverse_errors(automaton, runs, along, 0, turns).tolist() if is_turned else (None, None)
    one_step, rollout = (
        Floor(float(place), turn, float(np.sqrt(np.mean(sizes**2))), tuple(sizes.tolist()))
        for place, turn, sizes in zip(position, rotation, along, strict=True)
    )
    return one_step, rollout


def _with_transverse_errors(
    automaton: HybridAutomaton, runs: Sequence[RunPrediction], along: Floats, first: int, errors: Sequence[Floats]
) -> Floats:
    """(2,) floors of a vector error over all links, given the floors along the joints (2, n).

    Args:
        first: row of the Jacobian at which the vector's part along the joint begins.
        errors: one step's vectors (T, links, 3) of each run.
    """
    totals = []
    every = np.concatenate(list(errors))
    for number, link in enumerate(automaton.links):
        i = link.coordinate
        test = whiteness_test(every[:, number], _circumstances(runs, i))
        x = np.concatenate([run.x[1:, i] for run in runs])
        j = link_motions(automaton)[number].tangents(x)[:, first : first + 3]
        along2 = float(np.mean((j**2).sum(axis=1))) * along[:, i] ** 2
        whole2 = 0.0 if test is None else float((test.floor**2).sum())
        totals.append(max(whole2 - along2[0], 0.0) + along2)
    return np.asarray(np.sqrt(np.mean(totals, axis=0)))


def _changes(run: RunPrediction) -> list[ModeChange]:
    """Mode changes of the filter and of the roll-out, paired in order while they agree."""
    measured, predicted = (_entries(modes, run.time) for modes in (run.one_step.modes, run.rollout.modes))
    faulty = []
    while measured or predicted:
        if measured and predicted and measured[0][0] == predicted[0][0]:
            mode, at = measured.pop(0)
            faulty.append(ModeChange(run.run, mode, at, predicted.pop(0)[1]))
        elif measured and (not predicted or measured[0][1] <= predicted[0][1]):
            mode, at = measured.pop(0)
            faulty.append(ModeChange(run.run, mode, at, None))
        else:
            mode, at = predicted.pop(0)
            faulty.append(ModeChange(run.run, mode, None, at))
    return faulty


def _entries(modes: Sequence[str], time: Floats) -> list[tuple[str, float]]:
    """(mode, time [s]) of each change of the mode."""
    return [(mode, float(time[k + 1])) for k, mode in enumerate(modes) if k and mode != modes[k - 1]]
