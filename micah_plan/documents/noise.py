"""Process and observation noise: the entry `noise` of models and problems."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any

from pydantic import Field

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.sensing import Light
from micah_plan.documents.layout import Document, Name, NonNegative, Positive, doc, plain, unique
from micah_plan.documents.located import Located
from micah_plan.errors import InputError


class LightDocument(Document):
    at: Annotated[dict[Name, float], Field(min_length=1)] = doc(
        "The place, by coordinate [rad or m]; a coordinate that is left out does not count."
    )
    growth: dict[Name, NonNegative] = doc(
        "Std that a measurement of a coordinate gains per unit of distance from there: its variance is "
        "observation_std² + (growth · distance)²."
    )


class NoiseDocument(Document):
    process_std: dict[Name, NonNegative] = doc(
        "Std of what the dynamics leave unexplained, by coordinate [rad or m, per step]."
    )
    observation_std: dict[Name, Positive] = doc(
        "Std of one measurement of the configuration, by coordinate [rad or m]."
    )
    light: LightDocument | None = doc("Where measurements are best; default: they are the same everywhere.", None)


class ProblemNoiseDocument(Document):
    process_std: dict[Name, NonNegative] = doc("Std of what the dynamics leave unexplained [rad or m, per step].", dict)
    observation_std: dict[Name, Positive] = doc("Std of one measurement of the configuration [rad or m].", dict)
    light: LightDocument | None = doc("Where measurements are best, instead of the model's.", None)


def noise_of(
    document: NoiseDocument | ProblemNoiseDocument, names: Sequence[str], located: Located, model: Noise | None = None
) -> Noise:
    """The noise that an entry describes; a coordinate that a light says nothing of gains nothing from it.

    Args:
        model: what holds where the entry says nothing.

    Raises:
        InputError: for an unknown name, and for a missing one without a model.
    """
    stds = {}
    for key in ("process_std", "observation_std"):
        own = {} if model is None else dict(zip(names, getattr(model, key), strict=True))
        stds[key] = located.at(key).in_order(own | getattr(document, key), names, "coordinate")
    light = None if model is None else model.light
    if document.light is not None:
        at, growth = document.light.at, dict.fromkeys(names, 0.0) | document.light.growth
        place = located.at("light", "at")
        light = Light(
            tuple((place.at(name).number(name, names, "coordinate"), value) for name, value in at.items()),
            located.at("light", "growth").in_order(growth, names, "coordinate"),
        )
    return Noise(**stds, light=light)


def noise_data(noise: Noise, names: Sequence[str]) -> dict[str, Any]:
    """The entry of a model's noise, which `noise_of` reads back."""
    data: dict[str, Any] = {key: _by_name(names, getattr(noise, key)) for key in ("process_std", "observation_std")}
    if noise.light is not None:
        at = unique((names[i], value) for i, value in noise.light.at)
        data["light"] = plain(LightDocument, {"at": at, "growth": _by_name(names, noise.light.growth)})
    return plain(NoiseDocument, data)


def _by_name(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    if len(names) != len(values):
        raise InputError(f"automaton: expected {len(names)} standard deviations, found {len(values)}")
    return dict(zip(names, values, strict=True))
