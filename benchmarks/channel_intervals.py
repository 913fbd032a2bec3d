"""How often 95 % intervals of a learned action channel hold the truth: gain, delay and frame of the actions.

    OMP_NUM_THREADS=1 python -m benchmarks channel_intervals [--seeds 25] [--first 0] [--motions NAME ...]

A door or a drawer follows actions that are scaled, turned and late, as a tracker with white noise sees it: opened and
shut smoothly, at a constant speed all along, with a pause, to and fro at drawn speeds, and driven by a servo of first
order that an encoder of 12 bits reads (its lag is a delay on average), told displacements, or places that jump, as logs
of joints with targets have them. `known` counts intervals that are narrower than
half the gain, or than a tenth of the duration: by the others nothing is claimed.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from kinds_of_one_part import as_value
from kinds_plant import Floats, TrueJoint, random_joint
from scipy.spatial.transform import Rotation
from true_channel import QUANTILE, TrueChannel, misses

from micah_plan.learning.learn import learn_graph
from micah_plan.recording.commands import with_targets
from micah_plan.recording.value import Recording

ROWS, RATE = 240, 30.0
COUNT = 2.0 * np.pi / 4096  # rad
NARROW_GAIN, NARROW_DELAY = 0.5, 0.1


def _smooth() -> Floats:
    s = np.clip(np.linspace(-0.1, 1.1, ROWS // 2), 0.0, 1.0)
    there = s * s * (3.0 - 2.0 * s)
    return np.concatenate([there, there[::-1]])


def _paused() -> Floats:
    third = ROWS // 3
    return np.concatenate([np.linspace(0, 0.5, third), np.full(third, 0.5), np.linspace(0.5, 1.0, ROWS - 2 * third)])


def _drawn(rng: np.random.Generator) -> Floats:
    knots = np.concatenate([[0.0], rng.uniform(0.0, 1.0, 7)])
    return np.interp(np.arange(ROWS), np.linspace(0, ROWS, len(knots)), knots)


def _jumping(rng: np.random.Generator) -> Floats:
    """Places that a servo is sent to, each for a while."""
    held = rng.integers(8, 40, ROWS // 8)
    return np.repeat(rng.uniform(0.0, 1.0, len(held)), held)[:ROWS]


MOTIONS: dict[str, Callable[[np.random.Generator], Floats]] = {
    "smooth": lambda _: _smooth(),
    "constant speed": lambda _: np.linspace(0.0, 1.0, ROWS),
    "with a pause": lambda _: _paused(),
    "drawn speeds": _drawn,
    "servo": _drawn,
    "servo, places": _jumping,
}


def recording_of(motion: str, seed: int) -> tuple[Recording, TrueChannel]:
    """A recording, and how its actions move the part."""
    rng = np.random.default_rng([seed, list(MOTIONS).index(motion)])
    kind = ("revolute", "prismatic")[seed % 2]
    joint, travel = random_joint(kind, rng, np.array([0.6, 0.1, 0.3]))
    meant = travel * MOTIONS[motion](rng)
    noise = rng.uniform(3e-4, 1.5e-3)
    if motion.startswith("servo"):
        lag = rng.uniform(0.5, 3.0)
        c = np.empty(ROWS)
        c[0] = meant[0]
        for k in range(1, ROWS):
            c[k] = c[k - 1] + (meant[k - 1] - c[k - 1]) * (1.0 - np.exp(-1.0 / lag))
        count = COUNT if kind == "revolute" else 1e-4
        late = 1.0 / (1.0 - np.exp(-1.0 / lag))  # mean of the shares of a step that are made in later rows
        read, gain, turn, noise = count * np.round(c / count), 1.0, Rotation.identity(), 0.0
    else:
        late = float(rng.choice([0.0, 0.0, rng.uniform(0.0, 4.0)]))
        gain, turn = np.exp(0.2 * rng.standard_normal()), Rotation.from_rotvec(rng.uniform(-0.4, 0.4, 3))
        c = np.interp(np.arange(ROWS) - late, np.arange(ROWS), meant)
        read = c
    places, turns = joint_poses(joint, read)
    position = places + noise * rng.standard_normal(places.shape)
    quaternion = (Rotation.from_rotvec(2.0 * noise * rng.standard_normal(places.shape)) * turns).as_quat()
    # The command is along the joint where the part will be when it follows.
    tangent = (joint_poses(joint, meant + 1e-5)[0] - joint_poses(joint, meant)[0]) / 1e-5
    action = np.full((ROWS, 3), np.nan)
    action[:-1] = turn.inv().apply(tangent[:-1] * np.diff(meant)[:, None]) / gain
    truth = TrueChannel(as_value(joint), turn, float(gain), late / RATE)
    recording = Recording(np.arange(ROWS) / RATE, position, quaternion, action)
    if motion == "servo, places":
        truth = replace(truth, delay=(late - 0.5) / RATE)  # since the place was told, not the middle of its row
        recording = with_targets(replace(recording, action=None), joint_poses(joint, meant)[0])
    return recording, truth


def joint_poses(joint: TrueJoint, c: Floats) -> tuple[Floats, Rotation]:
    """Positions (n, 3) and turns of the part at configurations (n,)."""
    position, turns = joint.poses(c)
    return position, Rotation.from_matrix(turns)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--motions", nargs="*", default=list(MOTIONS), choices=list(MOTIONS))
    asked = parser.parse_args()
    print("| motion | channels | frame held | gain held | known | delay held | known |")
    print("| --- " * 7 + "|")
    for motion in asked.motions:
        rows = []
        for seed in range(asked.first, asked.first + asked.seeds):
            recording, truth = recording_of(motion, seed)
            (edge,) = learn_graph(recording).edges
            if edge.certainty is not None and edge.certainty.channel is not None:
                rows.append(misses(truth, edge.certainty.channel))
        frame, gain, delay = (sum(bool(row[name]) for row in rows) for name in ("told", "gain", "delay"))
        known_gain, known_delay = (
            sum(2.0 * QUANTILE * row[name] < most for row in rows)
            for name, most in (("gain std", NARROW_GAIN), ("delay std", NARROW_DELAY * ROWS / RATE))
        )
        counts = (f"{len(rows)} of {asked.seeds}", frame, gain, known_gain, delay, known_delay)
        print(f"| {motion} | {' | '.join(map(str, counts))} |", flush=True)


if __name__ == "__main__":
    main()
