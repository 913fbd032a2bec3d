"""Whether probabilities are right: of what is said with 0.9, nine in ten should be true.

    python -m benchmarks reliability [--trials 150] [--seed 0]

Joints of random kind, travel and place are moved by a hand at an uneven pace under trackers of random noise, white and
wandering, with or without orientations. Every second one is then held for a random time. Short travels, short stops and
much noise leave open which joint it was and whether it stopped. The table bins what was said, for every number of
changepoints and for every kind of the segment that moves, and counts how often it was true.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from calibration import AXIS, POSITION_STD, RATE, ROTATION_STD, TURN
from fit_coverage import wandering
from scipy.spatial.transform import Rotation
from simulated_hand import slow

from micah_plan.automaton.joint import Joint, JointKind, prismatic, revolute, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.learn.learn import learn_graph
from micah_plan.learn.settings import LearnSettings
from micah_plan.recording.value import Recording

EDGES = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0])
KINDS: tuple[JointKind, ...] = ("prismatic", "revolute", "screw")
# One in a hundred joints is a screw (docs/concepts/learning.md); more of them would be another world.
SHARES = (0.495, 0.495, 0.01)
SETTINGS = LearnSettings()


@dataclass(frozen=True)
class Drawn:
    """A recording and its truth: the kind of the joint that moves, and how many changepoints there are."""

    recording: Recording
    kind: JointKind
    changepoints: int


def drawn(seed: int, orientation: bool) -> Drawn:
    """One random recording of 60 to 200 rows."""
    rng = np.random.default_rng([7, seed])
    kind = KINDS[rng.choice(len(KINDS), p=SHARES)]
    moved, held = int(rng.integers(50, 150)), int(rng.integers(4, 50)) * int(rng.integers(2))
    joint, travel = _joint(kind, rng)
    pace = np.exp(0.25 * slow(rng, moved, 8))
    c = np.concatenate([[0.0], travel * np.cumsum(pace) / pace.sum(), np.full(held, travel)])
    poses = forward(joint, c)
    size, wander = 10 ** rng.uniform(0.0, 0.7), rng.uniform(0.0, 1.5)
    noise = size * (rng.standard_normal((len(c), 6)) + wander * wandering(len(c), rng.uniform(3.0, 30.0), rng))
    # A slow wander as the learner expects it of trackers: to it, slow motions are always a little in doubt.
    drift = rng.uniform(0.2, 1.0) * wandering(len(c), SETTINGS.wander_durations * len(c), rng)
    turns = ROTATION_STD * noise[:, :3] + SETTINGS.rotation_wander * drift[:, :3]
    shifts = POSITION_STD * noise[:, 3:] + SETTINGS.position_wander * drift[:, 3:]
    recording = Recording(
        time=np.arange(len(c)) / RATE,
        position=poses.translation + shifts,
        quaternion=(Rotation.from_rotvec(turns) * poses.rotation).as_quat() if orientation else None,
    )
    return Drawn(recording, kind, int(held > 0))


def _joint(kind: JointKind, rng: np.random.Generator) -> tuple[Joint, float]:
    """A joint and how far it is moved [m or rad]: from a hardly visible motion to a wide one."""
    at = np.array([0.5, 0.1, 0.3])
    arm = np.cross(AXIS, rng.standard_normal(3))
    center = at - rng.uniform(0.15, 0.5) * arm / np.linalg.norm(arm)
    if kind == "prismatic":
        return prismatic(AXIS, at, TURN.as_quat()), float(10 ** rng.uniform(-1.3, -0.4))
    travel = float(10 ** rng.uniform(-0.9, 0.2))
    if kind == "revolute":
        return revolute(AXIS, center, at, TURN.as_quat()), travel
    return screw(AXIS, center, 0.1, at, TURN.as_quat()), travel


def said(one: Drawn) -> Iterator[tuple[str, float, bool]]:
    """What learning says of it: the question, the probability, and whether it is true."""
    edge = learn_graph(one.recording, method="champ").edges[0]
    for count, probability in enumerate(edge.certainty.changepoint_counts[0] if edge.certainty else ()):
        yield "changepoints", probability, count == one.changepoints
    moving = max(edge.segments, key=lambda s: (s.joint.kind != "rigid", s.end - s.start))
    if moving.certainty is not None:
        for kind, probability in moving.certainty.kinds:
            yield "kind", probability, kind == one.kind


def print_table(question: str, found: list[tuple[float, bool]]) -> None:
    """How often was true what was said with about the same probability."""
    probability, true = (np.array(column, dtype=float) for column in zip(*found, strict=True))
    print(f"\n{question}\n{'said':>14} {'mean':>7} {'true':>7} {'times':>6}")
    for low, high in pairwise(EDGES.tolist()):
        inside = (probability >= low) & ((probability < high) | (high == 1.0))
        if inside.any():
            print(
                f"{low:5.2f} to {high:4.2f} {probability[inside].mean():8.3f} {true[inside].mean():7.3f}"
                f" {int(inside.sum()):6}"
            )
    print(f"Brier score {np.mean((probability - true) ** 2):.4f}")


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=150)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for orientation in (True, False):
        answers: dict[str, list[tuple[float, bool]]] = {}
        for trial in range(options.trials):
            for question, probability, true in said(drawn(options.seed * 100_000 + trial, orientation)):
                answers.setdefault(question, []).append((probability, true))
        for question, found in answers.items():
            print_table(f"{question}, {'poses' if orientation else 'positions alone'}", found)


if __name__ == "__main__":
    main()
