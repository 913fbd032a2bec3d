"""How often 95 % intervals of a learned model hold the truth, from 5 to 120 Hz, under five kinds of a tracker's noise.

    OMP_NUM_THREADS=1 python -m benchmarks intervals [--seeds K] [--first SEED] [--rates HZ ...] [--noises NAME ...]

A door or a drawer is moved for six seconds up to its end and pushed against that for three. Axis, centre and radius are
compared as in `fit_coverage.py`; `row` is the first row of the stop, of which a tracker that is late tells another one.
Intervals are of answers with the right segments; "sure, wrong" counts answers with other ones, said with 95 % or more.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from time import process_time

import numpy as np
from fit_coverage import QUANTILE, errors
from kinds_of_one_part import as_value
from kinds_plant import ROTATION_PER_POSITION, Floats, TrueJoint, random_joint, written_actions
from kinds_scoring import SURE, probability
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import KinematicEdge
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.value import Recording

MOVED, PUSHED = 6.0, 3.0  # s
WHITE = 0.001  # m
LAG, FORGOTTEN = 0.1, 2.0  # s
FAMILIES = ("axis", "center", "radius", "row")
NOISES = ("white", "quantised", "late", "drifting", "precise")


def noisy(values: Floats, noise: str, rate: float, rng: np.random.Generator) -> Floats:
    """Values (n, 3) as a tracker reads them: to 2 mm, with a lag of a tenth of a second, with a wander of 2 mm that is
    forgotten within two seconds, to a tenth of a millimetre."""
    if noise == "quantised":
        return np.round((values + 0.2 * WHITE * rng.standard_normal(values.shape)) / (2 * WHITE)) * 2 * WHITE
    read = values + (0.1 if noise == "precise" else 1.0) * WHITE * rng.standard_normal(values.shape)
    if noise == "late":
        return filtered(read, float(np.exp(-1.0 / (LAG * rate))))
    if noise == "drifting":
        kept = float(np.exp(-1.0 / (FORGOTTEN * rate)))
        steps = rng.standard_normal(values.shape)
        steps[1:] /= np.sqrt((1 - kept) / (1 + kept))
        read += 2 * WHITE * filtered(steps, kept)
    return read


def filtered(values: Floats, kept: float) -> Floats:
    found = values.copy()
    for i in range(1, len(found)):
        found[i] = kept * found[i - 1] + (1 - kept) * found[i]
    return found


def recording_of(kind: str, rate: float, noise: str, seed: int) -> tuple[Recording, TrueJoint, int]:
    """A recording, its joint, and the last row of motion."""
    rng = np.random.default_rng([seed, int(rate), len(kind)])
    joint, travel = random_joint(kind, rng, np.array([0.6, 0.1, 0.3]))
    rows, pushed = round(MOVED * rate), round(PUSHED * rate)
    slow = np.convolve(rng.standard_normal(rows + 2 * rows // 6), np.ones(rows // 6), "valid")[:rows] / rows**0.5
    pace = np.exp(0.5 * slow)
    asked = np.concatenate([1.02 * travel * pace / pace.sum(), np.full(pushed, travel / rows)])
    c, configuration, command = 0.0, [0.0], []
    for step in asked:
        command.append(step * joint.tangent(c))
        c = float(np.minimum(c + step * (1 + 0.05 * rng.standard_normal()), travel))
        configuration.append(c)
    arrived = int(np.argmax(np.array(configuration) >= travel))
    position, rotation = joint.poses(np.array(configuration))
    # One scale for both, in the units of the positions.
    turned = Rotation.from_matrix(rotation[0].T @ rotation).as_rotvec() / ROTATION_PER_POSITION
    read = noisy(turned, noise, rate, rng) * ROTATION_PER_POSITION
    quaternion = (Rotation.from_matrix(rotation[0]) * Rotation.from_rotvec(read)).as_quat()
    position = noisy(position, noise, rate, rng)
    action = written_actions(np.array(command), Rotation.identity(), 1.0, 0, 0.03, rng)
    recording = Recording(np.arange(len(position)) / rate, position, quaternion, action)
    return recording, joint, arrived


def held(edge: KinematicEdge, joint: TrueJoint, arrived: int) -> Iterator[tuple[str, bool]]:
    """Per number, its family and whether its interval holds the truth."""
    moving, rest = edge.segments
    for name, error, std in zip(*errors(as_value(joint), moving.joint), strict=True):
        family = name.partition("_")[0]
        if family in FAMILIES:
            yield family, bool(abs(error) < QUANTILE * std)
    if rest.certainty is not None and rest.certainty.start is not None:
        low, high = rest.certainty.start.interval()
        yield "row", low <= arrived + 1 and high >= arrived


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="recordings of either kind")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--rates", type=float, nargs="+", default=[5.0, 20.0, 60.0, 120.0])
    parser.add_argument("--noises", nargs="+", choices=NOISES, default=NOISES)
    given = parser.parse_args()
    print(
        f"{'noise':<12}{'Hz':>5}{'right':>8}{'sure, wrong':>13}"
        + "".join(f"{f:>10}" for f in FAMILIES)
        + f"{'CPU s':>8}"
    )
    for name in given.noises:
        for rate in given.rates:
            found: dict[str, list[bool]] = {family: [] for family in FAMILIES}
            right, wrong, count, begin = 0, 0, 0, process_time()
            for kind in ("revolute", "prismatic"):
                for seed in range(given.first, given.first + given.seeds):
                    recording, joint, arrived = recording_of(kind, rate, name, seed)
                    (edge,) = learn_graph(recording).edges
                    count += 1
                    sure = min(probability(one) for one in edge.segments)
                    if tuple(one.joint.kind for one in edge.segments) == (kind, "rigid"):
                        right += 1
                        for family, ok in held(edge, joint, arrived):
                            found[family].append(ok)
                    else:
                        wrong += sure >= SURE
            took = (process_time() - begin) / count
            shares = "".join(f"{f'{sum(one)}/{len(one)}':>10}" for one in found.values())
            print(f"{name:<12}{rate:>5g}{f'{right}/{count}':>8}{wrong:>13}{shares}{took:>8.2f}", flush=True)


if __name__ == "__main__":
    main()
