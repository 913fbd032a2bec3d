"""A hinged door and a drawer simulated by hand, with something in them that no model knows. No code of the package."""

from __future__ import annotations

import numpy as np

from micah_plan.recording.value import Recording

RADIUS, LENGTH, PERIOD = 0.3, 1.2, 0.1
STEP = LENGTH / 25


def runs_of(plant, count, rows, seed, *, noise=0.003, disturbance=0.001, goals=None, changes=None):
    """(z, u) of runs in which a hand goes to and fro between drawn places; plant(c, u, k, memory) -> c.

    `goals`, shares of the range, are where the hand wants to go; those beyond an end are that end. None: rarely there.
    `changes`, a list, takes for each step by how much it differs from that of a part that does as it is told.
    """
    rng = np.random.default_rng(seed)
    found = []
    for run in range(count):
        c, memory = rng.uniform(0.0, 0.5) * LENGTH, {"run": run, "rng": rng}
        plant(c, 0.0, 0, asked := {"run": run, "rng": np.random.default_rng(0)})
        memory |= {name: asked[name] for name in ("read", "end") if name in asked}  # also for the first row
        believed, goal = c, rng.uniform(0.1, 0.95) * LENGTH
        z, u = np.zeros(rows), np.zeros(rows)
        for k in range(rows):
            z[k] = memory.get("read", lambda value, _: value)(c, k) + noise * rng.standard_normal()
            if abs(goal - believed) < STEP:
                goal = rng.uniform(-0.05, 1.05) * LENGTH
                if goals is not None:
                    goal = np.clip(rng.uniform(*goals), -0.039, 1.039) * LENGTH
            u[k] = np.clip(goal - believed, -STEP, STEP) * rng.uniform(0.3, 1.0)
            believed = np.clip(believed + u[k], 0.0, LENGTH)
            told, before = min(max(c + u[k], 0.0), LENGTH) - c, memory.get("read", lambda value, _: value)(c, k)
            c = plant(c, u[k], k, memory) + disturbance * rng.standard_normal()
            c = min(max(c, 0.0), memory.get("end", LENGTH))
            if changes is not None:
                changes.append(memory.get("read", lambda value, _: value)(c, k + 1) - before - told)
        found.append((z, u))
    return found


def door_recording(runs, *, across=0.0, seed=0, shape=None, turn=None, press=0.0):
    """Poses of a handle 0.3 m from a vertical hinge, and chords of the commanded turns as actions.

    Args:
        across: std of a measured position across the motion [m], in both directions; orientations then have noise of
            their own, as much at the handle.
        shape: (K,) angles to (K, 3) true places of the handle; a circle if None.
        turn: rotation matrix by which actions are turned before they are written.
        press: std [m] of what the hand asks for across the motion, where the hinge does not let it go.
    """
    rng, hand = np.random.default_rng(seed), np.random.default_rng([seed, 1])
    columns = {name: [] for name in ("time", "position", "quaternion", "action", "run")}
    for number, (z, u) in enumerate(runs, start=1):
        place = _point if shape is None else shape
        action = place(z + u) - place(z)
        action = action + press * hand.standard_normal((len(z), 1)) * np.stack([np.cos(z), np.sin(z), 0 * z], axis=1)
        action = action if turn is None else action @ turn.T
        action[-1] = np.nan
        scatter = across * rng.standard_normal((len(z), 2))
        away = np.stack([scatter[:, 0] * np.cos(z), scatter[:, 0] * np.sin(z), scatter[:, 1]], axis=1)
        columns["time"].append(PERIOD * np.arange(len(z)))
        columns["position"].append(place(z) + away)
        half = 0.5 * (z + across / RADIUS * rng.standard_normal(len(z)))
        columns["quaternion"].append(np.stack([0 * z, 0 * z, np.sin(half), np.cos(half)], axis=1))
        columns["action"].append(action)
        columns["run"].append(np.full(len(z), number))
    return Recording(**{name: np.concatenate(parts) for name, parts in columns.items()}, has_run=True)


def _point(angle):
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.full_like(angle, 0.1)], axis=1)


def climbing(angle):
    """The handle rises by 2 cm per rad."""
    return _point(angle) + np.outer(angle, [0.0, 0.0, 0.02])


def off_axis(angle):
    """The hinge is 1.5 cm from where the model has it: a larger circle through the same place at angle 0."""
    radius = RADIUS + 0.015
    return np.stack([radius * np.cos(angle) - 0.015, radius * np.sin(angle), np.full_like(angle, 0.1)], axis=1)


def honest(c, u, k, memory):
    return c + u


def short_steps(c, u, k, memory):
    return c + 0.8 * u


def feeble(c, u, k, memory):
    return c + 0.1 * u + 0.004


def late(c, u, k, memory):
    past = memory.setdefault("past", [0.0, 0.0])
    past.append(u)
    return c + past.pop(0)


def sticky(c, u, k, memory):
    return c + (u if abs(u) > 0.02 else 0.0)


def sprung(c, u, k, memory):
    return c - 0.03 * (c - 0.3) + u


def loose(c, u, k, memory):
    gap = memory.setdefault("gap", 0.0) + u
    memory["gap"] = min(max(gap, -0.03), 0.03)
    return c + gap - memory["gap"]


def sticking(c, u, k, memory):
    """Lets go of all that was commanded when that adds up to 70 mrad."""
    wound = memory.get("wound", 0.0) + u
    memory["wound"] = wound if abs(wound) < 0.07 else 0.0
    return c + wound - memory["wound"]


def slow(c, u, k, memory):
    memory["v"] = memory.get("v", 0.0) + 0.5 * (u - memory.get("v", 0.0))
    return c + memory["v"]


def ramping(c, u, k, memory):
    before = memory.get("v", 0.0)
    memory["v"] = before + min(max(u - before, -0.012), 0.012)
    return c + memory["v"]


def weak(c, u, k, memory):
    return c + min(max(u, -0.025), 0.025)


def tiring(c, u, k, memory):
    """The larger a step, the smaller the share of it that is made."""
    return c + u / (1.0 + 1.2 * abs(u) / STEP)


def creeping(c, u, k, memory):
    return c + u + 0.004


def magnetic(c, u, k, memory):
    away = c - 0.6
    return c + u - (0.3 * away * (1 - (away / 0.15) ** 2) if abs(away) < 0.15 else 0.0)


def blocked(c, u, k, memory):
    memory["end"] = 0.7
    return c + u


def shifted(c, u, k, memory):
    memory["end"] = LENGTH - 0.05
    return c + u


def stretched(c, u, k, memory):
    memory["read"] = lambda value, _: 1.1 * value
    return c + u


def drifting(c, u, k, memory):
    memory["read"] = lambda value, row: value + 0.01 * PERIOD * row
    return c + u


def worn_half_way(c, u, k, memory):
    return c + (0.7 * u if memory["run"] >= 5 else u)


def rippled(c, u, k, memory):
    return c + u + 0.008 * np.sin(9 * c)


def one_sided(c, u, k, memory):
    return c + (0.7 * u if u > 0 else u)


def swaying(c, u, k, memory):
    return c + u + 0.01 * np.sin(0.35 * k)


def heavy(c, u, k, memory):
    return c + u - 0.008 * np.cos(c)


def clinging(c, u, k, memory):
    """At its upper end the part stays until it is pulled back by more than 30 mrad."""
    memory["held"] = memory.get("held", False) or c >= LENGTH
    memory["held"] = memory["held"] and u >= -0.03
    return LENGTH if memory["held"] else c + u


def short_and_loose(c, u, k, memory):
    return loose(c, 0.8 * u, k, memory)


def late_and_sticky(c, u, k, memory):
    return late(c, u if abs(u) > 0.02 else 0.0, k, memory)


def short_far_out(c, u, k, memory):
    return c + (0.75 * u if c >= 0.5 * LENGTH else u)
