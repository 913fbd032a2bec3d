"""A recording as a model without anything added sees it: what `predict` judges by, and where `calibrate` begins.

Noise is told by innovations: what a filter with the model misses of each row, knowing all rows before. Commands of a
controller depend on what it measured, so errors from one measured row to the next follow the commands of any closed
loop, even if nothing is missing. Innovations depend on nothing before them if the model is right (Kailath, Sayed and
Hassibi, "Linear Estimation", ch. 9).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.recording.value import Recording
from micah_plan.residual.geometry import Beside, DirectFinding, geometry_findings, lying_beside
from micah_plan.residual.lane import lanes
from micah_plan.residual.leftover import Leftover
from micah_plan.residual.reading import reading_findings
from micah_plan.residual.search import Search
from micah_plan.residual.seen import Beyond, at_measurements, beyond_range, opened, read_tracks


@dataclass(frozen=True, eq=False)
class Examined:
    """What is known before effects on the motion are sought.

    Attributes:
        automaton: with what poses and beliefs ask for by themselves, and joints that go on where the recording does.
        geometry, reading: those effects.
        seen, measured: tracks without and with them, of all runs and of those with two rows or more.
        searches: of every coordinate that moves; none for a model that is not one input per coordinate.
        beside: how poses lie beside the joints, whatever joints have been changed.
        is_readable: whether each coordinate has an input of its own, and some move.
        late: by how many rows actions were stored after those that they moved; they were taken back.
    """

    automaton: HybridAutomaton
    geometry: tuple[DirectFinding, ...]
    reading: tuple[DirectFinding, ...]
    seen: tuple[Track, ...]
    measured: tuple[Track, ...]
    beyond: tuple[Beyond, ...]
    searches: tuple[Search, ...]
    beside: tuple[Beside, ...]
    is_readable: bool
    late: int

    @property
    def direct(self) -> tuple[DirectFinding, ...]:
        """Effects that are told without any motion model."""
        return (*self.geometry, *self.reading)

    @cached_property
    def left(self) -> tuple[tuple[Search, Leftover | None], ...]:
        """What the innovations of each coordinate follow; None where rows are too few."""
        return tuple((search, search.left_by(search.nominal)) for search in self.searches)

    @property
    def is_noise(self) -> bool | None:
        """Whether the model leaves noise alone; None where that cannot be told without looking for effects."""
        if self.direct or self.beside:
            return False
        left = [own for _, own in self.left]
        if any(own is not None and own.is_more for own in left):
            return False
        return True if left and all(own is not None and own.is_noise for own in left) else None


def examined(automaton: HybridAutomaton, recording: Recording) -> Examined:
    """Look at a recording with actions.

    Raises:
        InputError: if the recording has other parts than the model.
    """
    every, late = read_tracks(automaton, recording)
    seen = tuple(map(at_measurements, every))
    geometry, read = geometry_findings(automaton, seen), reading_findings(automaton, seen)
    corrected = with_effect(automaton, *(found.effect for found in (*geometry, *read)))
    measured = tuple(track for track in read_tracks(corrected, recording)[0] if len(track.time) > 1)
    beyond = beyond_range(corrected, [at_measurements(track).x for track in measured]) if measured else ()
    told, corrected = corrected, opened(corrected, beyond)
    able = lanes(corrected, measured, told) if measured and _has_own_inputs(corrected) else ()
    return Examined(
        automaton=corrected,
        geometry=geometry,
        reading=read,
        seen=seen,
        measured=measured,
        beyond=beyond,
        searches=tuple(Search(lane) for lane in able if lane.counted.any()),
        beside=lying_beside(corrected, tuple(map(at_measurements, measured))) if measured else (),
        is_readable=bool(able),
        late=late,
    )


def _has_own_inputs(automaton: HybridAutomaton) -> bool:
    """Whether each coordinate has an input of its own: what a hand holds moves otherwise, and is not judged."""
    if automaton.n != automaton.m:
        return False
    others = ~np.eye(automaton.n, dtype=bool)
    return not any(np.any(np.asarray(mode.B)[others]) for mode in automaton.modes)
