"""The layout of a sweep file, `format: micah-plan/sweep/1`. What it means is built in `sweep_file`."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.documents.fields import Document, Line, Name
from micah_plan.task.plants import DEFAULT_PLANT, SENTENCES, PlantName

SWEEP_FORMAT = "micah-plan/sweep/1"


class ExecuteDocument(Document):
    plant: PlantName = Field(default=DEFAULT_PLANT, description=f"Where plans are executed; {SENTENCES}.")
    trials: Annotated[int, Field(ge=1, le=10_000)] = Field(default=10, description="Seeded trials of every plan.")


class SweepDocument(Document):
    """Solve problems with every combination of values and every seed, and put the results into one table."""

    format: Literal["micah-plan/sweep/1"] = Field(description="Format and version of this file.")
    problems: Annotated[list[Line], Field(min_length=1, max_length=1000)] = Field(
        description="Problem files, relative to this file."
    )
    seeds: Annotated[int, Field(ge=1, le=1_000_000)] = Field(default=1, description="How many seeds.")
    first_seed: Annotated[int, Field(ge=0, le=1_000_000_000)] = Field(default=0, description="The first of them.")
    grid: dict[Name, Annotated[list[Any], Field(min_length=1)]] = Field(
        default_factory=dict,
        max_length=50,
        description="Values to try instead of a problem's own, by dotted key of the problem file, e.g. "
        "`start.std.door: [0.02, 0.05]`; every combination is a case.",
    )
    execute: ExecuteDocument | None = Field(default=None, description="Execution of every plan; default: none.")
