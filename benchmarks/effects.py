"""Recovery of planted effects: how often named first, parameter error, held-out error over the noise floor.

    python benchmarks/effects.py [seeds] [runs]

The plants are those of the tests (a hinged door simulated by hand); they share no code with the library.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests" / "residual"))

import planted_effects as plants

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.joint import Joint, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.residual.calibrate import calibrate

TRUE: dict[str, tuple[str, float | None]] = {
    "honest": ("none", None),
    "short_steps": ("gain", 0.8),
    "creeping": ("bias", 0.004),
    "late": ("delay", 2.0),
    "slow": ("lag", 1.0 / np.log(2.0)),
    "weak": ("saturation", 0.025),
    "sticky": ("dead_zone", 0.02),
    "loose": ("backlash", 0.06),
    "sprung": ("spring", 0.03),
    "magnetic": ("latch", None),
    "blocked": ("limit", 0.7),
    "shifted": ("guard_shift", -0.05),
    "stretched": ("sensor_scale", 1.1),
    "drifting": ("drift", 0.01),
    "worn_half_way": ("gain", 0.7),
    "rippled": ("(not in the library)", None),
    "one_sided": ("(not in the library)", None),
    "swaying": ("(not in the library)", None),
}


def door() -> HybridAutomaton:
    """Swings from 0 to 1.2 rad and is rigid there."""
    swing = revolute((0.0, 0.0, 1.0), (0.0, 0.0, 0.0), (plants.RADIUS, 0.0, 0.1))
    shut = forward(swing, plants.LENGTH)[0]
    held = rigid(shut.translation, shut.rotation.as_quat(), plants.LENGTH)

    def segment(joint: Joint, start: float, first: int) -> Segment:
        end = plants.LENGTH
        return Segment(joint, 0, first, first + 9, start, end, (start, end), 0.001, 0.003, 0.0, 1.0)

    edge = KinematicEdge(BASE, "door", (segment(swing, 0.0, 0), segment(held, plants.LENGTH, 10)))
    return build_automaton(KinematicGraph((edge,)))


def main(seeds: int = 5, runs: int = 10) -> None:
    model = door()
    print(
        "| plant | true effect | named first | verdicts | parameter error | error / floor | roll-out after / before |"
    )
    print("| --- | --- | --- | --- | --- | --- | --- |")
    for plant, (name, value) in TRUE.items():
        first, verdicts, errors, floors, ratios = 0, [], [], [], []
        for seed in range(100, 100 + seeds):
            recording = plants.door_recording(plants.runs_of(getattr(plants, plant), runs, 50, seed))
            found = calibrate(model, recording)
            named = found.effects[0].effect if found.effects else None
            is_first = (named.name if named else "none") == name
            first += is_first
            verdicts.append(found.verdict)
            if is_first and named is not None and value is not None:
                errors.append(abs(named.values[0] / value - 1.0))
            floors.append(found.after.one_step / found.noise_floor)
            ratios.append(found.after.rollout / found.before.rollout)
        counts = ", ".join(f"{verdicts.count(v)} {v}" for v in dict.fromkeys(verdicts))
        error = f"{100 * np.mean(errors):.1f} %" if errors else ""
        cells = (plant, name, f"{first}/{seeds}", counts, error, f"{np.mean(floors):.2f}", f"{np.mean(ratios):.2f}")
        print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:3]))
