"""What can and cannot be concluded from a calibration, one sentence each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.quantities import count, percent, plain, quantity
from micah_plan.residual.growth import LEAST_EVIDENCE
from micah_plan.residual.lane import ENOUGH_RUNS
from micah_plan.residual.seen import Beyond, sections
from micah_plan.residual.trace import Finding, LaneTrace

# Gains of commands that are written in other units than m, and the coordinates that may have them.
_UNITS = {
    "millimetres": (1e-3, ""),
    "centimetres": (1e-2, ""),
    "inches": (0.0254, ""),
    "degrees": (np.pi / 180.0, "rad"),
}
_SAME_UNIT = 0.1
# Share of what is large for a parameter within which it is at a bound.
_AT_BOUND = 1e-3


def told_of_beliefs(corrected: HybridAutomaton, before: Sequence[Track], after: Sequence[Track]) -> list[str]:
    """By how much the controller's belief was beside what was measured, where effects of its sensor change that."""
    if not any(track.is_outside for track in after):
        return []
    notes = []
    for i, coordinate in enumerate(corrected.coordinates):
        ends = [
            float(np.mean([abs(track.believed[-1, i] - track.x[-1, i]) for track in own if track.believed is not None]))
            for own in (before, after)
        ]
        was, now = (quantity(end, coordinate.unit, digits=2) for end in ends)
        notes.append(
            f"{coordinate.name}: runs ended {was} beside what the controller believed, {now} with its sensor corrected"
        )
    return notes


def told_of_late(late: int) -> str:
    """That actions are stored in later rows than those that they move."""
    rows = count(late, "row")
    return (
        f"the part moves {rows} before its command: actions are stored {rows} late. They were taken {rows} earlier; "
        "store the action of a row with the pose that it starts from"
    )


def told_of_rows(beyond: Sequence[Beyond], measured: Sequence[Track], late: int) -> list[str]:
    """What rows lie beyond the range, that others are missing or no measurements, and where actions were stored."""
    missing = sum(len(sections(track.time)) - 1 for track in measured)
    gaps = f"{count(missing, 'gap')} in t: what was commanded there is missing, so no step over them counts"
    unseen = sum(int((~track.is_measured).sum()) for track in measured)
    repeated = f"{count(unseen, 'row')} repeat a pose or lie where the part cannot get: they are no measurements"
    told = [*([told_of_late(late)] if late else []), *map(str, beyond)]
    return [*told, *([gaps] if missing else []), *([repeated] if unseen else [])]


def _units(one: LaneTrace) -> list[str]:
    """Gains that are no property of an object, but of the units that commands were written in."""
    names = {name: size for name, (size, unit) in _UNITS.items() if unit in ("", one.lane.unit)}
    notes = []
    for finding in one.findings:
        gain = _gain_of(finding)
        for name, size in names.items():
            if abs(gain / size - 1.0) < _SAME_UNIT:
                told = f"{one.lane.coordinate}: a gain of {plain(gain)} is that of commands in {name}"
                notes.append(f"{told}: actions are in m; convert the columns ax, ay, az")
    return notes


def _gain_of(finding: Finding) -> float:
    """The gain that an effect gives commands; 1 if it has none."""
    names = [parameter.name for parameter in finding.part.term.form.parameters]
    return float(finding.part.starts[0, names.index("gain")]) if "gain" in names else 1.0


def _at_bounds(one: LaneTrace) -> list[str]:
    """Fitted parameters that ended at a bound of what is sensible: something else may be behind the effect."""
    notes = []
    for finding in one.findings:
        parameters = finding.part.term.form.parameters
        for k, large in zip(finding.part.free, finding.part.scale, strict=True):
            low, high = finding.part.bounds.get(k, (-np.inf, np.inf))
            value, own = float(finding.part.starts[0, k]), parameters[k]
            ends = max(own.lower, low), min(own.upper, high)
            if min(abs(value - end) for end in ends) < _AT_BOUND * large and value != own.neutral:
                told = f"{one.lane.coordinate}: {own.name} of {finding.part.name} ended at its bound"
                notes.append(f"{told}, so something else may be behind it")
    return notes


def notes_on(traces: Sequence[LaneTrace]) -> tuple[str, ...]:
    """What was seen too little of, what was left out and why, and what remains."""
    notes = []
    for one in traces:
        notes += [*_units(one), *_at_bounds(one)]
        lane, name = one.lane, one.lane.coordinate
        runs = len(np.unique(lane.run))
        if runs < ENOUGH_RUNS:
            which = "one run" if runs == 1 else f"{runs} runs"
            notes.append(f"{name}: {which} only; stretches were held out, so what differs from run to run is unknown")
        u = lane.u[lane.counted_starts]
        moving = u[np.abs(u) > 0.05 * lane.command_size]
        if moving.size and (np.mean(moving > 0) < 0.05 or np.mean(moving > 0) > 0.95):
            notes.append(f"{name}: nearly all commands go one way; what depends on the direction cannot be seen")
        if one.outcome.verdict == "none":
            least = float(np.sqrt(2.0 * LEAST_EVIDENCE * one.nominal.squared)) / int(lane.counted.sum())
            step, share = quantity(least, lane.unit, digits=2), percent(least / lane.command_size)
            notes.append(
                f"{name}: {step} more per step, or {share} more of each command would have been seen; smaller effects "
                "are not excluded"
            )
        low, high = lane.visited
        if low > lane.upper or high < lane.lower:
            notes.append(f"{name}: all rows lie outside of the model's range: this may be another object")
        notes += [f"{mode} ({plain(mode.evidence)} nats over any gradual change)" for mode in one.missing_modes]
        left_out = " and ".join(finding.part.name for finding in one.findings if not finding.is_added)
        if left_out:
            notes.append(f"{name}: {left_out} was not added: {one.outcome.sentence}")
        if one.closest:
            notes.append(
                f"{name}: {' and '.join(one.closest)} came closest, but a smooth correction without a name does as well"
            )
        if one.facts.is_corrected:
            notes.append(f"{name}: the model has a correction without a name already, which no effect has replaced")
        if one.left is not None and one.left.is_more and not one.facts.smooth:
            share = percent(one.left.share, 0)
            notes.append(f"{name}: what remains is no noise: {share} of it follows {one.left}")
    return tuple(notes)
