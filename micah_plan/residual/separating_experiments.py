"""Suggested experiments, in words, that separate effects which a recording left tied."""

from __future__ import annotations

from micah_plan.automaton.effects.registry import form
from micah_plan.quantities import count, quantity


def experiment_that_separates(first: str, second: str) -> str:
    """The suggestion for two tied effects, from either form."""
    experiment = dict(form(first).experiments).get(second) or dict(form(second).experiments).get(first)
    return experiment or f"vary size and direction of the commands over the whole range, to tell {first} from {second}"


def experiment_for_alike_runs(name: str) -> str:
    """The suggestion where all runs make the same motion."""
    return f"start elsewhere, and stop on the way: if it is {name}, only the place matters and not what went before"


def experiment_for_unexplained(where: str) -> str:
    """The suggestion where no effect explains the residual."""
    return f"repeat slow and fast motions in both directions {where}, with rests in between"


def experiment_for_missing_mode(place: float, unit: str) -> str:
    """The suggestion for a mode that the automaton lacks."""
    return (
        f"record slow motion through {quantity(place, unit)} in both directions and learn the model again, with that "
        "mode: micah-plan learn RECORDING.csv -o MODEL.yaml"
    )


def experiment_for_nothing(rows: int, moved: float, unit: str) -> str:
    """The suggestion where nothing was found."""
    return (
        f"there is nothing to find in {count(rows, 'row')} over {quantity(moved, unit)}: commands that are larger, "
        "reverse and rest at both ends would show smaller effects"
    )
