"""The built-in plants: the single list of names for files, commands and functions.

A file may name a plant of this list and nothing else. Other code is loaded only if named on the command line
(`micah_plan.cli.planning`), or passed in Python.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

DEFAULT_PLANT = "nominal"


@dataclass(frozen=True)
class BuiltInPlant:
    """A plant that comes with the package.

    Attributes:
        maker: ``module:name`` of the function that makes it from a problem, in the form of an entry point.
        sentence: its description for help texts.
        abreast: whether many of them may run in step with each other: they are cheap, and no time passes in them.
    """

    maker: str
    sentence: str
    abreast: bool = False


BUILT_IN: Mapping[str, BuiltInPlant] = {
    "nominal": BuiltInPlant("micah_plan.execution.nominal:NominalPlant.of", "the model with noise", abreast=True),
    "mujoco": BuiltInPlant("micah_plan.execution.mujoco.held:in_mujoco", "independent physics"),
}
SENTENCES = "; ".join(f"{name}: {plant.sentence}" for name, plant in BUILT_IN.items())

if TYPE_CHECKING:
    PlantName = str
else:
    PlantName = Literal[tuple(BUILT_IN)]
"""The name of one of them; where documents are read, no other text is accepted."""
