"""Missing modes: the mode in which each lies is split, and the search is repeated in the halves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.split import with_split
from micah_plan.automaton.tracks import Track
from micah_plan.residual.coordinate_data import coordinate_data_of
from micah_plan.residual.held_out import HeldOut
from micah_plan.residual.likelihood import LEAST_EVIDENCE
from micah_plan.residual.missing_mode import MissingMode
from micah_plan.residual.trace import A_LINE, CoordinateTrace, trace


def with_missing_modes(
    automaton: HybridAutomaton, traces: tuple[CoordinateTrace, ...], measured: Sequence[Track]
) -> tuple[HybridAutomaton, tuple[CoordinateTrace, ...]]:
    """(automaton with the missing modes of the traces, traces on it), if the split is unambiguous.

    They are added if a gain or a bias in the new modes alone (the effects by which they were found) predicts held-out
    rows no worse than the unnamed correction that would take their place. Otherwise automaton and effects are returned
    unchanged.
    """
    split = automaton
    for one in traces:
        low, high = range_of(automaton, one.data.index)
        ends = {end for mode in one.missing_modes for end in (mode.low, mode.high)}
        for place in sorted(end for end in ends if low < end < high):
            split = with_split(split, one.data.index, place)
    if split is automaton:
        return automaton, traces
    again = tuple(trace(HeldOut(data)) for data in coordinate_data_of(split, tuple(measured)))
    if not all(_is_clear(old, new) for old, new in zip(traces, again, strict=True)):
        return automaton, traces
    return split, tuple(_with_names_of_modes(split, old, new) for old, new in zip(traces, again, strict=True))


def _is_clear(old: CoordinateTrace, new: CoordinateTrace) -> bool:
    if not old.missing_modes:
        return True
    parts = new.chosen.parts
    is_inside = bool(parts) and all(part.term.modes and part.name in A_LINE for part in parts)
    return is_inside and not new.missing_modes and new.final.evidence > old.final.evidence - LEAST_EVIDENCE


def _with_names_of_modes(split: HybridAutomaton, old: CoordinateTrace, new: CoordinateTrace) -> CoordinateTrace:
    """The trace of the split model with the names of its new modes, as found before the split."""
    modes = tuple(
        replace(missing_mode, modes=_inside(split, old.data.index, missing_mode)) for missing_mode in old.missing_modes
    )
    return replace(new, missing_modes=modes)


def _inside(split: HybridAutomaton, i: int, missing: MissingMode) -> tuple[str, ...]:
    """Names of the modes that move a coordinate within the range of a missing one."""

    def holds(mode: Mode) -> bool:
        low, high = range_of(replace(split, modes=(mode,)), i)
        return low < high and low >= missing.low and high <= missing.high

    return tuple(mode.name for mode in split.modes if mode.driven[i] and holds(mode))
