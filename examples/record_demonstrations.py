"""Make the demonstrations that the project ships: a hand moves a microwave, a drawer and more, in MuJoCo.

    python examples/record_demonstrations.py [FOLDER]

writes one CSV per object, by default into examples/demonstrations, and into logs beside it the microwave as another
laboratory would have logged it. The same seed gives the same files. As in the paper's "with grasp" case, the hand holds
the handle, a tracker measures the part's pose at 18 Hz, and the action is the displacement of the part that the hand
asked for, also while the shut door does not give way.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from objects import DOOR_OPEN, LID_OPEN, STAPLER_OPEN, cabinet, drawer, lidded_box, microwave, stapler
from scipy.spatial.transform import Rotation

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.execution.mujoco.parameters import PhysicalParameters
from micah_plan.execution.mujoco.standing import StandingPlant
from micah_plan.execution.pose import command
from micah_plan.recording.csv_file import write_csv
from micah_plan.recording.value import Recording
from micah_plan.task.start import Start

Floats = NDArray[np.float64]

RATE = 18.0
TRACKER = {"position_noise": 0.0015, "rotation_noise": 0.01}


def demonstration(automaton: HybridAutomaton, targets: Floats, seed: int) -> Recording:
    """Lead the object along target configurations and record it.

    Args:
        automaton: the true object; it starts at configuration 0.
        targets: (k, n) or, with one coordinate, (k,) where the hand wants the object to be after each step [rad or m];
            it may be where the object cannot go, and then the hand presses.
        seed: of the tracker's noise.

    Returns:
        k + 1 rows per part, sorted by time.
    """
    # The hand follows its targets without a stop, hence motion_share 1.
    parameters = PhysicalParameters(control_period=1 / RATE, motion_share=1.0, **TRACKER)
    still = (0.0,) * automaton.n
    plant = StandingPlant(automaton, Start(still, still), parameters)
    measurements = [plant.reset(np.random.default_rng(seed))]
    actions = []
    moving = automaton.modes[0].name
    for target in targets.reshape(-1, automaton.n):
        felt = plant.truth().x
        order = command(automaton, moving, felt, target - felt)
        measurements.append(plant.apply(order))
        actions.append(order.origin)
    plant.close()
    rows, parts = len(measurements), tuple(link.child for link in automaton.links)
    return Recording(
        time=_short(np.repeat(np.arange(rows) / RATE, len(parts))),
        position=_short(np.concatenate([m.position for m in measurements])),
        quaternion=_short(np.concatenate([m.quaternion for m in measurements])),
        action=_short(np.concatenate([*actions, np.full((len(parts), 3), np.nan)])),
        force=_short(np.concatenate([m.force for m in measurements if m.force is not None])),
        part=parts * rows,
        has_part=True,
    )


def _short(values: Floats) -> Floats:
    """Rounded to 9 significant digits: all that a tracker could mean, and small files."""
    return np.array([float(f"{value:.9g}") for value in np.ravel(values)]).reshape(np.shape(values))


def stroke(distance: float, duration: float, seed: int) -> Floats:
    """Targets of a hand that moves `distance` [rad or m] in `duration` [s], nearly evenly, with some tremor."""
    rng = np.random.default_rng(seed)
    steps = round(duration * RATE)
    s = np.linspace(0.0, 1.0, steps + 1)
    speed = np.minimum(1.0, np.minimum((s + 0.02) / 0.12, (1.0 - s + 0.05) / 0.15))
    tremor = np.convolve(rng.standard_normal(steps + 1), np.ones(5) / 5, mode="same")
    speed = speed * (1.0 + 0.15 * tremor)
    return np.asarray(distance * np.cumsum(speed[1:]) / speed[1:].sum())


def press(at: float, depth: float, duration: float, seed: int) -> Floats:
    """Targets of a hand that goes on pushing `depth` [rad or m] beyond `at`, with varying strength."""
    rng = np.random.default_rng(seed)
    steps = round(duration * RATE)
    sway = np.convolve(rng.standard_normal(steps + 6), np.ones(7) / 7, mode="valid")
    return np.asarray(at + depth * (1.0 + 0.4 * sway))


def shut_microwave(seed: int = 1) -> Recording:
    """A door swung shut from 1.2 rad in about 4.5 s, then pressed for 2.5 s."""
    targets = np.concatenate([stroke(DOOR_OPEN, 4.6, seed), press(DOOR_OPEN, 0.025, 2.6, seed + 1)])
    return demonstration(microwave(), targets, seed)


def pull_drawer(seed: int = 2) -> Recording:
    """A drawer pulled out by 0.28 m in 5 s."""
    return demonstration(drawer(), stroke(0.28, 5.0, seed), seed)


def use_cabinet(seed: int = 3) -> Recording:
    """A drawer pulled out by 0.25 m in 2.5 s; then the door below is shut in 2.5 s and pressed for 1.2 s."""
    pull, shut = stroke(0.25, 2.5, seed), stroke(DOOR_OPEN, 2.5, seed + 1)
    pressed = press(DOOR_OPEN, 0.025, 1.2, seed + 2)
    door = np.concatenate([np.zeros(len(pull)), shut, pressed])
    drawer_out = np.concatenate([pull, np.full(len(shut) + len(pressed), pull[-1])])
    return demonstration(cabinet(), np.stack([door, drawer_out], axis=1), seed)


def close_stapler(seed: int = 4) -> Recording:
    """A stapler pressed shut from 0.55 rad in 4.5 s, then pressed for 2.5 s."""
    targets = np.concatenate([stroke(STAPLER_OPEN, 4.5, seed), press(STAPLER_OPEN, 0.03, 2.5, seed + 1)])
    return demonstration(stapler(), targets, seed)


def shut_lid(seed: int = 5) -> Recording:
    """A lid shut from 0.9 rad in 4.5 s, then pressed for 2.5 s."""
    targets = np.concatenate([stroke(LID_OPEN, 4.5, seed), press(LID_OPEN, 0.03, 2.5, seed + 1)])
    return demonstration(lidded_box(), targets, seed)


def as_a_lab_logs(recording: Recording) -> str:
    """The poses and actions of a recording as the CSV of a laboratory: milliseconds, millimetres, y upwards, scalar
    first; `laboratory.conventions.yaml` beside it says so."""
    upright = Rotation.from_euler("x", -90, degrees=True)
    turned = (upright * Rotation.from_quat(recording.quaternion)).as_quat()
    position, action = (1e3 * v[:, [0, 2, 1]] * (1.0, 1.0, -1.0) for v in (recording.position, recording.action))
    rows = np.column_stack([1e3 * recording.time, position, turned[:, [3, 0, 1, 2]], action])
    lines = ["stamp_ms,TX,TY,TZ,QW,QX,QY,QZ,dX,dY,dZ"]
    lines += [",".join("" if np.isnan(value) else f"{value:.6g}" for value in row) for row in rows]
    return "\n".join(lines) + "\n"


def main() -> None:
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "demonstrations"
    folder.mkdir(parents=True, exist_ok=True)
    made = {
        "microwave.csv": shut_microwave(),
        "drawer.csv": pull_drawer(),
        "cabinet.csv": use_cabinet(),
        "stapler.csv": close_stapler(),
        "box.csv": shut_lid(),
    }
    for name, recording in made.items():
        write_csv(recording, folder / name)
        print(f"{folder / name}: {len(recording)} rows")
    logs = folder.parent / "logs"
    logs.mkdir(exist_ok=True)
    (logs / "laboratory.csv").write_text(as_a_lab_logs(made["microwave.csv"]), encoding="utf-8")


if __name__ == "__main__":
    main()
