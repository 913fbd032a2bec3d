"""Points tracked on articulated objects, simulated: how many bodies are found, and which point is on which.

    python -m benchmarks point_tracks [--seeds 3] [--noise 0.001 0.003 0.01]
    python -m benchmarks point_tracks --intervals [--seeds 50] [--noise 0.001 0.003]

Points lie in boxes on a door, a drawer, two drawers, a door above a drawer and a stapler of 16 cm; the camera stands or
moves; tracks are lost and found again, some wander off, some measurements are gross errors, and clutter stands around.
With --intervals the door and the drawer are learned: how often the 95 % intervals of their axes hold, in the camera of
the first frame.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from micah_plan.automaton.joint import axis_basis
from micah_plan.learning.learn import learn_graph
from micah_plan.vision.point_files import PointTracks
from micah_plan.vision.rigid_bodies import rigid_bodies
from micah_plan.vision.track_points import track_points

Floats = NDArray[np.float64]
FRAMES = 100


@dataclass(frozen=True)
class Moving:
    """A box of points, from its lowest to its highest corner [m], and its pose (4, 4) over the share of time."""

    low: Sequence[float]
    high: Sequence[float]
    pose: Callable[[float], Floats]


def eased(share: float) -> float:
    """From 0 to 1, beginning and ending slowly."""
    share = min(max(share, 0.0), 1.0)
    return share * share * (3.0 - 2.0 * share)


def _stands(share: float) -> Floats:
    del share
    return np.eye(4)


def _swings(most: float, hinge: Sequence[float], axis: Sequence[float], start: float, length: float):
    def pose(share: float) -> Floats:
        turn = Rotation.from_rotvec(-most * eased((share - start) / length) * np.asarray(axis)).as_matrix()
        found = np.eye(4)
        found[:3, :3], found[:3, 3] = turn, np.asarray(hinge) - turn @ np.asarray(hinge)
        return found

    return pose


def _slides(most: float, start: float, length: float):
    def pose(share: float) -> Floats:
        found = np.eye(4)
        found[1, 3] = -most * eased((share - start) / length)
        return found

    return pose


_CABINET = Moving((-0.3, 0.0, -0.3), (0.3, 0.4, 0.3), _stands)
SCENES: dict[str, list[Moving]] = {
    "door": [
        _CABINET,
        Moving((-0.25, -0.02, -0.15), (0.15, 0.0, 0.15), _swings(1.1, (-0.25, 0, 0), (0, 0, 1), 0.1, 0.7)),
    ],
    "drawer": [_CABINET, Moving((-0.25, -0.02, -0.1), (0.25, 0.3, 0.1), _slides(0.3, 0.1, 0.7))],
    "two drawers": [
        _CABINET,
        Moving((-0.25, -0.02, 0.02), (0.25, 0.2, 0.2), _slides(0.25, 0.05, 0.4)),
        Moving((-0.25, -0.02, -0.2), (0.25, 0.2, -0.02), _slides(0.25, 0.5, 0.4)),
    ],
    "door above a drawer": [
        _CABINET,
        Moving((-0.25, -0.02, 0.02), (0.15, 0.0, 0.28), _swings(1.0, (-0.25, 0, 0), (0, 0, 1), 0.05, 0.4)),
        Moving((-0.25, -0.02, -0.25), (0.25, 0.2, -0.02), _slides(0.25, 0.5, 0.4)),
    ],
    "stapler": [
        Moving((-0.09, -0.02, 0.0), (0.08, 0.02, 0.02), _stands),
        Moving((-0.08, -0.015, 0.03), (0.08, 0.015, 0.05), _swings(0.4, (-0.08, 0, 0.02), (0, 1, 0), 0.1, 0.7)),
    ],
}


def camera_turn(share: float, *, is_moving: bool = True) -> Rotation:
    """From the world to the camera at a share of the time."""
    at = 5.0 * share if is_moving else 0.0
    return Rotation.from_euler("zx", [0.25 * np.sin(at), 0.15 * np.sin(0.6 * at)])


def _generator(name: str, seed: int, noise: float) -> np.random.Generator:
    """Each object and noise has draws of its own, so that rows of a table are independent."""
    return np.random.default_rng([seed, sum(map(ord, name)), round(1e6 * noise)])


def tilt_held(name: str, seed: int, noise: float) -> tuple[bool, float] | None:
    """Whether the learned axis of the door or drawer is where its 95 % interval says, and its error [rad].

    None where there are other bodies or kinds than in the scene.
    """
    tracks, _ = simulated(SCENES[name], _generator(name, seed, noise), noise=noise)
    found = track_points(PointTracks(tracks), 30.0)
    if len(found.names) != 2:
        return None
    (edge,) = learn_graph(found.recording).edges
    kind, direction = {"door": ("revolute", (0.0, 0.0, 1.0)), "drawer": ("prismatic", (0.0, 1.0, 0.0))}[name]
    joint = next((one.joint for one in edge.segments if one.joint.kind == kind), None)
    if joint is None or joint.covariance is None:
        return None
    first = int(np.flatnonzero(found.bodies[0].is_seen)[0])
    truth = camera_turn(first / (FRAMES - 1)).apply(direction)
    # What the covariance has is turns about the two directions, not ways along them.
    off = axis_basis(joint.axis) @ np.cross(joint.axis, truth * np.sign(truth @ np.array(joint.axis)))
    tilts = [joint.covariance.names.index(f"axis_{k}") for k in (1, 2)]
    covariance = np.array(joint.covariance.matrix)[np.ix_(tilts, tilts)]
    return bool(off @ np.linalg.solve(covariance, off) < chi2.ppf(0.95, 2)), float(np.linalg.norm(off))


def print_intervals(seeds: int, noises: Sequence[float]) -> None:
    """How often intervals of axes hold."""
    print(f"{'object':10}{'noise mm':>9}{'held':>12}{'error mrad (median)':>22}")
    for name in ("door", "drawer"):
        for noise in noises:
            every = [found for seed in range(seeds) if (found := tilt_held(name, seed, noise)) is not None]
            held, error = sum(one for one, _ in every), float(np.median([off for _, off in every]))
            print(f"{name:10}{1e3 * noise:9.1f}{held:5} of {len(every)}{1e3 * error:18.1f}", flush=True)


def simulated(
    scene: Sequence[Moving],
    rng: np.random.Generator,
    *,
    points: int = 120,
    noise: float = 0.003,
    missing: float = 0.25,
    gross: float = 0.05,
    wandering: float = 0.05,
    is_moving: bool = True,
) -> tuple[Floats, NDArray[np.int64]]:
    """Tracks (N, T, 3) in the frame of the camera, NaN where lost, and the body of each point; -1: of none."""
    lost = round(wandering * points)
    each = np.array_split(np.arange(points - lost), len(scene))
    label = np.concatenate([np.full(len(own), k) for k, own in enumerate(each)] + [np.full(lost, -1)])
    shares = np.linspace(0.0, 1.0, FRAMES)
    tracks = np.zeros((points, FRAMES, 3))
    for moving, own in zip(scene, each, strict=True):
        places = rng.uniform(moving.low, moving.high, (len(own), 3))
        for t, share in enumerate(shares):
            pose = moving.pose(share)
            tracks[own, t] = places @ pose[:3, :3].T + pose[:3, 3]
    begun = rng.uniform(-0.3, 0.3, (lost, 1, 3))
    tracks[points - lost :] = begun + np.cumsum(rng.normal(0.0, 0.012, (lost, FRAMES, 3)), axis=1)
    for t, share in enumerate(shares):
        at = 5.0 * share if is_moving else 0.0
        turn = camera_turn(share, is_moving=is_moving)
        shift = [0.2 * np.sin(0.8 * at), 1.2 + 0.02 * at, 0.1 * np.sin(1.2 * at)]
        tracks[:, t] = turn.apply(tracks[:, t]) + shift
    tracks += rng.normal(0.0, noise, tracks.shape)
    bad = rng.random(tracks.shape[:2]) < gross
    tracks[bad] += rng.normal(0.0, 0.1, (int(bad.sum()), 3))
    for track in tracks:  # one gap, and single frames
        length = int(FRAMES * rng.uniform(0.0, 2.0 * missing))
        start = int(rng.integers(-length // 2, FRAMES - length // 2)) if length else 0
        track[max(start, 0) : max(start + length, 0)] = np.nan
    tracks[rng.random(tracks.shape[:2]) < 0.03] = np.nan
    return tracks, label


def share_right(found: Sequence[NDArray[np.int64]], label: NDArray[np.int64]) -> float:
    """Share of the points of bodies that are in the body which has most of their true body's."""
    right = 0
    for points in found:
        counts = np.bincount(label[points][label[points] >= 0], minlength=1)
        right += int(counts.max())
    return right / int((label >= 0).sum())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--points", type=int, default=120)
    parser.add_argument("--noise", nargs="*", type=float, default=[0.001, 0.003, 0.01])
    parser.add_argument("--intervals", action="store_true", help="how often intervals of axes hold")
    given = parser.parse_args()
    if given.intervals:
        print_intervals(given.seeds, given.noise)
        return
    print(f"{'object':22}{'noise mm':>9}{'bodies right':>14}{'points right':>14}{'CPU s':>8}")
    for name, scene in SCENES.items():
        for noise in given.noise:
            rights, shares, begun = 0, [], time.process_time()
            for seed in range(given.seeds):
                tracks, label = simulated(scene, _generator(name, seed, noise), points=given.points, noise=noise)
                bodies = rigid_bodies(tracks)
                rights += len(bodies) == len(scene)
                shares.append(share_right([body.points for body in bodies], label))
            cpu = (time.process_time() - begun) / given.seeds
            print(
                f"{name:22}{1e3 * noise:9.1f}{rights:8} of {given.seeds}{100 * np.mean(shares):13.0f}%{cpu:8.2f}",
                flush=True,
            )


if __name__ == "__main__":
    main()
