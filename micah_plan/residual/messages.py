"""Sentences of predictions and calibrations."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from micah_plan.message import message
from micah_plan.quantities import count, percent, plain, quantity

Verdict = Literal["none", "explained", "partly", "unexplained"]

VERDICTS: dict[Verdict, str] = {
    "none": "this recording shows nothing that the model lacks",
    "explained": "the effects explain what the model lacked",
    "partly": "the effects explain part of what the model lacks",
    "unexplained": "the model lacks something that no effect in the library explains",
}
"""Sentence of each verdict on a calibration."""

OUTCOMES: dict[str, str] = {
    "mode": "a mode is missing",
    "averaged": "the steps follow commands averaged over neighbouring rows, which blurs the effects",
    "averaged alone": "only noise remains, except that the steps follow commands averaged over neighbouring rows",
    "unnamed": "the residual follows something that no effect describes",
    "remembered": "in runs like these, the effect may also come from earlier commands",
    "longer": "held-out roll-outs get worse with it",
    "passing": "only one run shows that there is more, and no other run can confirm it",
    "more": "an unnamed correction on top of the effects predicts clearly better",
    "contradicted": "with so few runs, one is predicted worse by what the others show; record more runs",
    "single": "a single run with few motions shows it, and no other run can confirm it",
    "changing": "it changed more than once, abruptly or gradually, so it may keep changing",
    "noisier": "one-step predictions get worse with it, so what remains is more than sensor noise",
    "not white": "the residual is not noise, but no effect that improves roll-outs explains it",
    "named": "with the effects, only noise remains",
    "nothing": "only noise remains",
}
"""Sentence of each outcome for a coordinate."""


@message
def estimate_corrected(coordinate: str, unit: str, before: float, after: float) -> str:
    """The controller's estimate at the end of runs is off by mean amounts [unit], before and after the correction."""
    was, now = quantity(before, unit, digits=2), quantity(after, unit, digits=2)
    return (
        f"{coordinate}: at the end of runs the controller's estimate is off by {was}, by {now} with its sensor "
        "corrected"
    )


@message
def actions_stored_late(rows: int) -> str:
    """Actions are stored in later rows than the motions they cause."""
    late = count(rows, "row")
    return (
        f"the part moves {late} before its command: actions are stored {late} late. They were taken {late} earlier; "
        "store each action in the row of the pose that it starts from"
    )


@message
def gaps_in_time(gaps: int) -> str:
    """Rows are missing, with the commands in them."""
    return f"{count(gaps, 'gap')} in t: the commands in between are unknown, so steps across do not count"


@message
def rows_without_measurement(rows: int) -> str:
    """Rows that repeat a pose, or have one that the part cannot reach."""
    return f"{count(rows, 'row')} repeat a pose or are out of the part's reach, so they do not count as measurements"


@message
def gain_of_other_unit(coordinate: str, gain: float, unit: str) -> str:
    """A gain is that of commands in another unit than m."""
    return (
        f"{coordinate}: a gain of {plain(gain)} is that of commands in {unit}: actions must be in m; convert the "
        "columns ax, ay, az"
    )


@message
def parameter_at_bound(coordinate: str, effect: str, parameter: str) -> str:
    """A fitted parameter ended at its bound."""
    return f"{coordinate}: {parameter} of {effect} ended at its bound, which suggests another cause"


@message
def one_run(coordinate: str) -> str:
    """Only segments of one run could be held out."""
    return f"{coordinate}: only one run; segments of it were held out, so differences between runs are unknown"


@message
def one_direction(coordinate: str) -> str:
    """Commands in the other direction are missing."""
    return f"{coordinate}: nearly all commands go one way, so effects that depend on the direction cannot be seen"


@message
def averaged_commands(coordinate: str, reach: int) -> str:
    """The steps follow commands averaged over rows on both sides."""
    return (
        f"{coordinate}: the steps follow commands averaged over {count(reach, 'row')} before and after, as if the "
        "poses were smoothed or the commands logged with errors. No part knows later commands, so this is not added "
        "to the model; calibrate on poses as they were measured"
    )


@message
def detection_limit(coordinate: str, unit: str, step: float, share: float) -> str:
    """The smallest offset per step [unit], and share of each command, that would have been detected."""
    return (
        f"{coordinate}: {quantity(step, unit, digits=2)} more per step, or {percent(share)} of each command, would "
        "have been detected; smaller effects cannot be excluded"
    )


@message
def outside_range(coordinate: str) -> str:
    """All rows lie outside the model's range."""
    return f"{coordinate}: all rows lie outside the model's range: is this another object?"


@message
def effects_not_added(coordinate: str, effects: Sequence[str], outcome: str) -> str:
    """Effects that were found but not added, because of an outcome."""
    return f"{coordinate}: {' and '.join(effects)} was not added: {OUTCOMES[outcome]}"


@message
def smooth_correction_as_good(coordinate: str, closest: Sequence[str]) -> str:
    """An unnamed correction predicts as well as the best effects."""
    return f"{coordinate}: {' and '.join(closest)} came closest, but an unnamed smooth correction predicts as well"


@message
def unnamed_correction_kept(coordinate: str) -> str:
    """The model has an unnamed correction that no effect replaced."""
    return f"{coordinate}: the model already has an unnamed correction, which no effect has replaced"


@message
def residual_not_white(coordinate: str, share: float, regressors: str) -> str:
    """A share of the residual's variance depends on regressors."""
    return f"{coordinate}: the residual is not white: {percent(share, 0)} of its variance depends on {regressors}"


@message
def missing_mode(mode: str, evidence: float) -> str:
    """A mode that the model lacks, with its evidence over a gradual change [nats]."""
    return f"{mode} ({plain(evidence)} nats over any gradual change)"


@message
def no_effect_for(finding: str) -> str:
    """A finding that no effect describes."""
    return f"{finding}: no effect describes this"


@message
def effect_has_onset(effect: str, coordinate: str, onset: str) -> str:
    """How predictions and plans use an effect with an onset."""
    return (
        f"{effect} of {coordinate} began {onset}: in this recording predict uses it from there on; later recordings, "
        "plans and executions always use it"
    )


@message
def effect_refused(effect: str, coordinate: str, error: str) -> str:
    """With an effect the model could not predict its own recording."""
    return f"{effect} of {coordinate} was not added: with it the model refuses these runs ({error})"


@message
def runs_refused(error: str) -> str:
    """The new model cannot predict the recording."""
    return f"predict refuses these runs: {error}"


@message
def earlier_effects_questioned(effects: str) -> str:
    """The recording is likelier without effects of an earlier calibration."""
    return (
        f"this recording is likelier without {effects} from an earlier calibration; calibrate the model without it on "
        "all recordings together"
    )


@message
def earlier_effects_estimated_anew(effects: str) -> str:
    """Effects of an earlier calibration were replaced."""
    return f"{effects} from an earlier calibration was estimated again: this recording resolves what that one left open"


@message
def outlying_run(coordinate: str, unit: str, run: int, error: float, usual: float) -> str:
    """A run whose one-step error [unit] is far above the others'."""
    size, others = quantity(error, unit, digits=2), quantity(usual, unit, digits=2)
    return f"{coordinate}: run {run} is unlike the others: it misses by {size} per step, they by {others}"


@message
def lasting_change(coordinate: str, unit: str, run: int, error: float, usual: float) -> str:
    """A run from which on all runs deviate, with its one-step error and the others' [unit]."""
    return (
        f"{outlying_run(coordinate, unit, run, error, usual)}; it was left out. Something may have changed: record "
        "more runs like it to find out what"
    )


@message
def faulty_run(coordinate: str, unit: str, run: int, error: float, usual: float) -> str:
    """A single run that deviates, with its one-step error and the others' [unit]."""
    return (
        f"{outlying_run(coordinate, unit, run, error, usual)}; it was left out: was something in the way, or the "
        "tracker lost?"
    )


@message
def mode_of_its_own(
    coordinate: str, unit: str, low: float | None, high: float | None, gain: float, bias: float, modes: Sequence[str]
) -> str:
    """A range [unit] with another gain and bias, and the modes that the new model has for it."""
    ends = [] if low is None else [f"from {quantity(low, unit)} on"]
    ends += [] if high is None else [f"up to {quantity(high, unit)}"]
    moves = f"{percent(gain, 0)} of a command is carried out"
    if abs(bias) > 1e-3 * abs(gain):
        moves += f" and {quantity(bias, unit, digits=2)} added to each step"
    added = f"; the new model has it as {', '.join(modes)}" if modes else ""
    return f"{coordinate} has a mode that the model lacks {' '.join(ends)}: there {moves}{added}"


@message
def range_exceeded(coordinate: str, unit: str, reached: float, end: float, is_all: bool) -> str:
    """Rows beyond an end of the model's range [unit] that is no stop; `is_all`: all rows."""
    sentence = (
        f"{coordinate} was measured up to {quantity(reached, unit)}, beyond the model's range, which ends at "
        f"{quantity(end, unit)} without a stop"
    )
    return f"{sentence}; all rows lie there: is this another object?" if is_all else sentence


@message
def poses_off_joint(coordinate: str, position: float, rotation: float) -> str:
    """Poses are off their joint by root mean squares [m, rad]; sizes of 0 are not mentioned."""
    sizes = [(position, "m"), (rotation, "rad")]
    text = " and ".join(quantity(size, unit, digits=2, degrees=False) for size, unit in sizes if size > 0.0)
    return f"poses deviate from the joint of {coordinate} by {text}, depending on the configuration"


@message
def errors_are_noise() -> str:
    """The prediction errors are consistent with noise."""
    return f"the errors look like noise: {VERDICTS['none']}"


@message
def too_few_rows() -> str:
    """No test of the prediction errors is possible."""
    return "there are too few rows to tell errors from noise"


@message
def errors_not_noise(findings: Sequence[str]) -> str:
    """Findings that contradict noise."""
    return f"{'; '.join(findings)}. calibrate identifies what is missing"


@message
def errors_depend_on(regressors: Sequence[tuple[str, str]]) -> str:
    """(coordinate, regressors) of prediction errors that are not noise."""
    return f"the errors are not noise: {'; '.join(f'those of {name} depend on {what}' for name, what in regressors)}"


@message
def poses_ask_for(effects: Sequence[str]) -> str:
    """Effects that poses and readings show without a motion model."""
    return f"poses and readings show {', '.join(effects)}"


@message
def no_own_inputs() -> str:
    """The test needs an input for each coordinate."""
    return "errors are only tested for noise where each coordinate has its own input"


@message
def whiteness_inconclusive() -> str:
    """The test of the errors decides nothing."""
    return "the whiteness test is inconclusive: run calibrate"


@message
def separates(coordinate: str, pairs: Sequence[tuple[str, str, float]]) -> str:
    """(one, other, expected evidence [nats]) of the alternatives that an experiment separates."""
    text = "; ".join(f"{first} from {second} ({plain(nats, 2)} nats)" for first, second, nats in pairs)
    return f"separates for {coordinate}, with the evidence to expect: {text}"


@message
def vary_commands(first: str, second: str) -> str:
    """The experiment for two tied effects whose forms name none."""
    return f"vary the size and direction of the commands over the whole range, to separate {first} from {second}"


@message
def experiment_of_form(sentence: str) -> str:
    """The experiment that a form names for a pair of effects."""
    return sentence


@message
def start_elsewhere(effect: str) -> str:
    """The experiment where all runs make the same motion."""
    return f"start elsewhere, and stop on the way: if it is {effect}, only the place matters and not what came before"


@message
def vary_speed(range_of_motion: str) -> str:
    """The experiment where no effect explains the residual."""
    return f"repeat slow and fast motions in both directions over {range_of_motion}, with pauses in between"


@message
def record_mode(place: float, unit: str) -> str:
    """The experiment for a mode that the model lacks at a place [unit]."""
    return (
        f"record slow motion through {quantity(place, unit)} in both directions and learn the model again, with that "
        "mode: micah-plan learn RECORDING.csv -o MODEL.yaml"
    )


@message
def confirm_effects() -> str:
    """The experiment after effects were found."""
    return "repeat with commands of other sizes and directions, to confirm the effects"


@message
def larger_commands(rows: int, distance: float, unit: str) -> str:
    """The experiment where rows over a distance [unit] show nothing."""
    return (
        f"nothing was found in {count(rows, 'row')} over {quantity(distance, unit)}: larger commands with reversals "
        "and pauses at both ends would show smaller effects"
    )
