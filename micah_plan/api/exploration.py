"""`explore`: from first contact with a handle to a model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from micah_plan.api.inputs import Source
from micah_plan.api.result import SUREST, Result, save_model
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.message import code_of, codes_of
from micah_plan.quantities import count, percent, quantity
from micah_plan.summaries import Progress, Table
from micah_plan.task.exploration_scene import Scene
from micah_plan.task.plants import DEFAULT_PLANT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.execution.plant import Plant
    from micah_plan.exploration.run import Exploration


@dataclass(frozen=True, eq=False, repr=False)
class ExplorationResult(Result):
    """Result of `explore`: the identified mechanism, and its model if it moved."""

    exploration: Exploration
    seed: int = 0

    @property
    def success(self) -> bool:
        """Whether the object was opened, or certainly is locked."""
        return self.outcome != "gave_up"

    @property
    def outcome(self) -> str:
        """``"opened"``, ``"held"`` or ``"gave_up"``."""
        return self.exploration.outcome

    @property
    def reason(self) -> str:
        """One sentence."""
        return self.exploration.reason

    @property
    def automaton(self) -> HybridAutomaton | None:
        """The model; None if nothing moved."""
        return self.exploration.model

    def report(self) -> list[str | Table]:
        """The identified mechanism with the evidence, and problems on the way."""
        exploration = self.exploration
        outcome = {"opened": "opened", "held": "held", "gave_up": "gave up"}[exploration.outcome]
        joints = ", then ".join(exploration.kinds) or "none moved"
        went, force = quantity(exploration.travel, "m"), quantity(exploration.largest_force, "N")
        return [
            f"{outcome}: {exploration.reason}",
            f"  joints       {joints} (probability {percent(min(exploration.probability, SUREST), 0)})",
            f"  {count(exploration.steps, 'step')}, {went} of travel, at most {force}",
            *(f"  note: {note}" for note in exploration.notes),
        ]

    def json(self) -> dict[str, Any]:
        """Outcome, joints with their probability, steps, distance and forces."""
        exploration = self.exploration
        return {
            "outcome": exploration.outcome,
            "steps": exploration.steps,
            "max_force_n": exploration.largest_force,
            "joints": list(exploration.kinds),
            "probability": exploration.probability,
            "travel_m": exploration.travel,
            "seconds": exploration.seconds,
            "reason": exploration.reason,
            "reason_code": code_of(exploration.reason),
            "notes": list(exploration.notes),
            "note_codes": codes_of(exploration.notes),
            "tried_n": exploration.tried,
            "hand_stiffness_n_per_m": 1.0 / exploration.hand.compliance,
            "slowest_step_cpu_s": exploration.thinking,
            "seed": self.seed,
        }

    def plot(self) -> Figure:
        """Forces with their limit, and the probabilities of mechanisms, over the steps."""
        from micah_plan.view.exploration_page import exploration_charts
        from micah_plan.view.figures import chart_figure

        return chart_figure(exploration_charts(self.exploration))

    def page(self, title: str = "") -> str:
        """The path of the hand, hypotheses, forces and probabilities."""
        from micah_plan.view.exploration_page import exploration_page

        return exploration_page(self.exploration, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the model (YAML)."""
        save_model(self.automaton, self.reason, path)


def explore(
    scene: Source | Scene,
    *,
    plant: str | Callable[[Any], Plant] = DEFAULT_PLANT,
    seed: int = 0,
    progress: Progress | None = None,
) -> ExplorationResult:
    """Open an unknown object by its handle, and learn its model.

    Args:
        scene: a path, or the limits of the hand.
        plant: ``"nominal"`` or ``"mujoco"``, with the object that the scene names; or a function that makes a plant
            from the scene.
        seed: of the plant's start and noise; decisions are deterministic.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if there is no such scene or plant, its code fails, or an answer is no usable measurement.
        PlantError: if the machine cannot be made or reset.
    """
    from micah_plan.documents.exploration_scene import load_scene
    from micah_plan.execution.handle import HandlePlant, make_handle_plant
    from micah_plan.exploration.run import explore as run

    asked = scene if isinstance(scene, Scene) else load_scene(scene)
    with HandlePlant(make_handle_plant(asked, plant)) as machine:
        return ExplorationResult(run(asked, machine, np.random.default_rng(seed), progress), seed)
