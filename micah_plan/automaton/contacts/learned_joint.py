"""What the contact product takes from a learned automaton: one moving joint, its range, and where it latches."""

from __future__ import annotations

import math
from dataclasses import dataclass

from micah_plan.automaton.contacts.task import Grip
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Pin
from micah_plan.automaton.joint import JointKind
from micah_plan.errors import InputError


@dataclass(frozen=True)
class Latch:
    """A rigid mode that the joint reaches.

    Attributes:
        mode: its name.
        pin: where it holds the joint.
        threshold: configuration at which it is reached [rad or m]; threshold_std: how well that is known.
        direction: +1 if it is reached from smaller values.
    """

    mode: str
    pin: Pin
    threshold: float
    threshold_std: float
    direction: int


@dataclass(frozen=True)
class LearnedJoint:
    """The joint of an automaton with one coordinate.

    Attributes:
        kind: revolute or prismatic.
        moving: name of the mode in which it moves.
        low, high: its range there [rad or m]; datum: where the shapes are given.
        latches: rigid modes.
        process_std, observation_std: of the coordinate.
    """

    kind: JointKind
    moving: str
    low: float
    high: float
    datum: float
    latches: tuple[Latch, ...]
    process_std: float
    observation_std: float

    @property
    def turns(self) -> bool:
        return self.kind == "revolute"


def learned_joint(automaton: HybridAutomaton, grip: Grip) -> LearnedJoint:
    """The joint of a learned automaton.

    Raises:
        InputError: unless it has one coordinate that one mode moves, by a revolute or prismatic joint, and a datum.
    """
    moving = [mode for mode in automaton.modes if mode.B.any()]
    if automaton.n != 1 or len(automaton.links) != 1 or len(moving) != 1:
        problem = f"contacts need a model of one joint with one mode in which it moves. Got {automaton.n} coordinates"
        raise InputError(f"{problem} and {len(moving)} such modes", remedy="learn the held object's joint alone")
    mode = moving[0]
    kind = mode.joints[0].kind
    if kind not in ("revolute", "prismatic"):
        raise InputError(f"contacts need a revolute or prismatic joint. Got {kind}")
    latches = tuple(latch for edge in automaton.edges_from(mode.name) if (latch := _latch(automaton, edge)) is not None)
    high = mode.interval(0)[1]
    datum = grip.datum
    if datum is None:
        known = [latch.threshold for latch in latches if latch.direction > 0] + [high]
        datum = known[0]
        if not math.isfinite(datum):
            remedy = "give the configuration at which the parts' shapes are described as `datum`"
            raise InputError("the model neither latches nor ends anywhere, so its shapes have no datum", remedy=remedy)
    above = [latch.threshold for latch in latches if latch.direction > 0]
    below = [latch.threshold for latch in latches if latch.direction < 0]
    return LearnedJoint(
        kind,
        mode.name,
        max([datum - grip.travel, *below]),
        min([max(datum, high if math.isfinite(high) else datum), *above]),
        datum,
        latches,
        automaton.noise.process_std[0],
        automaton.noise.observation_std[0],
    )


def _latch(automaton: HybridAutomaton, edge: Edge) -> Latch | None:
    """The rigid mode that an edge leads to; None if it leads elsewhere."""
    pins = automaton.mode(edge.target).pins
    bound = edge.guard.half_spaces[0].bound if len(edge.guard.half_spaces) == 1 else None
    if not pins or bound is None:
        return None
    return Latch(edge.target, pins[0], bound.value, edge.threshold_std, 1 if bound.is_lower else -1)
