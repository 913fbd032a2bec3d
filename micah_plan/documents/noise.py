"""The entry `noise` of models and problems."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from micah_plan.automaton.hybrid import Noise
from micah_plan.automaton.sensing import Light
from micah_plan.documents.fields import (
    ITEMS,
    CoordinateName,
    EachCoordinate,
    Name,
    NonNegative,
    Place,
    Std,
    StdOrZero,
    each,
)
from micah_plan.documents.layout import Document, doc


class LightDocument(Document):
    makes = Light

    at: Annotated[dict[CoordinateName, Place], Field(min_length=1), ITEMS] = doc(
        "The place, by coordinate [rad or m]; a coordinate that is left out does not count."
    )
    growth: Annotated[dict[Name, NonNegative], each("coordinate", default=0.0)] = doc(
        "Std that a measurement of a coordinate gains per unit of distance from there: its variance is "
        "observation_std² + (growth · distance)²."
    )


class NoiseDocument(Document):
    makes = Noise

    process_std: EachCoordinate[StdOrZero] = doc(
        "Std of what the dynamics leave unexplained, by coordinate [rad or m, per step]."
    )
    observation_std: EachCoordinate[Std] = doc("Std of one measurement of the configuration, by coordinate [rad or m].")
    light: LightDocument | None = doc("Where measurements are best; default: they are the same everywhere.", None)


class ProblemNoiseDocument(Document):
    process_std: dict[CoordinateName, StdOrZero] = doc(
        "Std of what the dynamics leave unexplained [rad or m, per step].", dict
    )
    observation_std: dict[CoordinateName, Std] = doc("Std of one measurement of the configuration [rad or m].", dict)
    light: LightDocument | None = doc("Where measurements are best, instead of the model's.", None)


def noise_with(noise: Noise, entry: Mapping[str, Any]) -> Noise:
    """A model's noise with the overrides of a problem's entry."""

    def std(key: str) -> tuple[float, ...]:
        return tuple(entry[key].get(i, value) for i, value in enumerate(getattr(noise, key)))

    return Noise(std("process_std"), std("observation_std"), entry["light"] or noise.light)
