"""Kinds of motion to learn from, drawn at random by seed, each with its right answer.

Actions are scaled, turned, late, noisy at random in every kind that has them; only those named after actions (which
are stops) single one of these out, and ideal ones have none. Conventions (docs/concepts/learning.md):

* a part that is at its stop at the end is `rigid` there, also where no actions tell it from one that was left;
* a curve with one freedom that no joint follows is `path` if it is passed more than once, else `none`;
* of several parts, the tree and the joints that move count, but not rests: these are what the other kinds are for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from zlib import crc32

import numpy as np
from free_motions import FREE, free_recording
from kinds_of_mechanisms import bottle_cap, four_bar_lid, tilting_slide, two_stage_hinge, wave
from kinds_of_one_part import ROWS, EdgeTruth, Kind, Simulated, as_value, between
from kinds_plant import RATE, Floats, random_joint, tracker_noise
from scipy.spatial.transform import Rotation

from micah_plan.automaton.graph import BASE
from micah_plan.recording.value import DEFAULT_PART, Recording

Draw = Callable[[np.random.Generator], Simulated]


def simulated(name: str, seed: int) -> Simulated:
    """The recording of a kind that belongs to a seed."""
    return KINDS[name](np.random.default_rng([crc32(name.encode()), seed]))


def no_joint(motions: tuple[str, ...], orientation: bool) -> Draw:
    """A motion that no joint holds, of those that `calibration` simulates."""

    def draw(rng: np.random.Generator) -> Simulated:
        motion, seed, rows = str(rng.choice(motions)), int(rng.integers(2**31)), int(rng.integers(*ROWS))
        return _told(free_recording(motion, seed, orientation, rows), ("none",))

    return draw


def two_hinges(rng: np.random.Generator) -> Simulated:
    """A door on a door, both moved at once: two freedoms."""
    rows = int(rng.integers(*ROWS))
    (first, one), (second, other) = random_joint("revolute", rng), random_joint("revolute", rng)
    second = replace(second, position=0.4 * second.position, point=second.point - 0.6 * second.position)
    phase = np.linspace(0.0, 1.0, rows)
    waves = rng.uniform(1.5, 3.5)
    inner = second.poses(other * np.sin(waves * phase + rng.uniform(0.0, 1.0)))
    return _told(_seen(*_composed(first.poses(one * phase), inner), 0.001, 0.0, rng), ("none",))


def curve_again(rng: np.random.Generator) -> Simulated:
    """A curve with one freedom and no joint, as a garage door's, passed three times."""
    rows = int(rng.integers(*ROWS))
    sweep = np.abs((3.0 * np.linspace(0.0, 1.0, rows) + 1.0) % 2.0 - 1.0)
    s = sweep + 0.03 * np.sin(np.linspace(0.0, 9.0, rows))
    bend, lift, turn = rng.uniform(0.1, 0.2), rng.uniform(0.03, 0.08), rng.uniform(0.5, 1.0)
    position = np.stack([0.4 * s, bend * np.sin(3.0 * s), lift * np.cos(4.0 * s)], axis=1)
    rotation = Rotation.from_rotvec(np.outer(turn * np.sin(2.5 * s), [0.0, 0.0, 1.0])).as_matrix()
    base = Rotation.random(rng=rng).as_matrix()
    return _told(_seen(position @ base.T, base @ rotation, 0.001, 0.0, rng), ("path",))


def guided(fewest: int, most: int, wanders: bool = False) -> Draw:
    """A door whose ends run along two walls, or a pin in a wavy slot, passed so often; `none` if only once."""

    def draw(rng: np.random.Generator) -> Simulated:
        passed, rows = int(rng.integers(fewest, most + 1)), int(rng.integers(*ROWS))
        sweep = np.abs((passed * np.linspace(0.0, 1.0, rows) + 1.0) % 2.0 - 1.0)
        angle, size, flat = 0.1 + 1.3 * sweep, rng.uniform(0.3, 0.8), np.zeros(rows)
        share = rng.uniform(0.2, 0.8)
        position = size * np.stack([share * np.sin(angle), flat, (1 - share) * np.cos(angle)], axis=1)
        turned = np.stack([flat, -angle, flat], axis=1)
        if rng.random() < 0.5:
            turned = 0.0 * turned
            position = size * np.stack([sweep, 0.1 * np.sin(2 * np.pi * sweep), flat], axis=1)
        base = Rotation.random(rng=rng).as_matrix()
        noise = (between(_FINE, rng), rng.uniform(*_WANDER)) if wanders else (0.001, 0.0)
        seen = _seen(position @ base.T, base @ Rotation.from_rotvec(turned).as_matrix(), *noise, rng)
        return _told(seen, ("path",) if passed > 1 else ("none",))

    return draw


def at_rest(white: tuple[float, float], wander: tuple[float, float]) -> Draw:
    """A part that nobody moves, without actions."""

    def draw(rng: np.random.Generator) -> Simulated:
        rows, joint = int(rng.integers(*ROWS)), random_joint("prismatic", rng)[0]
        noise = between(white, rng), rng.uniform(*wander)
        return _told(_seen(*joint.poses(np.zeros(rows)), *noise, rng), ("rigid",))

    return draw


def parts(fewest: int, most: int, white: tuple[float, float], wander: tuple[float, float], actions: bool) -> Draw:
    """Parts on a random tree, each moved on its joint for a while; sometimes one rests on the base, as a wall."""

    def draw(rng: np.random.Generator) -> Simulated:
        rows, count = int(rng.integers(150, 301)), int(rng.integers(fewest, most + 1))
        names = [f"part_{letter}" for letter in rng.permutation(list("abcde")[:count])]
        wall = names[-1] if count > 1 and rng.random() < 0.4 else None
        turns = rng.permutation(count)
        poses: dict[str, tuple[Floats, Floats]] = {}
        edges: dict[str, EdgeTruth] = {}
        for name, turn in zip(names, turns.tolist(), strict=True):
            kind = str(rng.choice(["revolute", "prismatic"]))
            joint, travel = random_joint(kind, rng)
            if name == wall:
                poses[name], edges[name] = joint.poses(np.zeros(rows)), EdgeTruth((("rigid",),))
                continue
            parent = str(rng.choice([BASE, *poses]))
            if parent != BASE:
                joint = replace(joint, position=0.4 * joint.position, point=joint.point - 0.6 * joint.position)
            own = joint.poses(travel * _in_turn(turn, count, rows, rng))
            poses[name] = own if parent == BASE else _composed(poses[parent], own)
            edges[name] = EdgeTruth(((kind,),), parent, (as_value(joint),), rests=False)
        noise = between(white, rng), rng.uniform(*wander)
        return Simulated(_seen_together(poses, *noise, actions, rng), edges)

    return draw


def _in_turn(turn: int, count: int, rows: int, rng: np.random.Generator) -> Floats:
    """(rows,) share of the way of the part whose turn this is; others may still move, or already."""
    begin, end = (np.array([turn, turn + 1]) + rng.uniform(-0.2, 0.2, 2)) / count
    phase = np.clip((np.arange(rows) / rows - begin) / (end - begin), 0.0, 1.0)
    return np.asarray(phase + 0.04 * np.sin(2 * np.pi * phase))


def _composed(outer: tuple[Floats, Floats], inner: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Poses of what is on a part that moves itself."""
    return outer[0] + (outer[1] @ inner[0][..., None])[..., 0], outer[1] @ inner[1]


def _seen(position: Floats, rotation: Floats, white: float, wander: float, rng: np.random.Generator) -> Recording:
    shifts, turns = tracker_noise(len(position), white, wander, rng)
    turned = Rotation.from_rotvec(turns) * Rotation.from_matrix(rotation)
    return Recording(np.arange(len(position)) / RATE, position + shifts, turned.as_quat())


def _seen_together(
    poses: dict[str, tuple[Floats, Floats]], white: float, wander: float, actions: bool, rng: np.random.Generator
) -> Recording:
    """All parts in one recording, in rows of time; actions are the displacements to the next row."""
    seen = {name: _seen(*pose, white, wander, rng) for name, pose in poses.items()}
    moved = [np.vstack([np.diff(position, axis=0), np.full((1, 3), np.nan)]) for position, _ in poses.values()]
    time = np.concatenate([one.time for one in seen.values()])
    part = np.concatenate([np.full(len(one), name) for name, one in seen.items()])
    order = np.argsort(time, kind="stable")
    return Recording(
        time=time[order],
        position=np.concatenate([one.position for one in seen.values()])[order],
        quaternion=np.concatenate([one.quaternion for one in seen.values()])[order],
        action=np.concatenate(moved)[order] if actions else None,
        part=tuple(part[order].tolist()),
        has_part=True,
    )


def _told(recording: Recording, *answers: tuple[str, ...]) -> Simulated:
    return Simulated(recording, {DEFAULT_PART: EdgeTruth(answers)})


_STOP = (("move", 0.7), ("press", 0.3))
_LOCKED = (("locked", 0.3), ("move", 0.7))
_OPEN = (("move", 1.0),)
_PAUSE = (("move", 0.5), ("rest", 0.2), ("move", 0.3))
_WANDER = (0.001, 0.005)
_QUIET = (0.0, 0.0)
_FINE = (1e-5, 5e-4)  # of trackers that wander: often smooth, with little that is white
_COARSE = (3e-4, 2e-3)
_STOPPED = Kind(_STOP, stops=0.97)
_AS_RECORDED = replace(_STOPPED, scaled=0.0, turned=0.0, late=(0,), noise=(0.01, 0.02))
_IDEAL = Kind(white=(1e-5, 1e-5), scaled=0.0, turned=0.0, late=(0,), noise=(1e-4, 1e-4), slip=(1e-4, 1e-4))

KINDS: dict[str, Draw] = {
    "hinge": Kind(_OPEN, ("revolute",)),
    "slide": Kind(_OPEN, ("prismatic",)),
    "screw": Kind(_OPEN, ("screw",)),
    "screw-positions": Kind(_OPEN, ("screw",), orientation=False, actions=False, white=(0.001, 0.002)),
    "hinge-positions": Kind(_OPEN, ("revolute",), orientation=False, actions=False),
    "to-and-fro": Kind((("move", 0.4), ("back", 0.25), ("move", 0.35))),
    "detour": Kind((("move", 0.4), ("aside", 0.2), ("move", 0.4))),
    "pause": Kind(_PAUSE),
    "pauses-no-actions": Kind(_PAUSE, actions=False),
    "late-start": Kind((("rest", 30), ("move", 1.0))),
    "left-open-30": Kind((("move", 1.0), ("rest", 30))),
    "left-open-60": Kind((("move", 1.0), ("rest", 60))),
    "left-open-120": Kind((("move", 1.0), ("rest", 120))),
    "left-open-ideal": replace(_IDEAL, phases=(("move", 1.0), ("rest", 120))),
    "stop": _STOPPED,
    "stop-screw": Kind(_STOP, ("screw",), stops=0.97),
    "stop-no-actions": replace(_STOPPED, actions=False),
    "stop-positions": replace(_STOPPED, orientation=False),
    "stop-and-back": Kind((("move", 0.45), ("press", 0.2), ("back", 0.35)), stops=0.97),
    "latch": Kind((("move", 0.6), ("press", 0.1), ("pull", 0.3)), stops=0.97, latches=True),
    "locked-first": Kind(_LOCKED),
    "locked-first-ideal": replace(_IDEAL, phases=_LOCKED),
    "locked-first-then-a-stop": Kind((("locked", 0.25), ("move", 0.5), ("press", 0.25)), stops=0.97),
    "locked-always": Kind((("move", 0.5), ("press", 0.5)), stops=0.0),
    "scaled-actions": replace(_AS_RECORDED, scaled=1.0),
    "turned-actions": replace(_AS_RECORDED, turned=1.0),
    "late-actions": replace(_AS_RECORDED, late=(2, 3)),
    "early-actions": replace(_AS_RECORDED, late=(-3, -2)),
    "noisy-actions": replace(_AS_RECORDED, noise=(0.2, 0.5)),
    "wander": Kind(_OPEN, white=_FINE, wander=_WANDER),
    "wander-positions": Kind(_OPEN, white=_FINE, wander=_WANDER, orientation=False, actions=False),
    "wander-screw": Kind(_OPEN, ("screw",), white=_FINE, wander=_WANDER),
    "wander-stop": replace(_STOPPED, white=_FINE, wander=_WANDER),
    "wander-left-open": Kind((("move", 1.0), ("rest", 60)), white=_FINE, wander=_WANDER),
    "wander-locked-first": Kind(_LOCKED, white=_FINE, wander=_WANDER),
    "at-rest": at_rest(_COARSE, _QUIET),
    "at-rest-wander": at_rest(_FINE, _WANDER),
    "hinge-after-hinge": Kind((("move", 0.5),), ("revolute",), again=("revolute",)),
    "slide-after-slide": Kind((("move", 0.5),), ("prismatic",), again=("prismatic",)),
    "hinge-after-slide": Kind((("move", 0.5),), ("prismatic",), again=("revolute",)),
    "slide-after-hinge-no-actions": Kind((("move", 0.5),), ("revolute",), again=("prismatic",), actions=False),
    "two-freedoms": no_joint(FREE[:4], True),
    "two-freedoms-positions": no_joint(("plane", "ball", "sliding door on a hinge"), False),
    "two-hinges-at-once": two_hinges,
    "deforming-path": no_joint(("deforming path",), True),
    "curve-again": curve_again,
    "guided-once": guided(1, 1),
    "guided-again": guided(2, 3),
    "guided-wander": guided(2, 3, wanders=True),
    "guided-once-wander": guided(1, 1, wanders=True),
    "bottle-cap": bottle_cap,
    "two-stage-hinge": two_stage_hinge,
    "tilting-slide": tilting_slide,
    "four-bar-lid": four_bar_lid,
    "wave": wave,
    "two-parts": parts(2, 2, _COARSE, _QUIET, False),
    "parts": parts(3, 5, _COARSE, _QUIET, False),
    "parts-actions": parts(2, 4, _COARSE, _QUIET, True),
    "parts-wander": parts(2, 4, _FINE, _WANDER, False),
}
