"""How far apart the parameters of one real joint are that different rows tell, in stds that were stated.

    python -m benchmarks repeated_joints [DATA] [--json FILE]

DATA has the folder `tracks`; without it ../shared/data (or $MICAH_DATA) is read. No truth is known, but two estimates
of one joint differ by a normal variable of the sum of their variances, if these are honest. Compared are

* recordings of one object, every pair: tilts of the axis and the radius. Their base frames differ: the robot was placed
  anew for each of them, upright, so the axis of a hinge may be compared and of a slide only how it rises;
* halves of one recording: rows on the one and on the other side of the middle of its range; what a real joint misses
  the ideal one by is not the same there;
* passes of one recording: rows before and after the part turned, where both go through most of the range.

`covered` is the share of differences below 1.96 stds; `factor` their root mean square in stds, by which these are too
small. `as stated` is the median std of one estimate [rad, m].
"""

from __future__ import annotations

import argparse
import os
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from pathlib import Path

import numpy as np
from fit_coverage import QUANTILE, errors
from saving import add_json, save_json

from micah_plan.automaton.joint import Joint, axis_basis
from micah_plan.learning.joints.final_fit import fit_joint
from micah_plan.learning.joints.parametrization import seen_by
from micah_plan.learning.learn import learn_graph
from micah_plan.recording.read import read_recording
from micah_plan.recording.value import Recording

DATA = Path(os.environ.get("MICAH_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
ONE_OBJECT = ("cabinet_one", "drawer_one", "iros_2010/drawer", "iros_2010/left_door")
"""Folders whose recordings show one object."""
UP = np.array([0.0, 0.0, 1.0])
FEWEST_ROWS = 20
MOST = 0.6
"""Share of the range that both passes go through."""
LENGTH = 0.2  # m/rad

Difference = tuple[str, float, float]
"""Of which parameter, how far in stds of the difference, and the std of one estimate."""


def moving_joint(recording: Recording) -> Joint | None:
    """The learned joint of the longest segment that moves."""
    segments = [one for one in learn_graph(recording).edges[0].segments if one.joint.covariance is not None]
    moving = [one for one in segments if one.joint.kind != "rigid"]
    return max(moving, key=lambda one: one.end - one.start).joint if moving else None


def differences(one: Joint, other: Joint, frames_differ: bool) -> Iterator[Difference]:
    """Axis, centre and radius of two estimates of one joint; of other base frames only what these leave."""
    if one.kind != other.kind:
        return
    sides = [errors(a, b) for a, b in ((other, one), (one, other))]
    stds = [dict(zip(names, std.tolist(), strict=True)) for names, _, std in sides]
    names, missed, _ = sides[0]
    for name, error in zip(names, missed.tolist(), strict=True):
        family = name.partition("_")[0]
        if family in ("axis", "radius") or (family == "center" and not frames_differ):
            if frames_differ and one.kind == "prismatic":
                continue
            yield family, error / np.hypot(stds[0][name], stds[1][name]), stds[0][name]
    if frames_differ and one.kind == "prismatic":
        rise = [float(np.sign(joint.axis[0]) * (UP @ joint.axis)) for joint in (one, other)]
        std = [_tilt_std(joint, UP) for joint in (one, other)]
        yield "axis rises", (rise[0] - rise[1]) / np.hypot(*std), std[0]


def _tilt_std(joint: Joint, towards: np.ndarray) -> float:
    """Std of the component of the axis in a direction."""
    if joint.covariance is None:
        return 0.0
    # A tilt about b1 moves the axis against b2, one about b2 along b1.
    slope = np.array([-1.0, 1.0]) * (axis_basis(joint.axis)[::-1] @ towards)
    return float(np.sqrt(slope @ np.array(joint.covariance.matrix)[:2, :2] @ slope))


def fitted(guess: Joint, recording: Recording, rows: np.ndarray) -> Joint | None:
    """The joint of some rows; None if they do not tell it."""
    if len(rows) < FEWEST_ROWS:
        return None
    quaternion = None if recording.quaternion is None else recording.quaternion[rows]
    position, time = recording.position[rows], recording.time[rows]
    joint = fit_joint(guess, position, quaternion, time, np.ones(len(rows))).joint
    return joint if joint.covariance is not None else None


def parted(joint: Joint, recording: Recording) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Rows of both halves of the range, and of both passes through it."""
    c = seen_by(joint, recording.position, recording.quaternion, LENGTH).configuration
    low, high = np.quantile(c, (0.02, 0.98))
    rows = np.arange(len(c))
    yield "halves", rows[c <= 0.5 * (low + high)], rows[c > 0.5 * (low + high)]
    turn = int(np.argmax(np.abs(c - c[0])))
    if all(len(pass_) and np.ptp(pass_) >= MOST * (high - low) for pass_ in (c[:turn], c[turn:])):
        yield "passes", rows[:turn], rows[turn:]


def line(what: str, family: str, found: list[tuple[float, float]]) -> str:
    away, std = np.array(found).T
    covered = np.abs(away) < QUANTILE
    return (
        f"{what:40} {family:10} {len(away):5} {covered.mean():8.2f} {np.sqrt(np.mean(away**2)):7.2f} "
        f"{np.median(std):10.4f}"
    )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="?", type=Path, default=DATA)
    add_json(parser)
    options = parser.parse_args()
    found: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    folders = sorted({path.parent for path in (options.data / "tracks").rglob("*.csv")})
    for folder in folders:
        name = str(folder.relative_to(options.data / "tracks"))
        recordings = [read_recording(path) for path in sorted(folder.glob("*.csv"))]
        joints = [moving_joint(recording) for recording in recordings]
        for recording, joint in zip(recordings, joints, strict=True):
            for what, first, second in parted(joint, recording) if joint is not None else ():
                one, other = fitted(joint, recording, first), fitted(joint, recording, second)
                for family, away, std in differences(one, other, False) if one and other else ():
                    found[f"{what} of {name}", family].append((away, std))
        known = [joint for joint in joints if joint is not None] if name in ONE_OBJECT else []
        for one, other in combinations(known, 2):
            for family, away, std in differences(one, other, True):
                found[f"pairs of {name}", family].append((away, std))
    print(f"{'compared':40} {'parameter':10} {'count':>5} {'covered':>8} {'factor':>7} {'as stated':>10}")
    for (what, family), values in sorted(found.items()):
        print(line(what, family, values))
    save_json(
        [{"compared": key[0], "parameter": key[1], "away": values} for key, values in found.items()], options.json
    )


if __name__ == "__main__":
    main()
