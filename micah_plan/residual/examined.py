"""A recording evaluated by the unmodified model: the basis of `predict`, and the starting point of `calibrate`.

The test uses innovations: errors of a filter's prediction of each row from all rows before it. Commands of a controller
depend on its measurements, so in closed loop the errors from one measured row to the next follow the commands even if
nothing is missing. Innovations of a correct model depend on nothing before them (Kailath, Sayed and Hassibi, "Linear
Estimation", ch. 9).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.recording.commands import command_meaning
from micah_plan.recording.value import Recording
from micah_plan.residual.compared_runs import at_measurements, read_tracks
from micah_plan.residual.coordinate_data import CoordinateData, coordinate_data_of
from micah_plan.residual.geometry import DirectFinding, OffJointError, geometry_findings, off_joint_errors
from micah_plan.residual.held_out import HeldOut
from micah_plan.residual.onsets import effects_with_onset
from micah_plan.residual.range_exceeded import RangeExceeded, ranges_exceeded, with_extended_range
from micah_plan.residual.residual_test import ResidualTest
from micah_plan.residual.sensor_bias import estimator_bias_findings


@dataclass(frozen=True, eq=False)
class Examined:
    """A recording evaluated before effects on the motion are sought.

    Attributes:
        automaton: with effects that poses and beliefs show directly, and with joints extended to where the recording
            goes.
        geometry, estimator_bias: the former and the latter.
        as_read, measured: tracks without and with these effects, of all runs and of runs with at least two rows.
        models: of every coordinate that moves; none for a model that is not one input per coordinate.
        off_joint_error: deviation of poses from the joints, also of joints that were corrected.
        is_readable: whether each coordinate has an input of its own, and some move.
        late: number of rows by which actions were stored too late; they were moved back.
    """

    automaton: HybridAutomaton
    geometry: tuple[DirectFinding, ...]
    estimator_bias: tuple[DirectFinding, ...]
    as_read: tuple[Track, ...]
    measured: tuple[Track, ...]
    exceeded: tuple[RangeExceeded, ...]
    models: tuple[HeldOut, ...]
    off_joint_error: tuple[OffJointError, ...]
    is_readable: bool
    late: int

    @property
    def direct(self) -> tuple[DirectFinding, ...]:
        """Effects identified without a motion model: geometry and sensor."""
        return (*self.geometry, *self.estimator_bias)

    @cached_property
    def innovation_tests(self) -> tuple[tuple[HeldOut, ResidualTest | None], ...]:
        """The innovation test of each coordinate; None where there are too few rows."""
        return tuple((model, model.innovation_test(model.nominal)) for model in self.models)

    @property
    def is_noise(self) -> bool | None:
        """Whether the model leaves only noise; None where only a search for effects could decide."""
        if self.direct or self.off_joint_error:
            return False
        tests = [test for _, test in self.innovation_tests]
        if any(test is not None and test.is_more for test in tests):
            return False
        return True if tests and all(test is not None and test.is_noise for test in tests) else None


def examined(automaton: HybridAutomaton, recording: Recording) -> Examined:
    """Evaluate the model on a recording with actions.

    Raises:
        InputError: if the recording has other parts than the model.
    """
    gates, (every, late) = effects_with_onset(automaton, recording), read_tracks(automaton, recording)
    is_at = tuple(map(at_measurements, every))
    geometry, read = geometry_findings(automaton, is_at), estimator_bias_findings(automaton, is_at)
    corrected = with_effect(automaton, *(finding.effect for finding in (*geometry, *read)))
    again = read_tracks(corrected, recording)[0] if geometry or read else every
    measured = tuple(track for track in again if len(track.time) > 1)
    exceeded = ranges_exceeded(corrected, [at_measurements(track).x for track in measured]) if measured else ()
    uncorrected, corrected = corrected, with_extended_range(corrected, exceeded)
    able = coordinate_data_of(corrected, measured, uncorrected) if measured and _has_own_inputs(corrected) else ()
    return Examined(
        automaton=corrected,
        geometry=geometry,
        estimator_bias=read,
        as_read=is_at,
        measured=measured,
        exceeded=exceeded,
        models=tuple(
            HeldOut(replace(as_begun(data, gates), meaning=command_meaning(recording)))
            for data in able
            if data.counted.any()
        ),
        off_joint_error=off_joint_errors(corrected, tuple(map(at_measurements, measured))) if measured else (),
        is_readable=bool(able),
        late=late,
    )


def as_begun(data: CoordinateData, gates: Collection[Effect]) -> CoordinateData:
    """The data with effects active from the start, except those whose onset is in this recording."""
    return replace(data, effects=tuple(e if e in gates else replace(e, since=None) for e in data.effects))


def _has_own_inputs(automaton: HybridAutomaton) -> bool:
    """Whether each coordinate has an input of its own; held objects do not, and are not tested."""
    if automaton.n != automaton.m:
        return False
    others = ~np.eye(automaton.n, dtype=bool)
    return not any(np.any(np.asarray(mode.B)[others]) for mode in automaton.modes)
