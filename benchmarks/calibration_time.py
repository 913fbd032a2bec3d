"""How long a calibration computes, by the rows of its recording.

    python -m benchmarks calibration_time [--rows 360 2000 20000] [--seed 3]

A door with runs of a hand that goes to and fro: as modelled, with a gain, with play, and with a ripple that no effect
has. Seconds are CPU of `calibrate` in a process that has calibrated before: what Numba compiles or loads at first is
the row above the table. The last rows are `predict` of the door with a gain: the errors, and whether they are noise.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import process_time

import numpy as np
from numpy.typing import NDArray

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import revolute
from micah_plan.recording.value import Recording
from micah_plan.residual.calibrate import calibrate
from micah_plan.residual.judgement import judge
from micah_plan.residual.prediction import predict_recording

Floats = NDArray[np.float64]
Plant = Callable[[float, float, float], tuple[float, float]]
"""(configuration, memory) after a command, of a configuration, that command and a memory."""

_LENGTH, _RADIUS, _PERIOD, _STEP = 1.2, 0.3, 0.1, 0.048
_NOISE, _DISTURBANCE, _PLAY = 0.003, 0.001, 0.04


def _with_play(c: float, u: float, back: float) -> tuple[float, float]:
    ahead = back + u
    kept = min(max(ahead, -0.5 * _PLAY), 0.5 * _PLAY)
    return c + ahead - kept, kept


PLANTS: dict[str, Plant] = {
    "nothing": lambda c, u, memory: (c + u, memory),
    "a gain": lambda c, u, memory: (c + 0.8 * u, memory),
    "play": _with_play,
    "a ripple (?)": lambda c, u, memory: (c + u + 0.012 * float(np.sin(25.0 * c)), memory),
}


def model() -> HybridAutomaton:
    """A door from 0 to 1.2 rad."""
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (_RADIUS, 0.0, 0.1))
    only = Segment(swing, 0, 0, 99, 0.0, _LENGTH, (0.0, _LENGTH), _DISTURBANCE, _NOISE, 0.0, 1.0)
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (only,)),)))


def recording(plant: Plant, runs: int, rows: int, seed: int) -> Recording:
    """Poses of a handle, and chords of the commanded turns."""
    rng = np.random.default_rng(seed)
    z, u = np.zeros((2, runs, rows))
    for run in range(runs):
        c, memory, goal = rng.uniform(0.0, 0.5) * _LENGTH, 0.0, rng.uniform(0.1, 0.9) * _LENGTH
        believed = c
        for k in range(rows):
            z[run, k] = c + _NOISE * rng.standard_normal()
            if abs(goal - believed) < _STEP:
                goal = rng.uniform(0.02, 0.98) * _LENGTH
            u[run, k] = np.clip(goal - believed, -_STEP, _STEP) * rng.uniform(0.3, 1.0)
            believed += u[run, k]
            c, memory = plant(c, u[run, k], memory)
            c = float(np.clip(c + _DISTURBANCE * rng.standard_normal(), 0.0, _LENGTH))
    angle, told = z.ravel(), u.ravel()

    def place(at: Floats) -> Floats:
        return np.stack([_RADIUS * np.cos(at), _RADIUS * np.sin(at), np.full_like(at, 0.1)], axis=1)

    action = place(angle + told) - place(angle)
    action[rows - 1 :: rows] = np.nan
    return Recording(
        time=np.tile(np.arange(rows) * _PERIOD, runs),
        position=place(angle),
        quaternion=np.stack([0 * angle, 0 * angle, np.sin(0.5 * angle), np.cos(0.5 * angle)], axis=1),
        action=action,
        run=np.repeat(np.arange(1, runs + 1), rows),
        has_run=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rows", nargs="*", type=int, default=[360, 2000, 20_000])
    parser.add_argument("--seed", type=int, default=3)
    given = parser.parse_args()
    begin = process_time()
    calibrate(model(), recording(PLANTS["nothing"], 4, 30, given.seed))
    print(f"first calibration, of 120 rows: {process_time() - begin:.1f} s\n")
    print("| what the door has | " + " | ".join(f"{rows:,} rows" for rows in given.rows) + " |")
    print("| --- |" + " --- |" * len(given.rows))
    for name, plant in PLANTS.items():
        cells = []
        for rows in given.rows:
            log = recording(plant, _runs(rows), rows // _runs(rows), given.seed)
            begin = process_time()
            found = calibrate(model(), log)
            names = ", ".join(one.effect.name for one in found.effects) or "nothing"
            cells.append(f"{process_time() - begin:.1f} s ({found.verdict}: {names})")
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    errors, verdicts = [], []
    for rows in given.rows:
        log = recording(PLANTS["a gain"], _runs(rows), rows // _runs(rows), given.seed)
        begin = process_time()
        predicted = predict_recording(model(), log)
        errors.append(f"{process_time() - begin:.2f} s")
        begin = process_time()
        is_noise = judge(model(), log, predicted).is_noise
        verdicts.append(f"{process_time() - begin:.2f} s (noise: {is_noise})")
    for name, cells in (("predict: errors", errors), ("predict: its verdict", verdicts)):
        print(f"| {name} | " + " | ".join(cells) + " |")


def _runs(rows: int) -> int:
    return 12 if rows < 10_000 else 40


if __name__ == "__main__":
    main()
