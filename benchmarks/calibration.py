"""How often learning is right, and how often it says so: rates over simulated recordings.

    python -m benchmarks calibration [--trials 20] [--seed 0]

1. Motion that no single joint holds: how often the answer is "no single-joint model fits".
2. Joints under trackers that wander: how often that answer is a false alarm, and how often the stop is found.
3. Where the stop is: how often the 95 % interval holds it, and how wide it is, if the posterior of the row is raised to
   a power (1 is what is reported; 1/2 is the power at which joints are compared).
"""

from __future__ import annotations

import argparse

import numpy as np
from fit_coverage import wandering
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Rotation
from simulated_hand import slow

from micah_plan.automaton.graph import RowPosterior, Segment
from micah_plan.automaton.joint import Joint, prismatic, revolute, screw
from micah_plan.automaton.kinematics import forward
from micah_plan.learn.learn import Method, learn_graph
from micah_plan.recording.value import Recording

RATE = 18.0  # Hz
POSITION_STD, ROTATION_STD = 0.001, 0.006  # m, rad; white, and of the wander in units of it
AXIS = np.array([0.36, 0.48, 0.8])
TURN = Rotation.from_rotvec([0.4, -0.3, 0.9])
JOINTS: dict[str, tuple[Joint, float]] = {
    "prismatic": (prismatic(AXIS, (0.5, 0.1, 0.3), TURN.as_quat()), 0.25),
    "revolute": (revolute(AXIS, (0.2, 0.3, 0.1), (0.5, 0.1, 0.3), TURN.as_quat()), 0.9),
    "screw": (screw(AXIS, (0.4, 0.2, 0.2), 0.12, (0.5, 0.1, 0.3), TURN.as_quat()), 1.2),
}
FREE = ("plane", "turning plane", "ball", "sliding door on a hinge", "deforming path", "free hand")
POWERS = (0.5, 1.0, 2.0)
# Row of the stop, rows held after it, noise in `POSITION_STD`, wander in the noise, its memory in rows. Where the part
# passes several stds of noise in a row, one row of the interval holds nearly everything, and coverage is above 95 %.
CASES = (
    (70, 40, 1.0, 0.0, 1.0),
    (70, 40, 1.0, 1.0, 5.0),
    (70, 40, 1.0, 1.0, 40.0),
    (70, 40, 1.0, 2.5, 15.0),
    (280, 160, 1.0, 0.0, 1.0),
    (280, 160, 4.0, 0.0, 1.0),
    (280, 160, 1.0, 1.0, 10.0),
    (280, 160, 1.0, 1.0, 60.0),
    (280, 160, 1.0, 2.5, 60.0),
)


def measured(
    position: np.ndarray,
    rotation: Rotation,
    rng: np.random.Generator,
    wander: float,
    memory: float,
    orientation: bool,
    scale: float = 1.0,
) -> Recording:
    """Poses as a tracker sees them: white noise, and a wander of so many times its std with a memory in rows."""
    n = len(position)
    noise = scale * (rng.standard_normal((n, 6)) + (wander * wandering(n, memory, rng) if wander else 0.0))
    turned = Rotation.from_rotvec(ROTATION_STD * noise[:, :3]) * rotation
    return Recording(
        time=np.arange(n) / RATE,
        position=position + POSITION_STD * noise[:, 3:],
        quaternion=turned.as_quat() if orientation else None,
    )


def free_recording(motion: str, seed: int, orientation: bool, rows: int = 120) -> Recording:
    """A motion of `FREE`, in a random frame, by a hand that wanders smoothly over about 15 cm and 0.5 rad."""
    rng = np.random.default_rng([2, seed])
    base = Rotation.from_quat(rng.standard_normal(4))
    a, b, c, d, e, f = (gaussian_filter1d(slow(rng, rows + 60, 25), 4)[30:-30] for _ in range(6))
    zero = np.zeros(rows)
    about_z = np.stack([zero, zero, 0.6 * c], axis=1)
    turn = {
        "plane": np.zeros((rows, 3)),
        "turning plane": about_z,
        "ball": 0.5 * np.stack([a, b, c], axis=1),
        "sliding door on a hinge": about_z,
        "free hand": 0.5 * np.stack([d, e, f], axis=1),
    }
    if motion == "deforming path":
        angle = np.linspace(0.0, 1.5, rows)
        radius = 0.3 * (1 + 0.5 * np.sin(3 * angle))
        position = np.stack([radius * np.cos(angle), radius * np.sin(angle), 0.06 * np.sin(5 * angle)], axis=1)
        rotation = Rotation.from_rotvec(np.outer(angle + 0.4 * np.sin(4 * angle), [0, 0, 1]))
    else:
        rotation = Rotation.from_rotvec(turn[motion])
        position = {
            "plane": 0.15 * np.stack([a, b, zero], axis=1),
            "turning plane": 0.15 * np.stack([a, b, zero], axis=1),
            "ball": rotation.apply([0.25, 0.05, 0.1]),
            "sliding door on a hinge": rotation.apply(np.stack([0.4 + 0.12 * a, zero, zero], axis=1)),
            "free hand": 0.15 * np.stack([a, b, c], axis=1),
        }[motion]
    return measured(base.apply(position), base * rotation, rng, 1.0, 10.0, orientation)


def joint_recording(
    kind: str,
    seed: int,
    wander: float,
    memory: float,
    stop: int = 70,
    held: int = 40,
    orientation: bool = True,
    noise: float = 1.0,
) -> Recording:
    """A joint moved at an uneven pace to where it is held from row `stop` on, without actions."""
    rng = np.random.default_rng([3, seed])
    joint, travel = JOINTS[kind]
    pace = np.exp(0.25 * slow(rng, stop, 8))
    c = np.concatenate([[0.0], travel * np.cumsum(pace) / pace.sum(), np.full(held, travel)])
    poses = forward(joint, c)
    return measured(poses.translation, poses.rotation, rng, wander, memory, orientation, noise)


def segments_of(recording: Recording, method: Method = "act-champ") -> tuple[Segment, ...]:
    return learn_graph(recording, method=method).edges[0].segments


def fit_no_joint(segments: tuple[Segment, ...]) -> bool:
    return any(s.certainty is not None and s.certainty.no_single_joint is not None for s in segments)


def raised(posterior: RowPosterior, power: float) -> RowPosterior:
    weights = np.array(posterior.probabilities) ** power
    return RowPosterior(posterior.rows, tuple((weights / weights.sum()).tolist()))


def print_free(trials: int) -> None:
    print(f"{'motion':26} {'poses':>9} {'positions':>10}   said: no single joint fits")
    for motion in FREE:
        found = [
            sum(fit_no_joint(segments_of(free_recording(motion, seed, orientation))) for seed in range(trials))
            for orientation in (True, False)
        ]
        print(f"{motion:26} {found[0]:4} / {trials} {found[1]:5} / {trials}", flush=True)


def print_joints(trials: int, seed: int) -> None:
    print(
        f"\n{'joint':10} {'stop':>5} {'noise':>5} {'wander':>6} {'memory':>6} {'false alarms':>13} {'right':>9}"
        "   coverage (width) at powers"
    )
    for kind in JOINTS:
        for case in CASES:
            print_case(kind, *case, trials, seed)


def print_case(
    kind: str, stop: int, held: int, noise: float, wander: float, memory: float, trials: int, seed: int
) -> None:
    """One line: how often the stop is found, and how often the interval holds it."""
    alarms = right = 0
    hits: list[list[tuple[bool, int]]] = []
    for trial in range(seed * 100_000, seed * 100_000 + trials):
        segments = segments_of(joint_recording(kind, trial, wander, memory, stop, held, noise=noise))
        alarms += fit_no_joint(segments)
        right += [s.joint.kind for s in segments] == [kind, "rigid"]
        certainty = segments[1].certainty if len(segments) == 2 else None
        if certainty is not None and certainty.start is not None:
            ends = [raised(certainty.start, power).interval() for power in POWERS]
            # The row that arrives at the stop may be counted to either side.
            hits.append([(low <= stop + 1 and high >= stop, high - low + 1) for low, high in ends])
    shares = np.mean(np.array(hits, dtype=float).reshape(-1, len(POWERS), 2), axis=0)
    told = "  ".join(f"{p:g}: {share:.2f} ({width:.1f})" for p, (share, width) in zip(POWERS, shares, strict=True))
    print(
        f"{kind:10} {stop:5} {noise:5.1f} {wander:6.1f} {memory:6.0f} {alarms:6} / {trials:4} {right:4} / {trials}"
        f"   {told}",
        flush=True,
    )


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print_free(options.trials)
    print_joints(options.trials, options.seed)


if __name__ == "__main__":
    main()
