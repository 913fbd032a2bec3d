"""How many stops are found where a part is opened, pushed against its end, shut and pushed against that, several times.

    OMP_NUM_THREADS=1 python -m benchmarks cycles [--cycles N ...] [--seeds K] [--first SEED]

Doors and drawers with an end on either side, 30 to 50 rows of motion each way and 15 to 30 rows of pushing, in the
variants of the table; some are left alone for longer than they move. A stop is found if a rigid segment begins within
six rows of it; more rigid segments than stops are "too many". An answer is surely wrong if it is said with 95 % or more
and its segments are others.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from time import process_time

import numpy as np
from kinds_plant import RATE, Floats, random_joint, tracker_noise, written_actions
from kinds_scoring import SURE, kinds_of, probability
from scipy.spatial.transform import Rotation

from micah_plan.automaton.build import build_automaton, no_single_joint_error
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

NEAR = 6


@dataclass(frozen=True)
class Variant:
    """Noise of the tracker [m], and of the actions: their gain, how they are turned [rad] and how late they are; the
    share by which the part slips; whether it is pushed against its ends, or moved between them only; whether its
    orientation is measured; how fast it is pushed, of how fast it is moved; how many times slower than shut it is
    opened; for how many rows it is left alone before the first motion, at the first end and at last; of how many
    actions one is not logged (0: none is missing), and for how many rows each is."""

    white: float = 0.001
    gain: float = 1.0
    turned: float = 0.0
    late: int = 0
    slip: float = 0.05
    pushed: bool = True
    oriented: bool = True
    softly: float = 1.0
    slow: int = 1
    alone: tuple[int, int, int] = (0, 0, 0)
    lost: int = 0
    held: int = 1


VARIANTS = {
    "plain": Variant(),
    "no noise": Variant(white=0.0),
    "3 mm": Variant(white=0.003),
    "actions halved": Variant(gain=0.5),
    "turned by 30 degrees": Variant(turned=np.pi / 6),
    "late by 2 rows": Variant(late=-2),
    "positions alone": Variant(oriented=False),
    "not pushed": Variant(pushed=False),
    "pushed a fifth as fast": Variant(softly=0.2),
    "opened 8 times slower": Variant(slow=8),
    "1 of 25 actions lost": Variant(lost=25),
    "actions held 3 rows": Variant(held=3),
    "1,000 rows before": Variant(alone=(1000, 0, 0)),
    "1,000 rows at an end": Variant(alone=(0, 1000, 0)),
    "1,000 rows after": Variant(alone=(0, 0, 1000)),
    "all three, not pushed": Variant(pushed=False, alone=(1000, 1000, 1000)),
}


def recording_of(kind: str, cycles: int, variant: Variant, seed: int) -> tuple[Recording, list[int]]:
    """A recording, and the last rows of motion, at which the part arrives at an end."""
    rng = np.random.default_rng([seed, cycles, len(kind)])
    joint, travel = random_joint(kind, rng, np.array([0.6, 0.1, 0.3]))
    before, between, after = (np.zeros(rows) for rows in variant.alone)
    asked: list[Floats] = [before]
    for half in range(2 * cycles):
        rows, pushed = int(rng.integers(30, 51)), int(rng.integers(15, 31)) if variant.pushed else 0
        sign = 1.0 if half % 2 == 0 else -1.0
        pace = np.exp(0.2 * rng.standard_normal(rows if half % 2 else rows * variant.slow))
        far = 1.02 if variant.pushed else 0.9
        asked += [sign * far * travel * pace / pace.sum(), np.full(pushed, variant.softly * sign * travel / rows)]
        asked += [between] if half == 0 else []
    c, configuration, command, stops = 0.0, [0.0], [], []
    for step in np.concatenate([*asked, after]):
        reached = float(np.clip(c + step * (1 + variant.slip * rng.standard_normal()), 0.0, travel))
        command.append(step * joint.tangent(c))
        if variant.pushed and step and reached == c and (len(configuration) < 2 or configuration[-2] != c):
            stops.append(len(configuration) - 1)
        c = reached
        configuration.append(c)
    position, rotation = joint.poses(np.array(configuration))
    shifts, turns = tracker_noise(len(position), variant.white, 0.0, rng)
    axis = variant.turned * rng.standard_normal(3)
    frame = Rotation.from_rotvec(variant.turned * axis / max(float(np.linalg.norm(axis)), 1e-9))
    action = written_actions(np.array(command), frame, variant.gain, variant.late, 0.03, rng)
    action = action[np.arange(len(action)) // variant.held * variant.held]
    if variant.lost:
        action[np.flatnonzero(np.linalg.norm(command, axis=1) > 0)[5 :: variant.lost]] = 0.0
    quaternion = (Rotation.from_rotvec(turns) * Rotation.from_matrix(rotation)).as_quat()
    columns = position + shifts, quaternion if variant.oriented else None, action
    return Recording(np.arange(len(position)) / RATE, *columns), stops


@dataclass(frozen=True)
class Count:
    """Of one recording: stops found, in all and too many; whether it is surely wrong, and whether the model has the
    joint with both its stops, or without if it was not pushed; seconds; the answer."""

    found: int
    stops: int
    many: int
    wrong: bool
    modelled: bool
    seconds: float
    answer: str


def counted(kind: str, cycles: int, variant: Variant, seed: int) -> Count:
    recording, stops = recording_of(kind, cycles, variant, seed)
    begin = process_time()
    graph = learn_graph(recording)
    took = process_time() - begin
    (edge,) = graph.edges
    rests = [one.start for one in edge.segments if one.joint.kind == "rigid"]
    hits = sum(any(abs(start - stop) <= NEAR for start in rests) for stop in stops)
    kinds = kinds_of(edge.segments, True)
    right = kinds == ((kind, "rigid") * (2 * cycles) if variant.pushed else (kind,))
    sure = min(probability(one) for one in edge.segments)
    answer = " ".join(f"{one.joint.kind[:4]}{one.start}" for one in edge.segments)
    modes = [] if no_single_joint_error(graph) else [mode.name for mode in build_automaton(graph).modes]
    modelled = modes == (["rigid_1", kind, "rigid_2"] if variant.pushed else [kind])
    many = max(len(rests) - len(stops), 0)
    return Count(hits, len(stops), many, sure >= SURE and not right, modelled, took, answer)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cycles", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--variants", nargs="+", choices=list(VARIANTS), default=list(VARIANTS), metavar="NAME")
    parser.add_argument("--answers", action="store_true", help="print every answer")
    given = parser.parse_args()
    print(f"{'cycles':>6} {'variant':<22}{'found':>12}{'too many':>10}{'surely wrong':>14}{'models':>10}{'seconds':>9}")
    for cycles in given.cycles:
        for name in given.variants:
            variant = VARIANTS[name]
            seeds = range(given.first, given.first + given.seeds)
            rows = [counted(kind, cycles, variant, seed) for kind in ("revolute", "prismatic") for seed in seeds]
            if given.answers:
                print("\n".join(row.answer for row in rows))
            share = f"{sum(row.found for row in rows)} of {sum(row.stops for row in rows)}"
            wrong = f"{sum(row.wrong for row in rows)} of {len(rows)}"
            models = f"{sum(row.modelled for row in rows)} of {len(rows)}"
            took = np.mean([row.seconds for row in rows])
            many = sum(row.many for row in rows)
            print(f"{cycles:>6} {name:<22}{share:>12}{many:>10}{wrong:>14}{models:>10}{took:>9.2f}", flush=True)


if __name__ == "__main__":
    main()
