"""Effects with memory of earlier commands, and position commands."""

from __future__ import annotations

import math
from typing import final

import numpy as np

from micah_plan.automaton.effects.fit_start import CoordinateSeries, FitStart, step_sizes
from micah_plan.automaton.effects.form import EffectForm, InForce, Memory, Operations, Parameter, Value, Values
from micah_plan.automaton.effects.value import Effect

LONGEST_DELAY = 30
"""The longest delay [steps]."""
_SHORTEST = 1e-3  # steps: a shorter lag has no effect after one step


def is_constant(value: Value) -> bool:
    """Whether a value is a number rather than an expression or an array."""
    return isinstance(value, float | int)


def in_force(value: Value, kept: Memory, delay: float) -> tuple[InForce, Memory]:
    """(commands in force after `delay` steps, kept commands) with the newest first."""
    sent, whole = (value, *kept), int(delay)
    return InForce(sent[whole], sent[math.ceil(delay)], delay - whole), sent[:-1]


def left_after(ops: Operations, steps: Value, lag: Value) -> Value:
    """Remaining fraction of a first-order response after so many steps, with the time constant in steps."""
    return ops.exp(-steps / ops.maximum(lag, _SHORTEST))


def beyond_zone(ops: Operations, value: Value, width: Value) -> Value:
    """Soft threshold: the part of a value beyond a symmetric dead zone."""
    return ops.maximum(value - width, 0.0) + ops.minimum(value + width, 0.0)


@final
class Delay(EffectForm):
    """v_t -> v_(t-delay), linear between whole steps."""

    name = "delay"
    sentence = "Commands take effect later than they were given."
    source = "Laakso et al., Splitting the unit delay, IEEE Signal Processing Magazine 1996 (linear interpolation)"
    parameters = (Parameter("steps", "step", 0.0, 0.0, float(LONGEST_DELAY)),)
    complexity_rank = 6
    late_by = 0

    def at_rest(self, p: Values) -> Memory:
        kept: Memory = (0.0,) * math.ceil(p[0])
        return kept

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        sent, kept = in_force(v, memory, p[0])
        return self.remember_late(ops, sent, (), p)[0], kept

    def remember_late(self, ops: Operations, sent: InForce, memory: Memory, p: Values) -> tuple[Value, Memory]:
        return (1.0 - sent.late) * sent.newer + sent.late * sent.older, ()

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        return FitStart([[steps] for steps in (0.4, 1.0, 2.0, 3.5, 6.0, 9.0, 13.0, 18.0, 25.0)], (0,), [1.0])


@final
class Lag(EffectForm):
    """First-order lag with a time constant tau in steps: out_t = out_(t-1) + (1 - exp(-1 / tau)) (v_t - out_(t-1))."""

    name = "lag"
    sentence = "The motion follows the command only gradually."
    source = "Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., section 2.3: sampled first-order system"
    parameters = (Parameter("steps", "step", 0.0, 0.0, 30.0),)
    complexity_rank = 7
    experiments = (
        ("gain", "command one long step and then none: a lag goes on moving, a gain does not"),
        ("delay", "command one large step after a rest: a delay moves all at once, a lag gradually"),
    )

    def at_rest(self, p: Values) -> Memory:
        return (0.0,)

    def in_motion(self, c: Value, step: Value, p: Values) -> Memory:
        return (step,)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        out = memory[0] + (1.0 - left_after(ops, 1.0, p[0])) * (v - memory[0])
        return out, (out,)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        return FitStart([[0.3], [0.8], [2.0], [5.0]], (0,), [1.0])


@final
class Ramp(EffectForm):
    """A drive with limited change per step: out_t = out_(t-1) + the change to v_t, clipped to `change`."""

    name = "ramp"
    sentence = "The drive speeds up and slows down by at most so much per step, however the command changes."
    source = "Biagiotti and Melchiorri, Trajectory Planning, 2008, ch. 4 (filters with limits); Khalil, section 1.2.7"
    parameters = (Parameter("change", "coordinate", None, 0.0),)
    complexity_rank = 8
    experiments = (
        (
            "lag",
            "command a small and a large step: a lag takes as long for both, a ramp longer for the large one",
        ),
        ("delay", "command one large step after a rest: a delay moves all at once, a ramp gradually"),
    )

    def at_rest(self, p: Values) -> Memory:
        return (0.0 * p[0],)

    def in_motion(self, c: Value, step: Value, p: Values) -> Memory:
        return (step,)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        out = memory[0] + limited(ops, v - memory[0], p[0])
        return out, (out,)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        fastest = max(step_sizes(data, 0.98), default=0.0)
        return FitStart([[k * fastest] for k in (0.03, 0.1, 0.3, 0.6)], (0,), [0.1 * fastest]) if fastest else None


@final
class Backlash(EffectForm):
    """Backlash of a given width between drive and part; the memory is the drive's position within it.

    `side` is the initial place: -1 and 1 at the ends (1: a positive command moves the part at once), 0 in the middle.
    """

    name = "backlash"
    sentence = "When the direction reverses, a part of the motion is lost before the part follows."
    source = "Nordin and Gutman, Controlling mechanical systems with backlash, Automatica 2002 (play model)"
    parameters = (Parameter("width", "coordinate", 0.0, 0.0), Parameter("side", "1", None, -1.0, 1.0))
    complexity_rank = 9
    experiments = (
        ("delay", "reverse slowly: play loses the same distance at any speed, a delay less"),
        ("lag", "reverse slowly: play loses the same distance at any speed, a lag less"),
    )

    def at_rest(self, p: Values) -> Memory:
        return (0.5 * p[0] * p[1],)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        ahead = memory[0] + v
        kept = ops.maximum(ops.minimum(ahead, 0.5 * p[0]), -0.5 * p[0])
        return ahead - kept, (kept,)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        size = data.command_size
        return FitStart([[width * size, side] for width in (0.5, 2.0) for side in (-1.0, 0.0, 1.0)], (0,), [0.5 * size])


@final
class StickSlip(EffectForm):
    """Commands accumulate while the part sticks; above the grip the sum is carried out at once."""

    name = "stick_slip"
    sentence = "The part sticks until what was commanded has added up, and then makes up for it at once."
    source = (
        "Karnopp, Computer simulation of stick-slip friction, ASME J. Dynamic Systems 1985 (without the slip's time)"
    )
    parameters = (Parameter("grip", "coordinate", 0.0, 0.0),)
    complexity_rank = 10
    experiments = (("backlash", "command many small steps one way: with play all but the first arrive"),)

    def at_rest(self, p: Values) -> Memory:
        return (0.0 * p[0],)

    def remember(self, ops: Operations, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        wound = memory[0] + v
        gone = ops.where(ops.abs(wound) < p[0], 0.0 * wound, wound)
        return gone, (wound - gone,)

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """The best of many grips: the loss has many local minima, since the part slips in other rows."""
        grip = np.geomspace(0.2, 10.0, 200)[:, None] * data.command_size
        memory, missed = self.at_rest((grip,)), np.zeros(len(grip))
        for t in range(data.z.shape[1] - 1):
            arrived, memory = self.remember(np, data.u[:, t], memory, (grip,))
            missed += (np.abs(data.z[:, t + 1] - data.z[:, t] - arrived) * data.counted[:, t + 1]).sum(axis=1)
        return FitStart(grip[np.argsort(missed, kind="stable")[:5]], (0,), [0.1 * data.command_size])


@final
class Follow(EffectForm):
    """Position servo: commands are positions r_t = c_t + v_t that the part follows from any configuration:

    w_t = momentum (c_t - c_(t-1)) + the mean of z(gain r + offset - c_t) over the step, with r the command `delay`
    steps ago, z(e) = sign(e) min(share max(|e| - width, 0), pull, the step from which `acceleration` stops it within
    that distance), c_(t+1) - c_t = sign(w_t) max(|w_t| - friction, 0), different from the step before by at most
    `acceleration`, and at most `speed` in size.

    First order without a momentum, second order with one. A place is constant in the base frame: what the part missed
    before is made up for. A delay that ends within a step uses the older place for a share of it, and then the newer
    one. `width` is the controller's dead zone; `friction` (Coulomb's, implicit in the step) brakes motion and holds a
    part at rest. `pull` is the limit of a motor's voltage or torque, with the damping of `momentum`; `acceleration` and
    `speed` are limits of a controller's profile. With neutral parameters the part is at the place after each step.
    """

    name = "follow"
    sentence = "Commands are places: the part goes a share of the way to the commanded place in each step."
    source = (
        "Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., ch. 2; Hogan, Impedance control, 1985; "
        "Biagiotti and Melchiorri, Trajectory Planning, 2008, ch. 4 (filters with limits of speed and acceleration); "
        "Kikuuwe et al., Fixed-step friction simulation, IROS 2005 (Coulomb's friction, implicit in a step)"
    )
    parameters = (
        Parameter("share", "1", 1.0, 0.0, 2.0),
        Parameter("offset", "coordinate", 0.0),
        Parameter("gain", "1", 1.0, 1e-3, 3.0),
        Parameter("delay", "step", 0.0, 0.0, float(LONGEST_DELAY)),
        Parameter("momentum", "1", 0.0, -0.5, 0.995),
        Parameter("width", "coordinate", 0.0, 0.0),
        Parameter("pull", "coordinate", math.inf, 0.0, is_optional=True),
        Parameter("acceleration", "coordinate", math.inf, 1e-9, is_optional=True),
        Parameter("speed", "coordinate", math.inf, 0.0, is_optional=True),
        Parameter("friction", "coordinate", 0.0, 0.0, is_optional=True),
    )
    experiments = (("gain", "command places that stay where they are for many rows, and not displacements"),)
    in_library = False
    late_by = 3

    def at_rest_in(self, c: Value, p: Values) -> Memory:
        return (c, *(self.commanded_at_rest(c, p),) * math.ceil(p[3]))

    def commanded_at_rest(self, c: Value, p: Values) -> Value:
        return (c - p[1]) / p[2]

    def respond(self, ops: Operations, c: Value, v: Value, memory: Memory, p: Values) -> tuple[Value, Memory]:
        sent, kept = in_force(c + v, memory[1:], p[3])
        step, own = self.respond_late(ops, c, sent, memory[:1], p)
        return step, (*own, *kept)

    def respond_late(self, ops: Operations, c: Value, sent: InForce, memory: Memory, p: Values) -> tuple[Value, Memory]:
        share, offset, gain, _, momentum, width, most, acceleration, speed, friction = p
        before = c - memory[0]

        def pull(place: Value) -> Value:
            away = gain * place + offset - c
            beyond = beyond_zone(ops, away, width)
            asked = share * beyond
            if is_limited(acceleration):
                asked = limited(ops, asked, _braking_step(ops, ops.abs(beyond), acceleration))
            return limited(ops, asked, most)

        is_whole = is_constant(sent.late) and not sent.late
        pulled = pull(sent.newer) if is_whole else (1.0 - sent.late) * pull(sent.newer) + sent.late * pull(sent.older)
        step = momentum * before + pulled
        if not (is_constant(friction) and not friction):
            step = beyond_zone(ops, step, friction)
        step = before + limited(ops, step - before, acceleration) if is_limited(acceleration) else step
        return limited(ops, step, speed), (c,)


def is_limited(most: Value) -> bool:
    """Whether a parameter is a limit: expressions and arrays may be, infinity is not."""
    return not (is_constant(most) and math.isinf(most))


def limited(ops: Operations, value: Value, most: Value) -> Value:
    """A value clipped to [-most, most]."""
    return ops.maximum(ops.minimum(value, most), -most) if is_limited(most) else value


def _braking_step(ops: Operations, way: Value, acceleration: Value) -> Value:
    """The largest first step from which steps that shrink by `acceleration` each cover at most a distance."""
    half = 0.5 * acceleration
    return ops.sqrt(half * half + 2.0 * acceleration * way) - half


AS_COMMANDED = tuple((parameter.name, float(parameter.neutral or 0.0)) for parameter in Follow.parameters)
"""Parameters of `Follow` with which the part is at the commanded place after each step."""


def is_as_commanded(effect: Effect) -> bool:
    """Whether an effect only declares commands to be positions, without servo dynamics."""
    return effect.name == Follow.name and effect.parameters == AS_COMMANDED and effect.since is None
