"""A missing mode taken into the automaton: the mode that it lies in is cut, and the search made again in the halves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from micah_plan.automaton.effects.ends import range_of
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.split import with_split
from micah_plan.automaton.tracks import Track
from micah_plan.residual.growth import LEAST_EVIDENCE
from micah_plan.residual.lane import lanes
from micah_plan.residual.missing_mode import MissingMode
from micah_plan.residual.search import Search
from micah_plan.residual.trace import LaneTrace, trace

# A piece between changepoints is a line in the command.
_AS_FOUND = ("gain", "bias")


def with_missing_modes(
    automaton: HybridAutomaton, traces: tuple[LaneTrace, ...], measured: Sequence[Track]
) -> tuple[HybridAutomaton, tuple[LaneTrace, ...]]:
    """The automaton with the modes that traces miss, and the traces on it, if that is clear.

    It is if a gain or a bias in the new modes alone, which is how they were found, predicts held-out rows no worse than
    the correction without a name that would stand in their place. Else both are as given.
    """
    split = automaton
    for one in traces:
        low, high = range_of(automaton, one.lane.index)
        ends = {end for mode in one.missing_modes for end in (mode.low, mode.high)}
        for place in sorted(end for end in ends if low < end < high):
            split = with_split(split, one.lane.index, place)
    if split is automaton:
        return automaton, traces
    again = tuple(trace(Search(lane)) for lane in lanes(split, tuple(measured)))
    if not all(_is_clear(old, new) for old, new in zip(traces, again, strict=True)):
        return automaton, traces
    return split, tuple(_told(split, old, new) for old, new in zip(traces, again, strict=True))


def _is_clear(old: LaneTrace, new: LaneTrace) -> bool:
    if not old.missing_modes:
        return True
    parts = new.chosen.parts
    is_inside = bool(parts) and all(part.term.modes and part.name in _AS_FOUND for part in parts)
    return is_inside and not new.missing_modes and new.final.density.sum() > old.final.density.sum() - LEAST_EVIDENCE


def _told(split: HybridAutomaton, old: LaneTrace, new: LaneTrace) -> LaneTrace:
    modes = tuple(replace(one, modes=_inside(split, old.lane.index, one)) for one in old.missing_modes)
    return replace(new, missing_modes=modes)


def _inside(split: HybridAutomaton, i: int, missing: MissingMode) -> tuple[str, ...]:
    """Names of the modes that move a coordinate within the range of a missing one."""

    def holds(mode: Mode) -> bool:
        low, high = range_of(replace(split, modes=(mode,)), i)
        return low < high and low >= missing.low and high <= missing.high

    return tuple(mode.name for mode in split.modes if mode.driven[i] and holds(mode))
