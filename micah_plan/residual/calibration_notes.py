"""Notes on a calibration: limits of its conclusions, one sentence each."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.quantities import count, percent, plain, quantity
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


def notes_on_beliefs(corrected: HybridAutomaton, before: Sequence[Track], after: Sequence[Track]) -> list[str]:
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
        was, now = (quantity(end, coordinate.unit, digits=2) for end in ends)
        notes.append(
            f"{coordinate.name}: runs ended {was} beside what the controller believed, {now} with its sensor corrected"
        )
    return notes


def note_on_late_actions(late: int) -> str:
    """Note that actions are stored in later rows than the motions they cause."""
    rows = count(late, "row")
    return (
        f"the part moves {rows} before its command: actions are stored {rows} late. They were taken {rows} earlier; "
        "store the action of a row with the pose that it starts from"
    )


def notes_on_rows(exceeded: Sequence[RangeExceeded], measured: Sequence[Track], late: int) -> list[str]:
    """Notes on rows beyond the range, on gaps and repeated poses, and on actions stored late."""
    missing = sum(len(sections(track.time)) - 1 for track in measured)
    gaps = f"{count(missing, 'gap')} in t: what was commanded there is missing, so no step over them counts"
    unseen = sum(int((~track.is_measured).sum()) for track in measured)
    repeated = f"{count(unseen, 'row')} repeat a pose or lie where the part cannot get: they are no measurements"
    notes = [*([note_on_late_actions(late)] if late else []), *map(str, exceeded)]
    return [*notes, *([gaps] if missing else []), *([repeated] if unseen else [])]


def _units(trace: CoordinateTrace) -> list[str]:
    """Notes on gains that indicate units of the commands instead of a property of the object."""
    names = {name: size for name, (size, unit) in _UNITS.items() if unit in ("", trace.data.unit)}
    notes = []
    for finding in trace.findings:
        gain = _gain_of(finding)
        for name, size in names.items():
            if abs(gain / size - 1.0) < _SAME_UNIT:
                sentence = f"{trace.data.coordinate}: a gain of {plain(gain)} is that of commands in {name}"
                notes.append(f"{sentence}: actions are in m; convert the columns ax, ay, az")
    return notes


def _gain_of(finding: CoordinateFinding) -> float:
    """The gain of commands under an effect; 1 if it has none."""
    names = [parameter.name for parameter in finding.part.term.form.parameters]
    return float(finding.part.starts[0, names.index("gain")]) if "gain" in names else 1.0


def _at_bounds(trace: CoordinateTrace) -> list[str]:
    """Notes on fitted parameters that ended at a bound, which suggests another cause."""
    notes = []
    for finding in trace.findings:
        parameters = finding.part.term.form.parameters
        for k, large in zip(finding.part.free, finding.part.scale, strict=True):
            low, high = finding.part.bounds.get(k, (-np.inf, np.inf))
            value, parameter = float(finding.part.starts[0, k]), parameters[k]
            ends = max(parameter.lower, low), min(parameter.upper, high)
            if min(abs(value - end) for end in ends) < _AT_BOUND * large and value != parameter.neutral:
                sentence = f"{trace.data.coordinate}: {parameter.name} of {finding.part.name} ended at its bound"
                notes.append(f"{sentence}, so something else may be behind it")
    return notes


def notes_on(traces: Sequence[CoordinateTrace]) -> tuple[str, ...]:
    """Notes per coordinate: insufficient excitation, omitted effects, and structure left in the residuals."""
    notes = []
    for traced in traces:
        notes += [*_units(traced), *_at_bounds(traced)]
        data, name = traced.data, traced.data.coordinate
        runs = len(np.unique(data.run))
        if runs == 1:
            notes.append(f"{name}: one run only; segments were held out, so what differs from run to run is unknown")
        u = data.u[data.counted_starts]
        moving = u[np.abs(u) > 0.05 * data.command_size]
        if moving.size and (np.mean(moving > 0) < 0.05 or np.mean(moving > 0) > 0.95):
            notes.append(f"{name}: nearly all commands go one way; what depends on the direction cannot be seen")
        if traced.average is not None:
            notes.append(
                f"{name}: steps follow averages of the commands over {count(traced.average.reach, 'row')} before and "
                "after, as where poses were smoothed, or commands written down with errors: no part knows commands to "
                "come, so none of it is added. Calibrate on poses as they were measured"
            )
        if traced.outcome.verdict == "none":
            innovations = traced.held_out.errors(traced.nominal, "filter")[data.counted]
            nats = traced.held_out.competition.least
            least = float(np.sqrt(2.0 * nats * np.sum(innovations**2))) / len(innovations)
            step, share = quantity(least, data.unit, digits=2), percent(least / data.command_size)
            notes.append(
                f"{name}: {step} more per step, or {share} more of each command would have been seen; smaller effects "
                "are not excluded"
            )
        low, high = data.visited
        if low > data.upper or high < data.lower:
            notes.append(f"{name}: all rows lie outside of the model's range: this may be another object")
        notes += [f"{mode} ({plain(mode.evidence)} nats over any gradual change)" for mode in traced.missing_modes]
        left_out = " and ".join(finding.part.name for finding in traced.findings if not finding.is_added)
        if left_out:
            notes.append(f"{name}: {left_out} was not added: {traced.outcome.sentence}")
        if traced.closest:
            notes.append(
                f"{name}: {' and '.join(traced.closest)} came closest, but a smooth correction without a name does "
                "as well"
            )
        if traced.facts.is_corrected:
            notes.append(f"{name}: the model has a correction without a name already, which no effect has replaced")
        left = traced.innovation_test
        if left is not None and left.is_more and not traced.facts.smooth and traced.average is None:
            share = percent(left.share, 0)
            notes.append(f"{name}: the residuals are not white: {share} of their variance follows {left}")
    return tuple(notes)
