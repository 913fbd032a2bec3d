"""A hinged door and a drawer simulated by hand, with something in them that no model knows. No code of the package."""

from __future__ import annotations

import numpy as np

from micah_plan.recording.value import Recording

RADIUS, LENGTH, PERIOD = 0.3, 1.2, 0.1
STEP = LENGTH / 25


def runs_of(plant, count, rows, seed, *, noise=0.003, disturbance=0.001):
    """(z, u) of runs in which a hand goes to and fro between drawn places; plant(c, u, k, memory) -> c."""
    rng = np.random.default_rng(seed)
    found = []
    for run in range(count):
        c, memory = rng.uniform(0.0, 0.5) * LENGTH, {"run": run, "rng": rng}
        believed, goal = c, rng.uniform(0.1, 0.95) * LENGTH
        z, u = np.zeros(rows), np.zeros(rows)
        for k in range(rows):
            z[k] = memory.get("read", lambda value, _: value)(c, k) + noise * rng.standard_normal()
            if abs(goal - believed) < STEP:
                goal = rng.uniform(-0.05, 1.05) * LENGTH
            u[k] = np.clip(goal - believed, -STEP, STEP) * rng.uniform(0.3, 1.0)
            believed = np.clip(believed + u[k], 0.0, LENGTH)
            c = plant(c, u[k], k, memory) + disturbance * rng.standard_normal()
            c = min(max(c, 0.0), memory.get("end", LENGTH))
        found.append((z, u))
    return found


def door_recording(runs):
    """Poses of a handle 0.3 m from a vertical hinge, and chords of the commanded turns as actions."""
    columns = {name: [] for name in ("time", "position", "quaternion", "action", "run")}
    for number, (z, u) in enumerate(runs, start=1):
        there, aimed = _point(z), _point(z + u)
        action = aimed - there
        action[-1] = np.nan
        columns["time"].append(PERIOD * np.arange(len(z)))
        columns["position"].append(there)
        columns["quaternion"].append(np.stack([0 * z, 0 * z, np.sin(z / 2), np.cos(z / 2)], axis=1))
        columns["action"].append(action)
        columns["run"].append(np.full(len(z), number))
    return Recording(**{name: np.concatenate(parts) for name, parts in columns.items()}, has_run=True)


def _point(angle):
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), np.full_like(angle, 0.1)], axis=1)


def honest(c, u, k, memory):
    return c + u


def short_steps(c, u, k, memory):
    return c + 0.8 * u


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


def slow(c, u, k, memory):
    memory["v"] = memory.get("v", 0.0) + 0.5 * (u - memory.get("v", 0.0))
    return c + memory["v"]


def weak(c, u, k, memory):
    return c + min(max(u, -0.025), 0.025)


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
