"""Videos of tagged objects, rendered: how precise poses, axes, radii and stops that `track` and `learn` find are.

    python -m benchmarks rendered_video [--seeds 3]
    python -m benchmarks rendered_video --example examples/video

Planes with tags are moved by a law and seen by a camera that is known: fixed or in a hand, with tags of 30 to 60 px,
with and without a camera file, one of them covered for half a second. Beside each number stands what was said of it
(95 %). With --example the video of the guide is written.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

import micah_plan
from micah_plan.api.tracking import track
from micah_plan.recording.tag_layout import PlacedTag, TagLayout
from micah_plan.recording.value import Recording
from micah_plan.vision.camera import Camera

WIDTH, HEIGHT, FOCAL = 960, 540, 760.0
MATRIX = np.array([[FOCAL, 0.0, 482.0], [0.0, FOCAL, 268.0], [0.0, 0.0, 1.0]])
PX_PER_M = 2000
BENT = np.array([-0.18, 0.06, 0.001, -0.001, 0.0])  # distortion of a cheap lens
FINER = 4  # pixels that one of the picture is the mean of, along each side


@dataclass(frozen=True)
class Face:
    """A plane with tags: x right, y up, z out of it; tags are (number, size [m], x, y)."""

    width: float
    height: float
    tags: Sequence[tuple[int, float, float, float]]
    pose: Callable[[float], np.ndarray]  # (4, 4) to the world at a configuration
    grey: int = 150


def rigid(turn: Rotation, place: Sequence[float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn.as_matrix(), place
    return pose


# A face that looks along -y of the world, with x to the right and y up.
FRONT = Rotation.from_matrix(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))


def eased(t: float) -> float:
    t = min(max(t, 0.0), 1.0)
    return t * t * (3.0 - 2.0 * t)


def door(size: float = 0.06, more: bool = False) -> list[Face]:
    """A door of 0.25 m to the middle of its tag, hinged on the left; configuration: how far it is open [rad]."""
    body = Face(0.62, 0.36, [(0, size, 0.24, 0.08)], lambda _: rigid(FRONT, (0.0, 0.005, 0.0)))
    tags = [(1, size, 0.02, -0.02), *([(11, size, -0.12, 0.08)] if more else [])]

    def turned(q: float) -> np.ndarray:
        hinge = rigid(Rotation.from_rotvec([0.0, 0.0, -q]), (-0.30, 0.0, 0.0))
        return hinge @ rigid(FRONT, (0.23, 0.0, 0.0))

    return [body, Face(0.44, 0.32, tags, turned, 120)]


def drawer(size: float = 0.06) -> list[Face]:
    """Configuration: how far it is pulled out [m]."""
    body = Face(0.6, 0.6, [(0, size, 0.0, 0.2)], lambda _: rigid(FRONT, (0.0, 0.005, 0.0)))
    return [body, Face(0.5, 0.2, [(1, size, 0.1, 0.0)], lambda q: rigid(FRONT, (0.0, -0.005 - q, -0.02)), 120)]


def cabinet(size: float = 0.052) -> list[Face]:
    """A drawer above a door; the configuration is the door's, the drawer follows where the door is half open."""
    body = Face(0.62, 0.6, [(0, size, 0.24, 0.2)], lambda _: rigid(FRONT, (0.0, 0.005, 0.0)))

    def turned(q: float) -> np.ndarray:
        hinge = rigid(Rotation.from_rotvec([0.0, 0.0, -q]), (-0.30, 0.0, 0.0))
        return hinge @ rigid(FRONT, (0.23, 0.0, -0.13))

    def pulled_out(q: float) -> np.ndarray:
        return rigid(FRONT, (-0.1, -0.005 - 0.3 * eased(2.0 * (1.0 - q)), 0.2))

    return [
        body,
        Face(0.44, 0.3, [(1, size, 0.02, 0.0)], turned, 120),
        Face(0.3, 0.14, [(2, size, 0.0, 0.0)], pulled_out, 90),
    ]


def stapler(size: float = 0.02) -> list[Face]:
    """Of 16 cm, seen from its side: the arm turns about a pin at the back; configuration: how far it is open [rad]."""
    body = Face(0.16, 0.03, [(0, size, -0.02, 0.0)], lambda _: rigid(FRONT, (0.0, 0.0, 0.0)))

    def turned(q: float) -> np.ndarray:
        pin = rigid(Rotation.from_rotvec([0.0, -0.5 * q, 0.0]), (-0.07, -0.002, 0.03))
        return pin @ rigid(FRONT, (0.08, 0.0, 0.0))

    return [body, Face(0.16, 0.028, [(1, size, 0.03, 0.0)], turned, 120)]


def looking(eye: Sequence[float], at: Sequence[float]) -> np.ndarray:
    """(4, 4) world to camera: x right, y down, z ahead."""
    ahead = np.subtract(at, eye) / np.linalg.norm(np.subtract(at, eye))
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    turn = np.stack([right, np.cross(ahead, right), ahead])
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, -turn @ np.asarray(eye, dtype=float)
    return pose


def hand_held(t: float) -> np.ndarray:
    eye = np.add((-0.3, -0.95, 0.25), (0.08 * np.sin(0.9 * t), 0.06 * np.sin(1.3 * t), 0.04 * np.sin(t + 1.0)))
    return looking(eye, (-0.1 + 0.03 * np.sin(t), -0.1, 0.02 * np.sin(2.0 * t)))


def standing(t: float) -> np.ndarray:
    del t
    return looking((-0.3, -0.95, 0.25), (-0.1, -0.1, 0.0))


def close(t: float) -> np.ndarray:
    eye = np.add((0.08, -0.40, 0.12), (0.03 * np.sin(0.9 * t), 0.02 * np.sin(1.3 * t), 0.02 * np.sin(t + 1.0)))
    return looking(eye, (0.0 + 0.01 * np.sin(t), 0.0, 0.015))


def film(
    path: Path,
    faces: Sequence[Face],
    law: Callable[[float], float],
    camera: Callable[[float], np.ndarray] = standing,
    *,
    seconds: float = 4.0,
    rate: float = 15.0,
    noise: float = 3.0,
    blur: float = 0.6,
    bent: np.ndarray | None = None,
    covered: Callable[[float], tuple[int, int, int, int] | None] | None = None,
    seed: int = 0,
) -> None:
    """Write a video, or pictures into a folder."""
    rng = np.random.default_rng(seed)
    textures = [_texture(face) for face in faces]
    background = np.clip(
        cv2.resize(rng.normal(0, 25, (9, 16)).astype(np.float32), (FINER * WIDTH, FINER * HEIGHT)) + 110, 0, 255
    )
    is_video = path.suffix == ".mp4"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), rate, (WIDTH, HEIGHT)) if is_video else None
    for k in range(round(seconds * rate)):
        t = k / rate
        picture = background.astype(np.uint8).copy()
        for face, texture in zip(faces, textures, strict=True):
            pose = camera(t) @ face.pose(law(t))
            if pose[:3, 2] @ pose[:3, 3] < 0.0:  # its front looks at the camera
                cv2.warpPerspective(
                    texture, _homography(face, pose), (FINER * WIDTH, FINER * HEIGHT), dst=picture,
                    flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_TRANSPARENT,
                )  # fmt: skip
        small = cv2.resize(picture, (WIDTH, HEIGHT), interpolation=cv2.INTER_AREA).astype(np.float32)
        if bent is not None:
            small = _through_lens(small, bent)
        small = cv2.GaussianBlur(small, (0, 0), blur) + rng.normal(0.0, noise, small.shape)
        grey = np.clip(small, 0, 255).astype(np.uint8)
        box = None if covered is None else covered(t)
        if box is not None:
            x, y, wide, high = box
            grey[y : y + high, x : x + wide] = 95
        if writer is None:
            cv2.imwrite(str(path / f"{k:05d}.png"), grey)
        else:
            writer.write(cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    if writer is not None:
        writer.release()


def _through_lens(picture: np.ndarray, bent: np.ndarray) -> np.ndarray:
    """What a lens makes of the picture of a pinhole."""
    x, y = np.meshgrid(np.arange(WIDTH, dtype=float), np.arange(HEIGHT, dtype=float))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)[:, None]
    straight = cv2.undistortPoints(pixels, MATRIX, bent, P=MATRIX).reshape(HEIGHT, WIDTH, 2).astype(np.float32)
    return cv2.remap(picture, straight[..., 0], straight[..., 1], cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)


def _texture(face: Face) -> np.ndarray:
    picture = np.full((int(face.height * PX_PER_M), int(face.width * PX_PER_M)), face.grey, np.uint8)
    markers = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    for number, size, x, y in face.tags:
        side = round(size * PX_PER_M / 8) * 8
        tag = cv2.aruco.generateImageMarker(markers, number, side)
        tag = np.clip(cv2.copyMakeBorder(tag, *(side // 8,) * 4, cv2.BORDER_CONSTANT, value=245), 18, 245)
        left = round((x + face.width / 2) * PX_PER_M - tag.shape[1] / 2)
        top = round((face.height / 2 - y) * PX_PER_M - tag.shape[0] / 2)
        picture[top : top + tag.shape[0], left : left + tag.shape[1]] = tag
    return picture


def _homography(face: Face, pose: np.ndarray) -> np.ndarray:
    scale = 1.0 / PX_PER_M
    plane = np.array(
        [[scale, 0.0, 0.5 * scale - face.width / 2], [0.0, -scale, face.height / 2 - 0.5 * scale], [0, 0, 1]]
    )
    finer = np.array([[FINER, 0.0, 0.5 * (FINER - 1)], [0.0, FINER, 0.5 * (FINER - 1)], [0.0, 0.0, 1.0]])
    return finer @ MATRIX @ np.column_stack([pose[:3, 0], pose[:3, 1], pose[:3, 3]]) @ plane


def shutting(t: float) -> float:
    """A door: open by 1 rad, shut at 3 s."""
    return 1.0 - eased((t - 0.5) / 2.5)


def pulled(t: float) -> float:
    """A drawer: pulled out by 0.3 m until 3 s."""
    return 0.3 * eased((t - 0.5) / 2.5)


@dataclass(frozen=True)
class Scene:
    """A video to render.

    Attributes:
        objects, law: what moves, and how.
        camera: where it is.
        size: edge of the tags [m].
        axes: of the joints, one for each part, in the frame of the base's tag.
        is_known: whether the camera's file is given.
        is_covered: whether nothing is seen for half a second.
        bent: distortion of the lens; None: a pinhole.
    """

    objects: Callable[[float], list[Face]]
    law: Callable[[float], float]
    camera: Callable[[float], np.ndarray]
    size: float
    axes: Sequence[tuple[str, tuple[float, float, float]]]
    is_known: bool = True
    is_covered: bool = False
    bent: np.ndarray | None = None


def _rows(name: str, folder: Path, seed: int) -> list[str]:
    own = SCENES[name]
    faces, video = own.objects(own.size), folder / f"{seed}.mp4"
    covered = (lambda t: (0, 0, WIDTH, HEIGHT) if 1.4 < t < 1.9 else None) if own.is_covered else None
    film(video, faces, own.law, own.camera, seconds=7.0, covered=covered, bent=own.bent, seed=seed)
    parts = ["base", *(f"part {k}" for k in range(1, len(faces)))]
    layout = TagLayout(
        "tag36h11", {face.tags[0][0]: PlacedTag(part, own.size) for face, part in zip(faces, parts, strict=True)}
    )
    lens = np.zeros(0) if own.bent is None else own.bent
    found = track(video, layout, camera=Camera(MATRIX, lens, (WIDTH, HEIGHT)) if own.is_known else None)
    graph, rows = micah_plan.learn(found.recording).graph, []
    for number, (kind, truth) in enumerate(own.axes, start=1):
        part = parts[number]
        segments = [segment for edge in graph.edges if edge.child == part for segment in edge.segments]
        kinds = " ".join(segment.joint.kind for segment in segments)
        joint = next((segment.joint for segment in segments if segment.joint.moves), segments[0].joint)
        axis = float(np.arccos(min(abs(float(np.dot(joint.axis, truth))), 1.0)))
        recording = found.recording.select(part=part)
        place, turn = found.tracked.stds[part]
        off, turned = errors_of(recording, [faces[0], faces[number]], own.law)
        rows.append(
            f"{name:34}{seed:5}{1e3 * off:8.2f}{1e3 * place:7.2f}{1e3 * turned:8.1f}{1e3 * turn:7.1f}{1e3 * axis:10.1f}"
            f"  {'right' if kind in kinds else 'WRONG'}: {kinds}"
        )
    return rows


UP, OUT = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
SCENES = {
    "door, fixed": Scene(door, shutting, standing, 0.06, [("revolute", UP)]),
    "door, in a hand": Scene(door, shutting, hand_held, 0.06, [("revolute", UP)], is_covered=True),
    "door, in a hand, 30 px": Scene(door, shutting, hand_held, 0.04, [("revolute", UP)], is_covered=True),
    "door, fixed, no camera file": Scene(door, shutting, standing, 0.06, [("revolute", UP)], is_known=False),
    "door, fixed, lens bends by 12 px": Scene(door, shutting, standing, 0.06, [("revolute", UP)], bent=BENT),
    "drawer, fixed": Scene(drawer, pulled, standing, 0.06, [("prismatic", OUT)]),
    "drawer, in a hand": Scene(drawer, pulled, hand_held, 0.06, [("prismatic", OUT)], is_covered=True),
    "drawer above a door, in a hand": Scene(
        cabinet, shutting, hand_held, 0.052, [("revolute", UP), ("prismatic", OUT)], is_covered=True
    ),
    "stapler of 16 cm, in a hand": Scene(stapler, shutting, close, 0.02, [("revolute", OUT)]),
}


def errors_of(recording: Recording, faces: Sequence[Face], law: Callable[[float], float]) -> tuple[float, float]:
    """Root mean square errors of positions [m] and of turns [rad], along one axis, beside the truth."""
    offs, turns = [], []
    for k, time in enumerate(recording.time.tolist()):
        base, part = (face.pose(law(time)) @ rigid(Rotation.identity(), (*face.tags[0][2:], 0.0)) for face in faces)
        truth = np.linalg.inv(base) @ part
        offs.append(recording.position[k] - truth[:3, 3])
        turn = Rotation.from_quat(recording.quaternion[k]).inv() * Rotation.from_matrix(truth[:3, :3])
        turns.append(turn.magnitude())
    return float(np.sqrt(np.mean(np.square(offs)))), float(np.sqrt(np.mean(np.square(turns)) / 3.0))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--example", type=Path, help="folder to write the video of the guide into")
    given = parser.parse_args()
    if given.example is not None:
        film(given.example / "door.mp4", door(), shutting, hand_held)
        return
    print(f"{'scene':34}{'seed':>5}{'mm off':>8}{'said':>7}{'mrad off':>9}{'said':>6}{'axis mrad':>10}  kinds")
    with tempfile.TemporaryDirectory() as folder:
        for name in SCENES:
            for seed in range(given.seeds):
                print("\n".join(_rows(name, Path(folder), seed)), flush=True)


if __name__ == "__main__":
    main()
