"""An exploration from first contact to its end, with its result."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.execution.handle import HandlePlant
from micah_plan.execution.plant import Command, PlantError
from micah_plan.exploration import messages
from micah_plan.exploration.chain import Chain
from micah_plan.exploration.explorer import Explorer, Moment, Outcome
from micah_plan.exploration.hand import Hand
from micah_plan.exploration.handover import explored_model
from micah_plan.quantities import quantity
from micah_plan.task.exploration_scene import Scene

_NEAR = 0.05  # m, from the place of the hand in the scene


@dataclass(frozen=True, eq=False)
class Exploration:
    """Result of an exploration.

    Attributes:
        outcome: ``"opened"``: the handle moved as far as the scene requires, and the tracker saw it; ``"held"``:
            nothing moves it within the force; ``"gave_up"``: undecided.
        reason: one sentence.
        notes: faults, one sentence each.
        scene: the task.
        kinds: of the joints, from where it was found; empty where nothing moved.
        probability: that these are the joints; of ``held``: that nothing moves it within the force.
        travel: largest displacement of the handle along its path from where it was found, as far as the tracker agreed
            [m].
        largest_force: measured [N].
        tried: the largest force of a push without motion [N].
        hand: stiffness and meaning of commands, as found.
        chain: the most probable chain of joints; None where nothing moved.
        moments: one per step.
        model: its automaton; None where nothing moved, or the hand lost the handle.
        seconds: wall-clock time of all; thinking: CPU time of the longest step [s].
    """

    outcome: Outcome
    reason: str
    notes: tuple[str, ...]
    scene: Scene
    kinds: tuple[str, ...]
    probability: float
    travel: float
    largest_force: float
    tried: float
    hand: Hand
    chain: Chain | None
    moments: tuple[Moment, ...]
    model: HybridAutomaton | None
    seconds: float
    thinking: float

    @property
    def steps(self) -> int:
        return len(self.moments)


def explore(
    scene: Scene,
    plant: HandlePlant,
    rng: np.random.Generator,
    progress: Callable[[str, float], None] | None = None,
) -> Exploration:
    """Open the held object, or establish that it is locked.

    Args:
        plant: checked; it is reset first, and not closed here.
        rng: of the plant's start and noise. Decisions are deterministic.
        progress: called with a message and the fraction done.

    Raises:
        PlantError: if the machine cannot be reset. One that fails later ends the exploration, which gives up.
        InputError: if the plant's code raised another error, or an answer is not a usable measurement.
    """
    begin, thinking = time.perf_counter(), 0.0
    first = plant.reset(rng)
    if scene.position is not None and np.linalg.norm(first.position[0] - scene.position) > _NEAR:
        away = quantity(float(np.linalg.norm(first.position[0] - scene.position)), "m")
        remedy = "correct holds.position of the scene, or leave it out"
        raise InputError(f"the handle is first measured {away} from the place in the scene", remedy=remedy)
    if scene.is_outside(first.position[0]):
        remedy = "correct workspace of the scene, or leave it out"
        raise InputError("the handle is first measured outside of the workspace", remedy=remedy)
    explorer = Explorer(scene, first)
    while True:
        started = time.process_time()
        command = explorer.decide()
        if command is None:
            break
        thought = time.process_time() - started
        try:
            measurement = plant.apply(Command(command, command[None].copy(), command[None].copy()))
        except PlantError as failure:
            explorer.stopped(str(failure))
            break
        started = time.process_time()
        explorer.take(measurement)
        thinking = max(thinking, thought + time.process_time() - started)
        if progress is not None:
            progress(_progress_message(explorer), min(1.0, explorer.steps / scene.steps))
    return _result(explorer, time.perf_counter() - begin, thinking)


def _progress_message(explorer: Explorer) -> str:
    if explorer.chain is None:
        return messages.searching(explorer.steps)
    return messages.following(explorer.steps, explorer.chain.kinds[-1], explorer.range_seen)


def _result(explorer: Explorer, seconds: float, thinking: float) -> Exploration:
    chain, probability = explorer.most_probable_mechanism()
    outcome: Outcome = explorer.outcome or "gave_up"
    moments = tuple(explorer.moments)
    return Exploration(
        outcome=outcome,
        reason=explorer.reason,
        notes=tuple(explorer.record.notes),
        scene=explorer.scene,
        kinds=() if chain is None else chain.kinds,
        probability=probability,
        travel=0.0 if chain is None else explorer.travel,
        largest_force=max((float(np.linalg.norm(moment.force)) for moment in moments), default=0.0),
        tried=explorer.tried,
        hand=explorer.record.hand,
        chain=chain,
        moments=moments,
        model=None if chain is None or explorer.record.lost else explored_model(explorer, chain),
        seconds=seconds,
        thinking=thinking,
    )
