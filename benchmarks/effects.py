"""Recovery of planted effects and false alarms: how often named right, parameter error, coverage, held-out error.

    python -m benchmarks effects [--seeds 2] [--sizes 3] [--runs 10] [--effects gain ...] [--controls 20] [--jobs 1]
    python -m benchmarks effects --grid --sizes 1 2 3 5 --runs 2 5 20 --seeds 5 --controls 0 --jobs 2

The plants are those of the tests (a hinged door simulated by hand); they share no code with the library. The size of an
effect is the root mean square of what it changes in a step, over the steps that it changes, over the std of a
measurement: the effect stays as it is and the noise follows. A third of that noise moves the part. The floor is the
one-step error of the plant itself: two measurements and what moves the part. With `--grid` each effect is one line that
says in how many recordings of each size and number of runs it was named right, and in how many the answer was wrong:
`explained`, by something else.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "residual"))

import planted_effects as plants

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, revolute, rigid
from micah_plan.automaton.kinematics import ROTATION_LENGTH, forward
from micah_plan.residual.calibrate import calibrate

_ANGLE = 0.6
_TURN = np.array([[np.cos(_ANGLE), np.sin(_ANGLE), 0.0], [-np.sin(_ANGLE), np.cos(_ANGLE), 0.0], [0.0, 0.0, 1.0]])
DISTURBANCE = 1.0 / 3.0
# What the configuration is read with: the position's noise, and a share of the orientation's (`kinematics.inverse`).
READ = float(np.hypot(1.0, ROTATION_LENGTH**2 / (ROTATION_LENGTH**2 + plants.RADIUS**2)))


@dataclass(frozen=True)
class Planted:
    """An effect in a plant.

    Attributes:
        plant: of one step; truth: names of all effects that it has, none if the library has no such effect.
        parameter, value: of the first one, where the plant has the library's form.
        shape, turn, press: what differs in the poses and in the actions, see `planted_effects.door_recording`.
        halves: whether the model has a mode for each half of the range.
        goals: where the hand aims, so that what is at an end is seen; None: seldom there.
    """

    plant: Callable[..., float]
    truth: tuple[str, ...]
    parameter: str = ""
    value: float = np.nan
    shape: Callable[..., Any] | None = None
    turn: Any = None
    press: float = 0.0
    halves: bool = False
    goals: tuple[float, float] | None = None


PLANTED: dict[str, Planted] = {
    "gain": Planted(plants.short_steps, ("gain",), "gain", 0.8),
    "bias": Planted(plants.creeping, ("bias",), "bias", 0.004),
    "frame_rotation": Planted(
        plants.honest, ("frame_rotation",), "rotation_3", _ANGLE, turn=_TURN, press=0.3 * plants.RADIUS * plants.STEP
    ),
    "frame_rotation of a hand that pulls straight": Planted(plants.honest, ("frame_rotation",), turn=_TURN),
    "delay": Planted(plants.late, ("delay",), "steps", 2.0),
    "lag": Planted(plants.slow, ("lag",), "steps", float(1.0 / np.log(2.0))),
    "saturation": Planted(plants.weak, ("saturation",), "largest", 0.025),
    "direction_gain": Planted(plants.one_sided, ("direction_gain",), "forward", 0.7),
    "dead_zone": Planted(plants.sticky, ("dead_zone",), "width", 0.02),
    "backlash": Planted(plants.loose, ("backlash",), "width", 0.06),
    "spring": Planted(plants.sprung, ("spring",), "stiffness", 0.03),
    "gravity": Planted(plants.heavy, ("gravity",), "cosine", -0.008),
    "latch": Planted(plants.magnetic, ("latch",)),
    "limit": Planted(plants.blocked, ("limit",), "at", 0.7, goals=(0.4, 1.6)),
    "guard_shift": Planted(plants.shifted, ("guard_shift",), "shift", -0.05, goals=(0.4, 1.6)),
    "guard_hysteresis": Planted(plants.clinging, ("guard_hysteresis",), "width", 0.03, goals=(0.8, 1.2)),
    "screw_pitch": Planted(plants.honest, ("screw_pitch",), "pitch", 0.02, shape=plants.climbing),
    "axis_offset": Planted(plants.honest, ("axis_offset",), "offset_2", -0.015, shape=plants.off_axis),
    "sensor_scale": Planted(plants.stretched, ("sensor_scale",), "scale", 1.1, goals=(0.4, 1.6)),
    "drift": Planted(plants.drifting, ("drift",), "rate", 0.01, goals=(0.4, 1.6)),
    "gain in one mode": Planted(plants.short_far_out, ("gain",), "gain", 0.75, halves=True),
    "gain since half-way": Planted(plants.worn_half_way, ("gain",), "gain", 0.7),
    "gain and backlash": Planted(plants.short_and_loose, ("gain", "backlash")),
    "delay and dead_zone": Planted(plants.late_and_sticky, ("delay", "dead_zone")),
    "ripple (unknown)": Planted(plants.rippled, ()),
    "swaying (unknown)": Planted(plants.swaying, ()),
}


@dataclass(frozen=True)
class Trial:
    """What one calibration said."""

    verdict: str
    is_right: bool
    is_tied: bool
    said: str
    error: float
    is_covered: bool
    over_floor: float
    excess_left: float
    rollout: float


def door(*, halves: bool = False) -> HybridAutomaton:
    """Swings from 0 to 1.2 rad and is rigid there; `halves` gives each half of the range a mode of its own."""
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    shut = forward(swing, plants.LENGTH)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), plants.LENGTH)

    def segment(joint: Joint, start: float, end: float, first: int) -> Segment:
        return Segment(joint, 0, first, first + 9, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)

    edges = [0.0, 0.5 * plants.LENGTH, plants.LENGTH] if halves else [0.0, plants.LENGTH]
    swings = [segment(swing, a, b, 10 * k) for k, (a, b) in enumerate(pairwise(edges))]
    end = segment(held, plants.LENGTH, plants.LENGTH, 10 * len(swings))
    return build_automaton(KinematicGraph((KinematicEdge(BASE, "door", (*swings, end)),)))


def change(planted: Planted) -> float:
    """Root mean square of what the effect changes in a step where it changes something [rad at the hinge]."""
    changes: list[float] = []
    quiet = plants.runs_of(planted.plant, 20, 50, 0, noise=0.0, disturbance=0.0, goals=planted.goals, changes=changes)
    if planted.shape is not None or planted.turn is not None:
        plain = plants.door_recording(quiet, press=planted.press)
        other = plants.door_recording(quiet, shape=planted.shape, turn=planted.turn, press=planted.press)
        moved = other.position - plain.position
        if planted.turn is not None:
            # Along the motion: by how much the turned action says otherwise than what is carried out.
            angle = np.concatenate([z for z, _ in quiet])
            tangent = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
            moved = (np.nan_to_num(other.action - plain.action) * tangent).sum(axis=1, keepdims=True)
        changes = (np.linalg.norm(moved, axis=1) / plants.RADIUS).tolist()
    felt = np.array([abs(c) for c in changes if abs(c) > 1e-9])
    return float(np.sqrt(np.mean(felt**2)))


def trial(name: str, size: float, runs: int, seed: int) -> Trial:
    """Plant, record, calibrate and compare."""
    planted = PLANTED[name]
    noise = change(planted) / size
    hand = {"noise": noise, "disturbance": DISTURBANCE * noise, "goals": planted.goals}
    moved = plants.runs_of(planted.plant, runs, 50, seed, **hand)
    across = plants.RADIUS * noise
    differs = {"shape": planted.shape, "turn": planted.turn, "press": planted.press}
    recording = plants.door_recording(moved, across=across, seed=seed, **differs)
    found = calibrate(door(halves=planted.halves), recording)
    floor = noise * np.sqrt(2.0 * READ**2 + DISTURBANCE**2)
    if any(effect.effect.name in ("screw_pitch", "axis_offset") for effect in found.effects):
        floor = plants.RADIUS * np.hypot(floor, noise * np.sqrt(2.0))
    first = found.effects[0] if found.effects else None
    said = [first.effect.name, *first.tied] if first is not None else []
    others = {one.effect.name for one in found.effects[1:]}
    modes = [mode for one in found.traces for mode in one.missing_modes]
    hits = [truth for truth in planted.truth if truth in said]
    is_right = bool(hits) and all(truth in others or truth in hits for truth in planted.truth)
    if not planted.truth:
        is_right = found.verdict in ("partly", "unexplained")
    error, is_covered = np.nan, False
    if is_right and first is not None and planted.parameter in dict(first.effect.parameters):
        number = [parameter for parameter, _ in first.effect.parameters].index(planted.parameter)
        low, high = first.interval[number]
        error = abs(first.effect.values[number] / planted.value - 1.0)
        is_covered = low <= planted.value <= high
    excess = [np.sqrt(max(one.one_step**2 - floor**2, 0.0)) for one in (found.before, found.after)]
    return Trial(
        verdict=found.verdict,
        is_right=is_right,
        is_tied=is_right and bool(said) and said[0] not in planted.truth,
        said=" + ".join(_described(one) for one in found.effects) or "; ".join(map(str, modes)) or "nothing",
        error=error,
        is_covered=is_covered,
        over_floor=found.after.one_step / floor,
        excess_left=excess[1] / excess[0] if excess[0] > 0 else 0.0,
        rollout=found.after.rollout / found.before.rollout,
    )


def _described(found: Any) -> str:
    where = f" in {','.join(found.effect.modes)}" if found.effect.modes else ""
    since = "" if found.since is None else f" since run {found.since[0]}"
    return found.effect.name + where + since + (f" (or {', '.join(found.tied)})" if found.tied else "")


def control(seed: int) -> tuple[str, str]:
    """Verdict and description of a recording without any effect: objects, runs, rows and noise drawn by seed."""
    rng = np.random.default_rng(seed)
    runs, rows = int(rng.choice([1, 2, 3, 5, 8, 12, 20])), int(rng.choice([15, 30, 50, 80]))
    noise = float(np.exp(rng.uniform(np.log(0.0005), np.log(0.01))))
    share = float(rng.uniform(0.0, 1.5))
    halves = bool(rng.random() < 0.3)
    goals = (-1.0, 2.0) if rng.random() < 0.5 else None
    moved = plants.runs_of(plants.honest, runs, rows, seed, noise=noise, disturbance=share * noise, goals=goals)
    found = calibrate(door(halves=halves), plants.door_recording(moved, across=plants.RADIUS * noise, seed=seed))
    said = ", ".join(_described(one) for one in found.effects)
    text = f"{seed=}: {runs} x {rows} rows, noise {noise:.4f}, moved {share:.2f}, {halves=}, {goals=}: {said}"
    return found.verdict, text


def _called(work: tuple[str, float, int, int]) -> Trial:
    return trial(*work)


def row(name: str, size: float, runs: int, trials: Sequence[Trial]) -> str:
    """One line of the table."""
    right = sum(one.is_right for one in trials)
    tied = sum(one.is_tied for one in trials)
    verdicts = [one.verdict for one in trials]
    counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
    errors = [one.error for one in trials if np.isfinite(one.error)]
    covered = sum(one.is_covered for one in trials)
    error = f"{100 * np.median(errors):.1f} %" if errors else ""
    cells = (
        f"`{name}`",
        f"{size:g}",
        str(runs),
        f"{right}/{len(trials)}" + (f" ({tied} tied)" if tied else ""),
        counts,
        error,
        f"{covered}/{len(errors)}" if errors else "",
        f"{np.mean([one.over_floor for one in trials]):.2f}",
        f"{np.mean([one.excess_left for one in trials]):.2f}",
        f"{np.mean([one.rollout for one in trials]):.2f}",
    )
    return "| " + " | ".join(cells) + " |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first-seed", type=int, default=100)
    parser.add_argument("--sizes", type=float, nargs="+", default=[3.0])
    parser.add_argument("--runs", type=int, nargs="+", default=[10])
    parser.add_argument("--effects", nargs="*", default=list(PLANTED), help=", ".join(PLANTED))
    parser.add_argument("--controls", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--grid", action="store_true", help="one line per effect instead of one per size and runs")
    parser.add_argument("--failures", action="store_true", help="print what was said where it was not right")
    asked = parser.parse_args()
    seeds = range(asked.first_seed, asked.first_seed + asked.seeds)
    with ProcessPoolExecutor(asked.jobs) as pool:
        for line in lines(asked, seeds, pool):
            print(line, flush=True)


def lines(asked: argparse.Namespace, seeds: Sequence[int], pool: ProcessPoolExecutor) -> Iterator[str]:
    """The table, then the false alarms."""
    groups = [(n, size, runs) for n in asked.effects for size in asked.sizes for runs in asked.runs]
    results = pool.map(_called, [(*group, seed) for group in groups for seed in seeds])
    if asked.grid:
        yield from grid(asked, seeds, results)
    elif groups:
        yield (
            "| planted | size | runs | right first | verdicts | parameter error | covered | error / floor "
            "| excess left | roll-out |"
        )
        yield "| --- " * 10 + "|"
        for group in groups:
            trials = [next(results) for _ in seeds]
            yield row(*group, trials)
            if asked.failures:
                yield from (
                    f"    {seed}: {one.verdict}: {one.said}"
                    for seed, one in zip(seeds, trials, strict=True)
                    if not one.is_right
                )
    alarms = 0
    for verdict, text in pool.map(control, range(1000, 1000 + asked.controls)):
        if verdict != "none":
            alarms += 1
            yield f"false alarm: {verdict}, {text}"
    if asked.controls:
        yield f"{alarms} false alarms in {asked.controls} controls"


def grid(asked: argparse.Namespace, seeds: Sequence[int], results: Iterator[Trial]) -> Iterator[str]:
    """One line per effect, one column per size and number of runs."""
    columns = [(size, runs) for size in asked.sizes for runs in asked.runs]
    yield "| planted | " + " | ".join(f"{size:g}x, {runs} runs" for size, runs in columns) + " |"
    yield "| --- " * (1 + len(columns)) + "|"
    for name in asked.effects:
        cells = []
        for _ in columns:
            trials = [next(results) for _ in seeds]
            wrong = sum(one.verdict == "explained" and not one.is_right for one in trials)
            cells.append(f"{sum(one.is_right for one in trials)}/{len(trials)}" + (f", {wrong} wrong" if wrong else ""))
        yield f"| `{name}` | " + " | ".join(cells) + " |"


if __name__ == "__main__":
    main()
