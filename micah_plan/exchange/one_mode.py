"""A tree of moving parts as a model: one mode, in which every coordinate stops at the limits of its joint.

URDF and MJCF are read through this; they have no modes, no guards but limits, and no noise.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Reset, Tie
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import HalfSpace, Region, above, below
from micah_plan.errors import InputError, shown
from micah_plan.exchange.bodies import JOINT_SUFFIX
from micah_plan.robot.robot_text import NO_LIMIT

# These files have no noise; this is that of a good tracker, per step and per measurement, by unit.
PROCESS_STD: Mapping[str, float] = {"rad": 0.005, "m": 0.002}
OBSERVATION_STD: Mapping[str, float] = {"rad": 0.01, "m": 0.003}
MODE = "moves"
MOST_JOINTS = 100
# Values beyond these are suspicious: their unit may be another.
_MOST_TURNS, _LARGEST_OBJECT = 3.0, 20.0


class Moving(NamedTuple):
    """A joint that moves, with its name in the file, its coordinate's name, and its limits [rad or m]."""

    called: str
    name: str
    link: Link
    joint: Joint
    limits: tuple[float, float]


class Follows(NamedTuple):
    """A mimic joint: `multiplier` times the leading coordinate, plus `offset`."""

    leader: str
    multiplier: float
    offset: float


def coordinate_of(joint: str, part: str) -> str:
    """The joint's name, without the suffix ``_joint`` that our writers add to the part's name."""
    return part if joint == f"{part}{JOINT_SUFFIX}" else joint


def doubts(moving: Sequence[Moving], parts: Sequence[Part]) -> list[str]:
    """Suspicions: hinges with limits of many turns, which may be degrees, and bodies as long as a house."""
    lines = []
    for each in moving:
        widest = max((abs(end) for end in each.limits if abs(end) < NO_LIMIT), default=0.0)
        if each.joint.turns and widest > _MOST_TURNS * 2 * np.pi:
            low, high = each.limits
            turns = f"{widest / (2 * np.pi):.0f} turns; if they are degrees, write them in rad"
            lines.append(f"joint {each.called}: limits of {low:g} to {high:g} rad are up to {turns}")
    for part in parts:
        longest = max((side for shape in part.shapes for side in shape.size), default=0.0)
        if longest > _LARGEST_OBJECT:
            lines.append(f"part {part.name}: {longest:.3g} m long; if its mesh is in mm, give it scale 0.001")
    return lines


def one_mode(
    moving: Sequence[Moving], parts: Sequence[Part], followers: Mapping[str, Follows], method: str
) -> HybridAutomaton:
    """The model.

    Args:
        moving: the joints, from the base outwards.
        parts: base first.
        followers: by name of the joint in the file. Its coordinate is tied to that of its leader, and has no input.
        method: for the provenance.

    Raises:
        InputError: if nothing moves, too much moves, or a joint follows itself or one that does not move.
    """
    if len(moving) > MOST_JOINTS:
        problem = f"expected at most {MOST_JOINTS} joints that move, found {len(moving)}"
        raise InputError(problem, remedy="leave out the robot around the object")
    if not moving:
        raise InputError("expected a joint that moves, found none", remedy="a rigid object needs no model")
    followed = _followed(moving, followers)
    n = len(moving)
    led = [i for i in range(n) if i not in followed]
    m = len(led)
    units = [each.joint.unit for each in moving]
    coordinates = tuple(Coordinate(each.name, unit) for each, unit in zip(moving, units, strict=True))
    rows: list[HalfSpace] = []
    edges: list[Edge] = []
    ties = tuple(
        Tie(i, tuple(times * float(j == leader) for j in range(n)), offset)
        for i, (leader, times, offset) in followed.items()
    )
    for i in led:
        _, name, _, _, (low, high) = moving[i]
        for end, inside, outside in ((low, above, below), (high, below, above)):
            if abs(end) < NO_LIMIT:
                rows.append(inside(i, end, n, m, name=name))
                stop = Region((outside(i, end, n, m, strict=True, name=name),))
                edges.append(Edge(MODE, MODE, stop, Reset.to({i: end}, n, ties)))
    follows = {i: (i, 1.0) for i in led} | {i: (leader, times) for i, (leader, times, _) in followed.items()}
    gain = tuple(tuple(follows[i][1] * (follows[i][0] == j) for j in led) for i in range(n))
    automaton = HybridAutomaton(
        coordinates=coordinates,
        inputs=tuple(coordinates[i] for i in led),
        links=tuple(each.link for each in moving),
        parts=tuple(parts),
        modes=(Mode(MODE, tuple(each.joint for each in moving), gain, Region(tuple(rows)), ties=ties),),
        edges=tuple(edges),
        noise=Noise(tuple(PROCESS_STD[unit] for unit in units), tuple(OBSERVATION_STD[unit] for unit in units)),
        provenance={"method": method},
    )
    check_automaton(automaton)
    return automaton


def _followed(moving: Sequence[Moving], followers: Mapping[str, Follows]) -> dict[int, tuple[int, float, float]]:
    """(leading joint, multiplier, offset) by number of the coupled joint."""
    numbers, found = {each.called: i for i, each in enumerate(moving)}, dict[int, tuple[int, float, float]]()
    for name, number in numbers.items():
        multiplier, offset, leader, passed = 1.0, 0.0, name, [name]
        while leader in followers:
            follows = followers[leader]
            offset += multiplier * follows.offset
            multiplier, leader = multiplier * follows.multiplier, follows.leader
            if leader in passed:
                raise InputError(f"joint {shown(leader)} follows itself", remedy="let one of them move freely")
            passed.append(leader)
        if leader == name:
            continue
        if leader not in numbers:
            problem = f"joint {shown(name)} follows {shown(leader)}, which does not move"
            raise InputError(problem, remedy="make one of them fixed")
        found[number] = numbers[leader], multiplier, offset
    return found
