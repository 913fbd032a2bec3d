"""Random videos of doors and drawers: how often the 95 % intervals of axes and radii hold.

    python -m benchmarks video_intervals [--scenes 100] [--seed 0]

Each scene has its own object (a door of 0.15 to 0.35 m, a drawer), tags (35 to 80 mm), camera (0.6 to 1.3 m away, up to
50 degrees to the side and 35 above; on a stand or in a hand), blur and noise. The camera's file is right.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import micah_plan
from benchmarks.rendered_video import FRONT, HEIGHT, MATRIX, WIDTH, Face, film, looking, pulled, rigid, shutting
from micah_plan.api.tracking import track
from micah_plan.automaton.joint import Joint, axis_basis, radius, radius_std
from micah_plan.recording.tag_layout import PlacedTag, TagLayout
from micah_plan.vision.camera import Camera


@dataclass(frozen=True)
class Scene:
    """One random video, and what is true of it in the frame of the base's tag."""

    kind: str
    is_held: bool
    size: float
    faces: tuple[Face, Face]
    eye: np.ndarray
    swing: np.ndarray  # (3, 3): amplitudes [m], frequencies [rad/s], phases of a hand
    blur: float
    noise: float
    middle: np.ndarray
    axis: np.ndarray
    radius: float

    def camera(self, t: float) -> np.ndarray:
        sway, rate, phase = self.swing * np.array([[self.is_held], [1.0], [1.0]])
        at = self.middle + 0.3 * sway * np.sin(rate * t)
        return looking(self.middle + self.eye + sway * np.sin(rate * t + phase), at)


def scene(seed: int) -> Scene:
    rng = np.random.default_rng([seed, 57])
    # On the grid that textures are painted on, so that what is said is true: cells of 0.5 mm, places of 1 mm.
    size, far = 0.004 * float(rng.integers(9, 21)), float(rng.uniform(0.6, 1.3))
    side, up = np.deg2rad(rng.uniform(-50.0, 50.0)), np.deg2rad(rng.uniform(-10.0, 35.0))
    far = min(far, 20.0 * size)  # a tag of 38 px at least, seen from the front
    eye = far * np.array([np.sin(side) * np.cos(up), -np.cos(side) * np.cos(up), np.sin(up)])
    swing = np.stack([rng.uniform(0.02, 0.08, 3), rng.uniform(0.6, 1.5, 3), rng.uniform(0.0, 6.0, 3)])
    kind = "door" if rng.random() < 0.6 else "drawer"
    width = 0.001 * float(rng.integers(150, 351))
    if kind == "door":
        middle = np.array([0.5 * width - 0.35, -0.3 * width, 0.02])

        def moved(q: float) -> np.ndarray:
            hinge = rigid(Rotation.from_rotvec([0.0, 0.0, -q]), (-0.30, 0.0, 0.0))
            return hinge @ rigid(FRONT, (width, 0.0, 0.0))

        base = Face(1.0, 0.36, [(0, size, -0.37, 0.08)], lambda _: rigid(FRONT, (0.0, 0.005, 0.0)))
        part = Face(2.0 * width, 0.32, [(1, size, 0.0, -0.02)], moved, 120)
        axis, arm = np.array([0.0, 1.0, 0.0]), width
    else:
        base = Face(0.6, 0.6, [(0, size, 0.0, 0.2)], lambda _: rigid(FRONT, (0.0, 0.005, 0.0)))
        middle = np.array([0.0, -0.15, 0.08])
        place = 0.001 * float(rng.integers(-100, 101))
        part = Face(0.5, 0.2, [(1, size, place, 0.0)], lambda q: rigid(FRONT, (0.0, -0.005 - q, -0.02)), 120)
        axis, arm = np.array([0.0, 0.0, 1.0]), 0.0
    is_held = bool(rng.random() < 0.5)
    blur, noise = float(rng.uniform(0.4, 1.0)), float(rng.uniform(1.5, 5.0))
    return Scene(kind, is_held, size, (base, part), eye, swing, blur, noise, middle, axis, arm)


def z_scores(joint: Joint, truth: Scene) -> list[float]:
    """Tilts of the axis and, of a door, its radius: (found - true) / said std."""
    if joint.covariance is None:
        return []
    axis = np.array(joint.axis) * np.sign(float(np.dot(joint.axis, truth.axis)))
    off = np.cross(truth.axis, axis)  # the turn that takes the true axis there
    stds = dict(zip(joint.covariance.names, np.sqrt(np.diag(np.array(joint.covariance.matrix))), strict=True))
    basis = axis_basis(joint.axis)
    scores = [float(basis[k] @ off) / stds[f"axis_{k + 1}"] for k in range(2)]
    if truth.radius:
        scores.append((radius(joint) - truth.radius) / radius_std(joint))
    return scores


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0, help="number of the first scene")
    given = parser.parse_args()
    print(f"{'scene':>5} {'object':8}{'camera':8}{'px':>5}{'axis mrad':>10}{'radius mm':>10}  z: axis, axis, radius")
    held, kinds, scores = list[bool](), list[bool](), list[list[float]]()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(given.seed, given.seed + given.scenes):
            own, path = scene(number), Path(folder) / f"{number}.mp4"
            law = shutting if own.kind == "door" else pulled
            film(path, own.faces, law, own.camera, seconds=5.0, noise=own.noise, blur=own.blur, seed=number)
            layout = TagLayout("tag36h11", {0: PlacedTag("base", own.size), 1: PlacedTag(own.kind, own.size)})
            try:
                found = track(path, layout, camera=Camera(MATRIX, np.zeros(0), (WIDTH, HEIGHT)))
                segments = [one for edge in micah_plan.learn(found.recording).graph.edges for one in edge.segments]
            except micah_plan.InputError as error:
                print(f"{number:5} {own.kind:8} {error}", flush=True)
                continue
            joint = next((one.joint for one in segments if one.joint.moves), segments[0].joint)
            is_right = joint.kind == {"door": "revolute", "drawer": "prismatic"}[own.kind]
            kinds.append(is_right)
            width = MATRIX[0, 0] * own.size / float(np.linalg.norm(own.eye))
            text = f"{number:5} {own.kind:8}{'hand' if own.is_held else 'stand':8}{width:5.0f}"
            if not is_right:
                print(f"{text}  {joint.kind}", flush=True)
                continue
            z = z_scores(joint, own)
            held.append(own.is_held)
            scores.append(z)
            angle = float(np.arccos(min(abs(float(np.dot(joint.axis, own.axis))), 1.0)))
            off = 1e3 * (radius(joint) - own.radius) if own.radius else np.nan
            print(f"{text}{1e3 * angle:10.1f}{off:10.2f}  {' '.join(f'{one:6.2f}' for one in z)}", flush=True)
    print(f"kinds right in {sum(kinds)} of {len(kinds)}")
    for name, wanted in (("on a stand", False), ("in a hand", True)):
        own_scores = [z for z, is_held in zip(scores, held, strict=True) if is_held == wanted]
        tilts = np.abs([one for z in own_scores for one in z[:2]])
        radii = np.abs([z[2] for z in own_scores if len(z) > 2])
        print(
            f"{name}: 95 % intervals of tilts hold in {int((tilts < 1.96).sum())} of {len(tilts)}, "
            f"of radii in {int((radii < 1.96).sum())} of {len(radii)}"
        )


if __name__ == "__main__":
    main()
