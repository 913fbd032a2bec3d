"""How a demonstrator's hand moves a microwave door or a drawer: rows of configurations, and of what the hand asked for.

Three ways, as in the paper (section "Learning Kinematics Models for Objects"):

* `grasping` without pauses: a firm grasp. The hand takes up some slack, then leads the part at uneven speed. It pulls
  across the joint too, and how much of its motion reaches the part drifts slowly. A door is pressed on once it is shut.
* `grasping` with pauses: the same, but in between, at two random places, the hand asks for nothing and the part rests.
* `pushing`: a fingertip. It approaches through the air, and pushes in two to four strokes in which it slides along the
  part, so that most of its motion is across the joint and the part sticks and slips. After each stroke it breaks off,
  returns, and moves forward through air until it touches again. A shut door is pressed on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Phase = tuple[Floats, Floats, Floats]  # per row: step taken, step asked for [rad or m], hand motion across [m] (k, 2)


@dataclass(frozen=True)
class Habits:
    """What makes a hand less than perfect; zeros make a perfect one.

    Attributes:
        unevenness: std of ln speed.
        grip: std of ln (asked for / taken): slack, compliance, friction.
        across: hand motion across the joint, as a share of the motion along it, in a firm grasp.
        tremor: std from row to row, as a share of the typical step.
        slack: fewest and most rows in which a grasping hand pulls before the part moves.
    """

    unevenness: float = 0.3
    grip: float = 0.25
    across: float = 0.3
    tremor: float = 0.04
    slack: tuple[int, int] = (3, 10)


PERFECT = Habits(0.0, 0.0, 0.0, 0.0, (0, 0))


@dataclass(frozen=True, eq=False)
class HandMotion:
    """n rows of a demonstration.

    Attributes:
        configuration: (n,) of the part, from 0 [rad or m].
        command: (n - 1,) configuration step that the hand asked for from this row to the next [rad or m].
        across: (n - 1, 2) hand motion across the joint [m].
    """

    configuration: Floats
    command: Floats
    across: Floats


def slow(rng: np.random.Generator, rows: int, memory: float) -> Floats:
    """(rows,) standard normal numbers whose correlation decays by e in `memory` rows (Ornstein-Uhlenbeck)."""
    keep = np.exp(-1.0 / memory)
    values = rng.standard_normal(rows)
    values[1:] *= np.sqrt(1.0 - keep**2)
    for i in range(1, rows):
        values[i] += keep * values[i - 1]
    return values


def grasping(
    rows: int, travel: float, lever: float, stops: bool, pauses: int, habits: Habits, rng: np.random.Generator
) -> HandMotion:
    """A demonstration with a firm grasp.

    Args:
        rows: of the recording.
        travel: [rad or m].
        lever: hand motion per configuration [m/rad, or 1].
        stops: whether the part ends at a stop that the hand goes on pressing against.
        pauses: how often the hand rests on the way.
        habits: of the hand.
    """
    lead = int(rng.integers(habits.slack[0], habits.slack[1] + 1))
    rest = [int(rng.integers(12, 21)) for _ in range(pauses)]
    last = round(rows * rng.uniform(0.22, 0.32)) if stops else int(rng.integers(0, 7))
    moving = rows - 1 - lead - sum(rest) - last
    cuts = [round(moving * (i + rng.uniform(0.65, 1.35)) / (pauses + 1)) for i in range(pauses)]
    lengths = np.diff([0, *cuts, moving])
    speeds = [_speed(int(k), stops and i == pauses, habits.unevenness, rng) for i, k in enumerate(lengths)]
    unit = travel / sum(float(speed.sum()) for speed in speeds)
    typical = travel / moving
    phases = [_idle(np.linspace(0.0, typical, lead))]
    for i, speed in enumerate(speeds):
        phases.append(_action_driven_model(speed * unit, lever, habits, rng))
        if i < pauses:
            phases.append(_idle(np.zeros(rest[i])))
    phases.append(_idle(_press(last, typical, habits, rng) if stops else np.zeros(last)))
    return _joined(phases, travel, typical * habits.tremor, lever, rng)


def pushing(
    rows: int, travel: float, lever: float, stops: bool, habits: Habits, rng: np.random.Generator
) -> HandMotion:
    """A demonstration with a fingertip; arguments as of `grasping`."""
    strokes = int(rng.integers(2, 5))
    approach = int(rng.integers(8, 23))
    gaps = [int(rng.integers(5, 11)) for _ in range(strokes - 1)]
    last = round(rows * rng.uniform(0.22, 0.32)) if stops else int(rng.integers(0, 9))
    moving = rows - 1 - approach - sum(gaps) - last
    cuts = np.round(moving * np.cumsum(rng.dirichlet(np.full(strokes, 8.0)))[:-1]).astype(int)
    lengths = np.diff([0, *cuts, moving])
    speeds = [_speed(int(k), stops and i == strokes - 1, habits.unevenness, rng) for i, k in enumerate(lengths)]
    slips = [speed * _stick_slip(len(speed), rng) for speed in speeds]
    unit = travel / sum(float(slip.sum()) for slip in slips)
    typical = travel / moving
    side = rng.uniform(0.0, 2 * np.pi)
    phases = [_approach(approach, typical, lever, rng)]
    for i, (speed, slip) in enumerate(zip(speeds, slips, strict=True)):
        steps = slip * unit
        asked = steps * np.exp(habits.grip * slow(rng, len(steps), 20)) + 0.2 * typical * slow(rng, len(steps), 8)
        sliding = np.tan(np.deg2rad(rng.uniform(50.0, 75.0))) * typical * lever * speed
        heading = side + rng.normal(0.0, 0.5) + 0.4 * slow(rng, len(steps), 15)
        phases.append((steps, asked, sliding[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)))
        if i < strokes - 1:
            phases.append(_return(gaps[i], typical, lever, phases[-1][2], rng))
    if stops:
        across = 0.7 * typical * lever * np.stack([slow(rng, last, 15), slow(rng, last, 15)], axis=1)
        phases.append((np.zeros(last), _press(last, typical, habits, rng), across))
    else:
        phases.append(_return(last, typical, lever, phases[-1][2], rng))
    return _joined(phases, travel, typical * habits.tremor, lever, rng)


def _speed(rows: int, ends_abruptly: bool, unevenness: float, rng: np.random.Generator) -> Floats:
    """(rows,) relative speed of a stroke that starts and ends gently, unless a stop ends it."""
    row = np.arange(rows)
    ramp_in, ramp_out = rng.uniform(3.0, 7.0, 2)
    speed = np.minimum(1.0, (row + 1.0) / ramp_in)
    if not ends_abruptly:
        speed = np.minimum(speed, (rows - row) / ramp_out)
    return np.asarray(speed * np.exp(unevenness * slow(rng, rows, 8)))


def _stick_slip(rows: int, rng: np.random.Generator) -> Floats:
    """(rows,) factor of a part that is pushed by a sliding contact; in one row of ten it sticks."""
    factor = np.exp(0.5 * slow(rng, rows, 2)) * (rng.random(rows) > 0.1)
    factor[-1] = max(factor[-1], 0.2)  # a stroke ends with the part moving
    return np.asarray(factor)


def _action_driven_model(steps: Floats, lever: float, habits: Habits, rng: np.random.Generator) -> Phase:
    asked = steps * np.exp(habits.grip * slow(rng, len(steps), 20))
    pull = habits.across * np.stack([slow(rng, len(steps), 15), slow(rng, len(steps), 15)], axis=1)
    return steps, asked, asked[:, None] * lever * pull


def _idle(asked: Floats) -> Phase:
    """The hand asks, the part rests."""
    return np.zeros(len(asked)), asked, np.zeros((len(asked), 2))


def _press(rows: int, typical: float, habits: Habits, rng: np.random.Generator) -> Floats:
    return np.asarray(typical * rng.uniform(0.6, 1.5) * np.exp(habits.unevenness * slow(rng, rows, 12)))


def _approach(rows: int, typical: float, lever: float, rng: np.random.Generator) -> Phase:
    """Through the air: mostly across the joint, in the last two rows towards the part."""
    asked = 0.3 * typical * slow(rng, rows, 10)
    asked[-2:] = typical
    across = typical * lever * rng.uniform(1.0, 4.0) * np.stack([slow(rng, rows, 10), slow(rng, rows, 10)], axis=1)
    return np.zeros(rows), asked, across


def _return(rows: int, typical: float, lever: float, slid: Floats, rng: np.random.Generator) -> Phase:
    """Away from the part, back by some of what the finger slid (k, 2), and forward to touch again."""
    back = round(0.6 * rows)
    asked = np.full(rows, typical * rng.uniform(0.3, 1.0))
    asked[:back] = -typical * rng.uniform(0.2, 0.8)
    across = np.zeros((rows, 2))
    back_slide = -slid.sum(axis=0) * rng.uniform(0.4, 1.0) / max(back, 1)
    fastest = 4.0 * typical * lever / max(float(np.linalg.norm(back_slide)), 1e-12)  # hands in recordings are no faster
    across[:back] = back_slide * min(1.0, fastest)
    return np.zeros(rows), asked, across


def _joined(phases: list[Phase], travel: float, tremor: float, lever: float, rng: np.random.Generator) -> HandMotion:
    steps, asked, across = (np.concatenate(column) for column in zip(*phases, strict=True))
    configuration = np.concatenate([[0.0], np.cumsum(steps)])
    configuration[int(np.flatnonzero(steps)[-1]) + 1 :] = travel  # exactly, without the rounding of the sum
    return HandMotion(
        configuration,
        asked + tremor * rng.standard_normal(len(asked)),
        across + tremor * lever * rng.standard_normal(across.shape),
    )
