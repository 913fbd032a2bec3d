"""Notes on a calibration: limits of its conclusions, one sentence each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.message import Message
from micah_plan.residual import messages
from micah_plan.residual.compared_runs import sections
from micah_plan.residual.range_exceeded import RangeExceeded
from micah_plan.residual.trace import CoordinateFinding, CoordinateTrace

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


def notes_on_beliefs(corrected: HybridAutomaton, before: Sequence[Track], after: Sequence[Track]) -> list[Message]:
    """Notes on the final error of the controller's estimate, before and after correcting its sensor."""
    if not any(track.is_outside for track in after):
        return []
    notes = []
    for i, coordinate in enumerate(corrected.coordinates):
        ends = [
            float(
                np.mean([abs(track.believed[-1, i] - track.x[-1, i]) for track in value if track.believed is not None])
            )
            for value in (before, after)
        ]
        notes.append(messages.estimate_corrected(coordinate.name, coordinate.unit, *ends))
    return notes


def notes_on_rows(exceeded: Sequence[RangeExceeded], measured: Sequence[Track], late: int) -> list[Message]:
    """Notes on rows beyond the range, on gaps and repeated poses, and on actions stored late."""
    gaps = sum(len(sections(track.time)) - 1 for track in measured)
    unmeasured = sum(int((~track.is_measured).sum()) for track in measured)
    notes = [messages.actions_stored_late(late)] if late else []
    notes += [excess.message for excess in exceeded]
    notes += [messages.gaps_in_time(gaps)] if gaps else []
    return notes + ([messages.rows_without_measurement(unmeasured)] if unmeasured else [])


def _units(trace: CoordinateTrace) -> list[Message]:
    """Notes on gains that indicate units of the commands instead of a property of the object."""
    names = {name: size for name, (size, unit) in _UNITS.items() if unit in ("", trace.data.unit)}
    notes = []
    for finding in trace.findings:
        gain = _gain_of(finding)
        for name, size in names.items():
            if abs(gain / size - 1.0) < _SAME_UNIT:
                notes.append(messages.gain_of_other_unit(trace.data.coordinate, gain, name))
    return notes


def _gain_of(finding: CoordinateFinding) -> float:
    """The gain of commands under an effect; 1 if it has none."""
    names = [parameter.name for parameter in finding.part.term.form.parameters]
    return float(finding.part.starts[0, names.index("gain")]) if "gain" in names else 1.0


def _at_bounds(trace: CoordinateTrace) -> list[Message]:
    """Notes on fitted parameters that ended at a bound, which suggests another cause."""
    notes = []
    for finding in trace.findings:
        parameters = finding.part.term.form.parameters
        for k, large in zip(finding.part.free, finding.part.scale, strict=True):
            low, high = finding.part.bounds.get(k, (-np.inf, np.inf))
            value, parameter = float(finding.part.starts[0, k]), parameters[k]
            ends = max(parameter.lower, low), min(parameter.upper, high)
            if min(abs(value - end) for end in ends) < _AT_BOUND * large and value != parameter.neutral:
                notes.append(messages.parameter_at_bound(trace.data.coordinate, finding.part.name, parameter.name))
    return notes


def notes_on(traces: Sequence[CoordinateTrace]) -> tuple[Message, ...]:
    """Notes per coordinate: insufficient excitation, omitted effects, and structure left in the residuals."""
    notes = list[Message]()
    for traced in traces:
        notes += [*_units(traced), *_at_bounds(traced), *_excitation(traced), *_left_out(traced)]
        left = traced.innovation_test
        if left is not None and left.is_more and not traced.facts.smooth and traced.average is None:
            notes.append(messages.residual_not_white(traced.data.coordinate, left.share, str(left)))
    return tuple(notes)


def _excitation(traced: CoordinateTrace) -> list[Message]:
    """Notes on what the recording of a coordinate cannot show."""
    notes = list[Message]()
    data, name = traced.data, traced.data.coordinate
    if len(np.unique(data.run)) == 1:
        notes.append(messages.one_run(name))
    u = data.u[data.counted_starts]
    moving = u[np.abs(u) > 0.05 * data.command_size]
    if moving.size and (np.mean(moving > 0) < 0.05 or np.mean(moving > 0) > 0.95):
        notes.append(messages.one_direction(name))
    if traced.average is not None:
        notes.append(messages.averaged_commands(name, traced.average.reach))
    if traced.outcome.verdict == "none":
        innovations = traced.held_out.errors(traced.nominal, "filter")[data.counted]
        nats = traced.held_out.competition.least
        least = float(np.sqrt(2.0 * nats * np.sum(innovations**2))) / len(innovations)
        notes.append(messages.detection_limit(name, data.unit, least, least / data.command_size))
    low, high = data.visited
    if low > data.upper or high < data.lower:
        notes.append(messages.outside_range(name))
    return notes


def _left_out(traced: CoordinateTrace) -> list[Message]:
    """Notes on modes and effects that a coordinate's model lacks still."""
    name = traced.data.coordinate
    notes = [messages.missing_mode(str(mode), mode.evidence) for mode in traced.missing_modes]
    not_added = [finding.part.name for finding in traced.findings if not finding.is_added]
    if not_added:
        notes.append(messages.effects_not_added(name, not_added, traced.outcome.name))
    if traced.closest:
        notes.append(messages.smooth_correction_as_good(name, traced.closest))
    if traced.facts.is_corrected:
        notes.append(messages.unnamed_correction_kept(name))
    return notes
