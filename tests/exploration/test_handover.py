"""The model that an exploration leaves plans at once, and its plans are carried out on the same object."""

from __future__ import annotations

from pathlib import Path

import pytest
from explore_handover import closed_and_reopened
from explore_plants import Stage, Thing

X, Y, HINGE = (1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 2.5)
THINGS = (
    Thing("drawer", (Stage(0.4, Y),)),
    Thing("hinge_left", (Stage(0.4, Y, HINGE),)),
    Thing("latched_door", (Stage(0.4, Y, HINGE),), latch=20.0),
    Thing("two_stage", (Stage(0.1, X), Stage(0.4, Y, HINGE))),
)


@pytest.mark.sweep
@pytest.mark.parametrize("thing", THINGS, ids=lambda thing: thing.family)
def test_what_was_opened_is_closed_and_opened_again_with_the_model(thing: Thing, tmp_path: Path) -> None:
    assert closed_and_reopened(thing, 0, tmp_path) == ""
