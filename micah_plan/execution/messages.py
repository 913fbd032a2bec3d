"""Sentences of executions and of the test of plants."""

from __future__ import annotations

from collections.abc import Sequence

from micah_plan.message import Message, codes_of, message
from micah_plan.quantities import count, percent, quantity, with_spread

STEPS_CONTRADICT = "; its steps were not as modelled: calibrate the model with this run"
POSES_CONTRADICT = "; what was measured is not where the model has it: calibrate the model with this run"


# Why an execution ended


@message
def stopped_confident(confidence: float) -> str:
    """The goal is believed reached."""
    return f"stopped with {percent(confidence)} probability of the goal"


@message
def stopped_by_watch(steps: int, failure: str, advice: str) -> str:
    """The measurements do not fit the model."""
    return f"stopped after {count(steps, 'step')}: {failure}{advice}"


@message
def off_plan(steps: int, mode: str, requests: int, advice: str) -> str:
    """The belief left the plan and no new plan was accepted."""
    return (
        f"stopped after {count(steps, 'step')}, believed to be in mode {mode}: off the plan after {requests} requests "
        f"for a new one{advice}"
    )


@message
def steps_used_up(steps: int, confidence: float, advice: str) -> str:
    """The steps ended before the goal was reached."""
    return f"the {count(steps, 'allowed step')} ended with {percent(confidence)} probability of the goal{advice}"


@message
def machine_failed(step: int, failure: str) -> str:
    """The machine failed during a step."""
    return f"the machine failed in step {step}: {failure}"


def with_misses(ending: Message, misses: Sequence[str]) -> Message:
    """A reason with what was missed; the codes of that are its value `missed`."""
    if not misses:
        return ending
    sentence = f"{ending}, but {' and '.join(misses)}"
    return Message(sentence, ending.code, {**ending.values, "missed": tuple(codes_of(misses))})


def refused_plans(refusals: Sequence[str]) -> str:
    """End of the reason of an execution whose new plans were refused."""
    number = "a new plan was" if len(refusals) == 1 else f"{len(refusals)} new plans were"
    return f"; {number} refused{', the last' if refusals[1:] else ''} because {refusals[-1]}"


@message
def arm_cannot_follow(failure: str) -> str:
    """A new plan that the arm cannot follow."""
    return f"the arm cannot follow: {failure}"


# What was missed


@message
def not_felt() -> str:
    """The object was lowered without contact."""
    return "no contact was felt on the way down, so it was not released"


@message
def does_not_stand() -> str:
    """The released object moves on."""
    return "it does not stand on its own"


@message
def misses_target(name: str, distance: float, tolerance: float, unit: str, is_true: bool) -> str:
    """A coordinate away from its target, truly or as believed."""
    is_ = "is" if is_true else "is believed"
    return f"{name} {is_} {quantity(distance, unit)} from its target (tolerance {quantity(tolerance, unit)})"


@message
def in_other_mode(mode: str, modes: Sequence[str], is_true: bool) -> str:
    """A mode that is not of the goal."""
    return f"the {'true' if is_true else 'believed'} mode is {mode}, not {' or '.join(modes)}"


# Measurements that contradict the model


@message
def contradicted_in_a_row(looks: int) -> str:
    """Consecutive measurements that the belief excludes."""
    return f"{count(looks, 'measurement')} in a row contradict the model"


@message
def contradicted(measurements: int) -> str:
    """Measurements that the belief excludes, in all."""
    return f"{count(measurements, 'measurement')} contradict the model"


@message
def nothing_seen(steps: int) -> str:
    """Nothing was measured."""
    return f"nothing was seen for {count(steps, 'step')}"


# Incidents in simulation


@message
def hit(what: str, obstacle: str, time: float, force: float, depth: float) -> str:
    """A collision [s, N, m]."""
    how = f"with {quantity(force, 'N')}, {quantity(depth, 'm')} deep"
    return f"{what} hit '{obstacle}' at {quantity(time, 's')} {how}"


@message
def knocked_over(body: str, time: float, shift: float, tilt: float) -> str:
    """A loose body that no longer stands as before [s, m, rad]."""
    how = f"it had moved by {quantity(shift, 'm')} and tilted by {quantity(tilt, 'rad')}"
    return f"'{body}' was knocked over: at {quantity(time, 's')} {how}"


@message
def tool_behind(distance: float, joints: Sequence[str]) -> str:
    """An arm that does not get to a commanded place [m]; joints at their limits."""
    limit = f": joint limit of {', '.join(joints)}" if joints else ""
    return f"the arm's tool could get no nearer than {quantity(distance, 'm')} to where it was commanded{limit}"


# Faults of plants under test


@message
def clock_not_from_reset(time: float) -> str:
    """The first measurement's time [s] is late."""
    return f"time must count from the reset. Got {time:.9g} s in the first measurement"


@message
def part_off_joint(part: str, distance: float) -> str:
    """A measured place that no configuration allows [m]."""
    return (
        f"part '{part}' is measured {quantity(distance, 'm')} from where its joint allows it to be; give the position "
        "of the part's origin in m, in the base frame of the model"
    )


@message
def part_turned(part: str, angle: float, is_scalar_first: bool) -> str:
    """A measured orientation that no configuration allows [rad]."""
    hint = "give the orientation from part to base, scalar last"
    if is_scalar_first:
        hint = "the quaternion has its scalar first; give it last"
    return f"part '{part}' is measured turned by {quantity(angle, 'rad')} against its joint; {hint}"


@message
def starts_elsewhere(name: str, measured: float, start: tuple[float, float], unit: str) -> str:
    """A first measurement far from the problem's start (mean, std)."""
    stated = f"the problem starts at {with_spread(*start, unit)}"
    return f"{name} is measured at {quantity(measured, unit)} after a reset, but {stated}"


@message
def truth_of_wrong_shape(name: str, expected: tuple[int, ...], found: tuple[int, ...]) -> str:
    """A field of the referee's truth has another shape."""
    return f"Truth.{name} must have shape {expected}. Got {found}"


@message
def truth_elsewhere(part: str, distance: float) -> str:
    """The tracker and the referee disagree [m]."""
    return f"part '{part}' is measured {quantity(distance, 'm')} from its true place"


@message
def moves_otherwise(name: str, commanded: float, moved: float, unit: str) -> str:
    """A motion other than the commanded one."""
    return (
        f"commanded to move {name} by {quantity(commanded, unit)}, it moved by {quantity(moved, unit)}; a command is a "
        "displacement in m, in the base frame, from where the part is"
    )


@message
def moves_without_command(name: str, moved: float, unit: str) -> str:
    """A motion without a command."""
    return f"without a command {name} moved by {quantity(moved, unit)}; it must stand still"


@message
def resets_differ() -> str:
    """Two resets with one seed differ."""
    return "a simulation must start alike for the same seed; draw all chances from the rng of reset"


@message
def part_unseen(part: str, unseen: int, commands: int) -> str:
    """A part that was not measured in some steps, which limits the test."""
    return (
        f"part '{part}' was not seen after {unseen} of {count(commands, 'command')}: it was taken to be where the "
        "model has it"
    )


@message
def input_untried(name: str, mode: str) -> str:
    """An input whose motion would not exceed the noise."""
    return f"input '{name}' was not tried: in mode {mode} none of its motions exceeds the noise"
