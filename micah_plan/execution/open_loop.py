"""Open-loop execution of experiments: commands as written, with the log of any execution."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from micah_plan.belief.filter import initial_belief, predict_belief, update
from micah_plan.execution import messages
from micah_plan.execution.checked_plant import CheckedPlant, make_plant
from micah_plan.execution.closed_loop import true_state
from micah_plan.execution.log import RunLog, concatenated_recordings
from micah_plan.execution.plant import PlantError, PlantMaker
from micah_plan.execution.pose import command, reading
from micah_plan.planning.input_memories import with_input_memory
from micah_plan.recording.value import Recording
from micah_plan.task.experiment import Experiment
from micah_plan.task.plants import DEFAULT_PLANT
from micah_plan.task.problem import Problem


def carry_out(
    experiment: Experiment,
    *,
    plant: str | PlantMaker = DEFAULT_PLANT,
    seed: int = 0,
    progress: Callable[[str, float], None] | None = None,
    keep: Callable[[Recording], None] | None = None,
) -> tuple[Recording, tuple[tuple[int, str], ...]]:
    """Carry out all motions of an experiment; each run has its own random stream.

    Args:
        plant: as of `trials.run_trials`, made anew for each motion, whose start it is to know.
        progress: called with a message and the fraction done.
        keep: called with the log of every run when it ends, also when an error or Ctrl-C breaks it off.

    Returns:
        The logs, and (run, reason) of runs that the machine did not finish.

    Raises:
        InputError: if there is no such plant, or its code raised an error or returned something that is not a
            measurement.
        MissingDependencyError: if the plant needs a library that is not installed.
        PlantError: if the machine cannot be reset.
    """
    parts = [link.child for link in experiment.automaton.links]
    logs: list[Recording] = []
    failures: list[tuple[int, str]] = []
    total = len(experiment.motions) * experiment.repetitions
    for number, motion in enumerate(experiment.motions):
        problem = experiment.problem(number)
        with CheckedPlant(make_plant(problem, plant), parts) as machine:
            for _ in range(experiment.repetitions):
                run, log = len(logs), RunLog(problem.automaton)
                rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run,)))
                try:
                    _run_motion(problem, motion.commands, machine, rng, log)
                except PlantError as failure:
                    if not len(log):
                        raise  # it cannot be reset
                    failures.append((run, messages.machine_failed(len(log), str(failure))))
                finally:
                    if keep is not None and len(log):
                        keep(log.recording(run))
                logs.append(log.recording(run))
                if progress is not None:
                    progress(f"run {run + 1} of {total}", (run + 1) / total)
    return concatenated_recordings(logs), tuple(failures)


def _run_motion(
    problem: Problem,
    commands: tuple[tuple[float, ...], ...],
    machine: CheckedPlant,
    rng: np.random.Generator,
    log: RunLog,
) -> None:
    """One run: the belief provides the origin of each command and is logged."""
    whole, plain = with_input_memory(problem), problem.automaton
    belief = initial_belief(whole.automaton, whole.start.mean, whole.start.std, whole.start.mode)
    measurement = machine.reset(rng)
    for u in (*(np.array(row) for row in commands), None):
        belief = update(whole.automaton, belief, reading(plain, belief, measurement))
        mode, truth = belief.most_likely, machine.truth()
        true_x = None if truth is None else true_state(plain, truth)[1]
        if u is None:
            log.add(measurement, belief, true_x, None)
            return
        order = command(plain, plain.modes[mode].name, belief.means[mode, : plain.n], u)
        log.add(measurement, belief, true_x, order.origin)
        measurement = machine.apply(order)
        belief = predict_belief(whole.automaton, belief, u)
