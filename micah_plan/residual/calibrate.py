"""Calibration: measured against predicted motion, the effects that the model lacks, and the model with them added."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from micah_plan.arrays import INTERVAL_STDS, Floats
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.commanded_places import as_commanded, without_superseded
from micah_plan.automaton.effects.memories import is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect, Since
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.message import Message
from micah_plan.quantities import interval, quantity
from micah_plan.recording.value import Recording
from micah_plan.residual import messages
from micah_plan.residual.added_modes import with_missing_modes
from micah_plan.residual.calibration import Calibration, FoundEffect, pose_sizes, size_of, spread_runs
from micah_plan.residual.calibration_notes import notes_on, notes_on_beliefs, notes_on_rows
from micah_plan.residual.candidates import GATES, TermCandidate
from micah_plan.residual.coordinate_data import MOST_ROWS, CoordinateData
from micah_plan.residual.earlier_effects import (
    estimated_effects,
    evidence_of,
    replaces,
    settles_a_tie,
    without_estimated,
)
from micah_plan.residual.examined import Examined, examined
from micah_plan.residual.faulty_runs import faulty_runs
from micah_plan.residual.geometry import DirectFinding, systematic_transverse_error, transverse_rms
from micah_plan.residual.likelihood import FEWEST_ROWS, TIE
from micah_plan.residual.messages import Verdict
from micah_plan.residual.onsets import with_onset_digest
from micah_plan.residual.prediction import predict_recording, refused
from micah_plan.residual.range_exceeded import RangeExceeded, with_range_ends, with_shifts, without_old_ends
from micah_plan.residual.trace import CoordinateFinding, CoordinateTrace, may_remember, trace
from micah_plan.residual.verdict import overall
from micah_plan.summaries import Progress

# Poses this far off the joints [m], and this share of the lever arm, are those of another object.
_FAR = 0.08
_FAR_SHARE = 0.25


def calibrate(automaton: HybridAutomaton, recording: Recording, progress: Progress | None = None) -> Calibration:
    """Calibrate a model on a recording of measured motion; runs that deviate from the others are set aside.

    Raises:
        InputError: if the recording has no actions, too few rows, or other parts than the model.
    """
    if not recording.has_actions:
        raise InputError(
            "expected actions, found no columns ax, ay, az",
            remedy="record the commanded displacements to calibrate a model",
        )
    calibration = _with_revised_effects(_calibrated(automaton, recording, progress), progress)
    faulty = faulty_runs(calibration.traces)
    if faulty:
        usual = recording.rows(~np.isin(recording.run, [run.run for run in faulty]))
        calibration = calibrate(automaton, usual, progress)
    verdicts: list[Verdict] = ["unexplained" for run in faulty if run.is_lasting]
    return replace(
        calibration,
        verdict=overall([calibration.verdict, *verdicts]),
        notes=(*(run.advice for run in faulty), *calibration.notes),
    )


def _with_revised_effects(kept: Calibration, progress: Progress | None) -> Calibration:
    """The calibration in which effects of an earlier calibration are replaced, if other effects are jointly likelier.

    Fewer effects are kept without a gain in evidence; an equal number must be ahead by the evidence that one more
    effect requires. Of two effects that the earlier recording left tied, the likelier one is used now.
    """
    automaton = kept.nominal
    earlier = estimated_effects(automaton)
    if not earlier or kept.verdict == "none":
        return kept
    revised = _calibrated(without_estimated(automaton), kept.recording, progress)
    gain = evidence_of([one.final for one in revised.traces]) - evidence_of([one.final for one in kept.traces])
    is_simpler = len(revised.automaton.effects) < len(kept.automaton.effects)
    found = [effect.effect for effect in revised.effects if effect.is_added]
    needed = -TIE if is_simpler else 0.0 if settles_a_tie(found, earlier) else kept.least
    if gain <= needed:
        return kept
    names = ", ".join(f"{effect.name} of {effect.coordinate}" for effect in earlier)
    if not replaces(found, earlier):
        return replace(kept, notes=(messages.earlier_effects_questioned(names), *kept.notes))
    note = messages.earlier_effects_estimated_anew(names)
    return replace(revised, nominal=automaton, reviewed=kept, before=kept.before, notes=(note, *revised.notes))


def _calibrated(automaton: HybridAutomaton, recording: Recording, progress: Progress | None) -> Calibration:
    """The calibration with all runs of a recording."""
    automaton = as_commanded(automaton, recording)
    examination = examined(automaton, recording)
    _check_usable(automaton, examination)
    corrected, able = examination.automaton, examination.models
    measured, exceeded = examination.measured, examination.exceeded
    traces = tuple(
        trace(search, _shared(progress, number, len(able)) if progress else None) for number, search in enumerate(able)
    )
    corrected, traces = with_missing_modes(corrected, traces, measured)
    effects = [_direct_effect(direct) for direct in examination.direct]
    effects += [effect for trace in traces for effect in _all_found(trace, exceeded)]
    effects.sort(key=lambda effect: -effect.evidence)
    to_add = [with_onset_digest(effect, recording) for effect in with_shifts(_to_add(traces), exceeded)]
    improved, refusing, why = _without_refused_effects(corrected, exceeded, to_add, recording)
    kept_out = [_effect_key(effect) for effect in refusing]
    effects = [
        replace(effect, is_added=False) if _effect_key(effect.effect) in kept_out else effect for effect in effects
    ]
    before, after = size_of(traces, is_final=False), size_of(traces, is_final=True)
    floors = [
        _together(floors_of_kind, traces)
        for floors_of_kind in zip(*((trace.floor, trace.rollout_floor) for trace in traces), strict=True)
    ]
    if examination.geometry:
        spread = spread_runs(recording, MOST_ROWS)
        before, after = (
            pose_sizes(predict_recording(model, recording, runs=spread))[0] for model in (automaton, improved)
        )
        across, arm = transverse_rms(corrected, measured)
        floors = [float(np.hypot(across, arm * floor)) for floor in floors]
    verdicts: list[Verdict] = [trace.outcome.verdict for trace in traces]
    verdicts += ["explained"] if examination.direct else []
    verdicts += ["unexplained"] if examination.off_joint_error else []
    return Calibration(
        automaton=improved,
        verdict=overall(verdicts),
        effects=tuple(effects),
        before=before,
        after=after,
        noise_floor=floors[0],
        rollout_floor=floors[1],
        unexplained_fraction=max(_off_joint_rms(examination), *(trace.unexplained_fraction for trace in traces)),
        traces=traces,
        notes=(
            *notes_on(traces),
            *(messages.no_effect_for(str(error)) for error in examination.off_joint_error),
            *(_note_on_since(item.effect) for item in effects if item.effect.since is not None and item.is_added),
            *(messages.effect_refused(effect.name, effect.coordinate, error) for effect, error in refusing.items()),
            *([messages.runs_refused(why)] if why else []),
            *notes_on_rows(exceeded, measured, examination.late),
            *notes_on_beliefs(corrected, examination.as_read, measured),
        ),
        experiment=_next_experiment(effects, traces),
        nominal=automaton,
        recording=recording,
    )


def _effect_key(effect: Effect) -> tuple[object, ...]:
    """Key of an effect that ignores its parameters: name, coordinate, modes and onset."""
    since = effect.since and (effect.since.run, effect.since.time)
    return effect.name, effect.coordinate, effect.modes, since


def _without_refused_effects(
    corrected: HybridAutomaton, exceeded: Sequence[RangeExceeded], added: Sequence[Effect], recording: Recording
) -> tuple[HybridAutomaton, dict[Effect, str], str]:
    """(new automaton, effects that it rejects with the reason, remaining error) so that it loads its own recording.

    The last value is the reason why the model refuses these runs even without effects; empty if it does not.
    """
    kept, refusing = list(added), dict[Effect, str]()

    def made(effects: Sequence[Effect]) -> HybridAutomaton:
        added = without_old_ends(effects, exceeded)
        return without_superseded(with_effect(with_range_ends(corrected, exceeded, effects), *added))

    why = refused(made(kept), recording)
    if not why or refused(made(()), recording):
        return made(kept), refusing, why
    while kept and why:
        without = {effect: [remaining for remaining in kept if remaining is not effect] for effect in kept}
        effect = next((effect for effect, rest in without.items() if not refused(made(rest), recording)), kept[-1])
        refusing[effect] = why
        kept = without[effect]
        why = refused(made(kept), recording)
    return made(kept), refusing, why


def _note_on_since(effect: Effect) -> Message:
    return messages.effect_has_onset(effect.name, effect.coordinate, began(effect.since))


def began(since: Since | None) -> str:
    """The onset in words."""
    if since is None:
        return "before"
    run = "each run" if since.run is None else f"run {since.run}"
    return f"with {run}" if since.time == 0.0 else f"{quantity(since.time, 's')} into {run}"


def _check_usable(automaton: HybridAutomaton, examination: Examined) -> None:
    if sum(len(track.time) for track in examination.measured) < FEWEST_ROWS:
        raise InputError(f"expected at least {FEWEST_ROWS} rows in runs of two or more", remedy="record a longer run")
    if not examination.models:
        if examination.is_readable:
            raise InputError("in no recorded row does the model's sensor see anything", remedy="check its noise")
        remedy = "take a model with a joint that moves; runs of what a hand holds are for predict"
        raise InputError("the model has no coordinates that move by inputs of their own", remedy=remedy)
    across, arm = (
        systematic_transverse_error(automaton, examination.as_read),
        transverse_rms(automaton, examination.as_read)[1],
    )
    if across > max(_FAR, _FAR_SHARE * arm):
        raise InputError(
            f"the measured poses do not fit the model: they are {quantity(across, 'm', digits=2)} off its joints",
            remedy="take the model that was learned from this object, or the base frame that it was learned in",
        )


def _off_joint_rms(examination: Examined) -> float:
    """Fraction (0 to 1) of the evidence for off-joint errors that the geometric effects found do not explain."""
    named, unnamed = (
        sum(finding.evidence for finding in findings)
        for findings in (examination.geometry, examination.off_joint_error)
    )
    return unnamed / (named + unnamed) if unnamed else 0.0


def _shared(progress: Progress, number: int, count: int) -> Progress:
    return lambda message, fraction: progress(message, (number + fraction) / count)


def _all_found(trace: CoordinateTrace, exceeded: Sequence[RangeExceeded]) -> list[FoundEffect]:
    effects = [_found(trace.data, finding, exceeded) for finding in trace.findings]
    return [effect_found for effect_found in effects if without_old_ends([effect_found.effect], exceeded)]


def _found(data: CoordinateData, finding: CoordinateFinding, exceeded: Sequence[RangeExceeded]) -> FoundEffect:
    (effect,) = with_shifts([effect_of(data, finding.part, finding.interval, finding.tied)], exceeded)
    effect_form, ends = form(effect.name), finding.interval[: len(effect.values)].copy()
    ends[0] += 0.0 if effect.name == finding.part.name else effect.values[0] - finding.part.starts[0, 0]
    return FoundEffect(
        effect=effect,
        units=tuple(parameter.unit_for(data.unit) for parameter in effect_form.parameters),
        interval=tuple((float(low), float(high)) for low, high in ends),
        evidence=finding.evidence,
        tied=finding.tied,
        derived=_in_seconds(effect, data.period),
        sentence=effect_form.sentence,
        source=effect_form.source,
        experiment=_experiment(data, finding),
        is_added=finding.is_added,
    )


def _in_seconds(effect: Effect, period: float) -> tuple[tuple[str, float], ...]:
    """(name, value [s]) of an effect's times that are in steps."""
    parameters, stated = form(effect.name).parameters, form(effect.name).stated(effect.parameters)
    names = {parameter.name for parameter in parameters if parameter.unit == "step" and parameter.name in stated}
    return tuple(
        ("seconds" if name == "steps" else f"{name}_seconds", value * period)
        for name, value in effect.parameters
        if name in names
    )


def _experiment(data: CoordinateData, finding: CoordinateFinding) -> str:
    """The experiment that would separate an effect from its alternatives; empty if there are none."""
    if finding.tied:
        first, second = finding.part.name, finding.tied[0]
        own = dict(form(first).experiments).get(second) or dict(form(second).experiments).get(first)
        return messages.experiment_of_form(own) if own else messages.vary_commands(first, second)
    return messages.start_elsewhere(finding.part.name) if may_remember(data, finding) else ""


def _direct_effect(direct: DirectFinding) -> FoundEffect:
    effect, std, evidence = direct.effect, direct.std, direct.evidence
    effect_form = form(effect.name)
    reach = INTERVAL_STDS
    interval = tuple((v - reach * s, v + reach * s) for v, s in zip(effect.values, std, strict=True))
    units = tuple(parameter.unit for parameter in effect_form.parameters)
    return FoundEffect(effect, units, interval, evidence, (), (), effect_form.sentence, effect_form.source, "")


def effect_of(
    data: CoordinateData, part: TermCandidate, interval: Floats | None = None, tied: tuple[str, ...] = ()
) -> Effect:
    """The effect of a fitted candidate, as the automaton takes it."""
    effect_form = part.term.form
    count = len(effect_form.parameters)
    values = [
        float(np.clip(value, parameter.lower, parameter.upper))
        for value, parameter in zip(part.starts[0, :count], effect_form.parameters, strict=True)
    ]
    pairs = tuple(zip([parameter.name for parameter in effect_form.parameters], values, strict=True))
    since = _since(data, part.starts[0])
    ends = () if interval is None else interval[:count]
    spread = tuple(float(high - low) / (2.0 * INTERVAL_STDS) if high > low else 0.0 for low, high in ends)
    return Effect(effect_form.name, data.coordinate, pairs, spread, part.term.modes, since=since, tied=tied)


def _since(data: CoordinateData, values: Floats) -> Since | None:
    order, time = values[-GATES:]
    if np.isfinite(time):
        return Since(float(time))
    if not np.isfinite(order):
        return None
    later = np.argwhere(data.counted_starts & (data.order >= order))
    s, t = later[np.argmin(data.order[later[:, 0], later[:, 1]])]
    return Since(float(data.time[s, t]), int(data.run[s]))


def _to_add(traces: Sequence[CoordinateTrace]) -> list[Effect]:
    effects = []
    for traced in traces:
        by_part = {_term_key(finding.part): finding for finding in traced.findings}
        for part in traced.final.parts:
            finding = by_part.get(_term_key(part))
            # With a correction on top the parameters are those that were fitted together with it.
            part_kept = finding.part if finding is not None and traced.final is traced.chosen else part
            interval, tied = (None, ()) if finding is None else (finding.interval, finding.tied)
            effects.append(effect_of(traced.data, part_kept, interval, tied))
    return [effect for effect in effects if not is_as_commanded(effect)]  # that the model has already


def _term_key(part: TermCandidate) -> tuple[object, ...]:
    """Key of a term: name, modes and gates."""
    return part.name, part.term.modes, *part.starts[0, -GATES:].tolist()


def _together(sizes: Sequence[float], traces: Sequence[CoordinateTrace]) -> float:
    """Root mean square of coordinates' errors, weighted by their rows."""
    rows = [int(trace.data.counted.sum()) for trace in traces]
    return float(np.sqrt(np.average(np.square(sizes), weights=rows)))


def _next_experiment(effects: Sequence[FoundEffect], traces: Sequence[CoordinateTrace]) -> str:
    for effect in effects:
        if effect.experiment:
            return effect.experiment
    for traced in traces:
        for mode in traced.missing_modes:
            if mode.modes:
                continue
            return messages.record_mode(mode.low if np.isfinite(mode.low) else mode.high, mode.unit)
        if traced.outcome.verdict in ("partly", "unexplained"):
            low, high = traced.data.visited
            return messages.vary_speed(interval(low, high, traced.data.unit))
    if effects:
        return messages.confirm_effects()
    data = traces[0].data
    low, high = data.visited
    return messages.larger_commands(data.rows, high - low, data.unit)
