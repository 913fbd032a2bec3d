"""Models as rigid bodies for other formats: one joint per link, distinct names, masses; and the losses."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from micah_plan.arrays import Floats
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import HybridAutomaton, Part, Primitive
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Interval
from micah_plan.errors import InputError
from micah_plan.quantities import count
from micah_plan.task.body import volume

DENSITY = 500.0
"""Of wood, kg/m^3, since the object's mass was not measured."""
JOINT_SUFFIX = "_joint"
_REMEDY = "the format cannot represent it; keep the YAML"
DAMPING = {"rad": 0.05, "m": 2.0}
"""Of joints by their unit, so that the object comes to rest, N m s/rad or N s/m: not measured."""
# A part without shapes must weigh something, or no engine can move it.
_BARE_MASS, _BARE_RADIUS = 0.1, 0.02


@dataclass(frozen=True, eq=False)
class MovingPart:
    """A link of the model with the joint that carries it.

    Attributes:
        parent, child: names of the parts.
        name: of the joint, distinct from those of all parts.
        joint: the one that moves, without covariance; a rigid one if none does.
        limits: of its configuration [rad or m], infinite where the model has none.
        part: with its shapes and handle.
        follows: name of the joint that it follows, by how much of that, and the offset [rad or m]; None: it is free.
    """

    parent: str
    child: str
    name: str
    joint: Joint
    limits: Interval
    part: Part
    follows: tuple[str, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Inertia:
    """Mass [kg], centre (3,) [m] and inertia (3, 3) about it [kg m^2], in the part's frame."""

    mass: float
    center: Floats
    moments: Floats


def moving_parts(automaton: HybridAutomaton, *, screws: bool) -> list[MovingPart]:
    """The parts in the order of the links, each with its one joint.

    Args:
        screws: whether the format knows them.

    Raises:
        InputError: for a part with different moving joints in different modes, or that moves with another one, and for
            screws that the format does not know.
    """
    names = {BASE, *(link.child for link in automaton.links)}
    moving, parts = set[int](), list[MovingPart]()
    for k, link in enumerate(automaton.links):
        joint = _moving_joint(automaton, k, screws)
        if joint.moves and link.coordinate in moving:
            raise InputError(f"part {link.child} moves with another one", remedy=_REMEDY)
        moving |= {link.coordinate} if joint.moves else set()
        ranges = automaton.ranges(link.coordinate) or [(-np.inf, np.inf)]
        names_of_joints = [c.name + JOINT_SUFFIX * (c.name in names) for c in automaton.coordinates]
        name = names_of_joints[link.coordinate] if joint.moves else f"{link.child}_mount"
        limits, follows = (ranges[0][0], ranges[-1][1]), None
        if joint.moves and (led := _followed(automaton, link.coordinate)) is not None:
            follows = names_of_joints[led[0]], led[1], led[2]
        parts.append(MovingPart(link.parent, link.child, name, joint, limits, automaton.part(link.child), follows))
    return parts


def _followed(automaton: HybridAutomaton, coordinate: int) -> tuple[int, float, float] | None:
    """(leading coordinate, factor, offset) of a coordinate tied to another in all modes; None otherwise."""
    ties = {next((tie for tie in mode.ties if tie.coordinate == coordinate), None) for mode in automaton.modes}
    tie = ties.pop() if len(ties) == 1 else None
    leaders = [] if tie is None else [i for i, weight in enumerate(tie.weights) if weight]
    return None if tie is None or len(leaders) != 1 else (leaders[0], tie.weights[leaders[0]], tie.offset)


def _moving_joint(automaton: HybridAutomaton, k: int, screws: bool) -> Joint:
    """The only moving joint of a link; rigid if there is none."""
    part = automaton.links[k].child
    joints = [replace(mode.joints[k], covariance=None) for mode in automaton.modes]
    moving = list(dict.fromkeys(joint for joint in joints if joint.moves))
    if len(moving) > 1:
        raise InputError(f"part {part} has different joints in different modes", remedy=_REMEDY)
    if not all(joint.has_axis for joint in moving):
        raise InputError(f"part {part} moves along or about no axis", remedy=_REMEDY)
    if not screws and any(joint.climbs for joint in moving):
        raise InputError(f"part {part} moves on a screw", remedy=_REMEDY)
    return moving[0] if moving else joints[0]


def inertia_of(part: Part, density: float) -> Inertia:
    """Inertia of a part's shapes at a density [kg/m^3]; of a small ball without shapes."""
    shapes = part.shapes or (Primitive("sphere", (_BARE_RADIUS,)),)
    scale = density if part.shapes else _BARE_MASS / volume(shapes[0])
    masses = np.array([scale * volume(shape) for shape in shapes])
    centers = np.array([shape.position for shape in shapes], dtype=float)
    center = masses @ centers / masses.sum()
    moments = np.zeros((3, 3))
    for mass, shape, at in zip(masses, shapes, centers - center, strict=True):
        turn = Rotation.from_quat(shape.quaternion).as_matrix()
        inertia = turn @ np.diag(mass * np.array(_squares(shape))) @ turn.T
        moments += inertia + mass * (at @ at * np.eye(3) - np.outer(at, at))
    return Inertia(float(masses.sum()), center, moments)


def _squares(shape: Primitive) -> Sequence[float]:
    """Moments of inertia per mass of a solid about its own axes [m^2]."""
    if shape.kind == "box":
        x, y, z = (length**2 / 12.0 for length in shape.size)
        return y + z, z + x, x + y
    radius = shape.size[0]
    if shape.kind == "cylinder":
        across = radius**2 / 4.0 + shape.size[1] ** 2 / 12.0
        return across, across, radius**2 / 2.0
    return (0.4 * radius**2,) * 3


def lost_in_bodies(automaton: HybridAutomaton, density: float, *, handles: bool) -> tuple[str, ...]:
    """Losses of a model in a file of bodies and joints, and assumed values, one line each."""
    lost = [f"{count(len(automaton.modes), 'mode')} with guards"] if len(automaton.modes) > 1 else []
    lost += ["noise"]
    lost += ["probabilities of what was learned"] if automaton.learned else []
    lost += [f"effects ({', '.join(effect.name for effect in automaton.effects)})"] if automaton.effects else []
    lost += ["handles"] if not handles and any(part.handle is not None for part in automaton.parts) else []
    bare = [link.child for link in automaton.links if not automaton.part(link.child).shapes]
    notes = [f"left out: {', '.join(lost)}"]
    notes.append(f"masses are those of shapes with {density:g} kg/m^3; they were not measured")
    if bare:
        notes.append(f"without shapes, so a ball of {_BARE_MASS:g} kg: {', '.join(bare)}")
    return tuple(notes)


def roll_pitch_yaw(rotation: Rotation) -> Floats:
    """(3,) rotations about the fixed axes x, y and z, as in URDF and SDF; yaw is 0 at vertical pitch."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of several such triples SciPy takes one, and warns
        return np.asarray(rotation.as_euler("xyz"))


def written(values: ArrayLike) -> str:
    """Numbers for XML files, without loss."""
    return " ".join(repr(float(value)) for value in np.asarray(values, dtype=float))
