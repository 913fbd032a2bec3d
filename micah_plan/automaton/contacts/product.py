"""The product of a learned automaton with the contacts of its moving part, compacted: `with_contacts`.

The state is the hand's position and the joint, (x, y, z, theta); the input is the hand's displacement. Nothing drives
the joint but contacts. Modes (MICAH, section V-C, for the stapler; here for any joint and face):
- *free*: the joint keeps its place but for large noise, it swings;
- *line*, *surface*: the joint follows the hand's height above the face (a `Tie`), see `touch`;
- the learned rigid modes, one each: a rigid object moves alike whatever it touches, so contacts do not multiply them.

Guards follow from geometry and from the learned threshold: contact begins where the hand is as low as the touching
height, lies flush at the end of a line piece, latches at the configurational changepoint; it ends when the hand
withdraws. A latched object cannot be pressed into the face; where it latched against one, the hand's height is known.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.contacts.collision import collision_regions
from micah_plan.automaton.contacts.learned_joint import Latch, LearnedJoint, learned_joint
from micah_plan.automaton.contacts.task import COLLIDED, Face, Grip, HandNoise, Surroundings
from micah_plan.automaton.contacts.task_joints import AXES, links_of, mode_joints, parts_of
from micah_plan.automaton.contacts.touch import TouchPiece, resting_height, touch_pieces
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Pin, Reset, Tie
from micah_plan.automaton.region import HalfSpace, Region, above, below, box

FREE = "free"
_N, _M, _JOINT = 4, 3, 3
_HAND_FREE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
_STILL = ((0.0, 0.0, 0.0),) * 4


@dataclass(frozen=True)
class Contact:
    """A contact state of the moving part.

    Attributes:
        name: of its mode; face: touched; piece: how the joint follows.
    """

    name: str
    face: Face
    piece: TouchPiece

    @property
    def tie(self) -> Tie:
        weights = [0.0] * _N
        weights[self.face.axis] = self.face.sign / self.piece.slope
        height = -self.face.sign * self.face.position
        return Tie(_JOINT, tuple(weights), self.piece.begin + (height - self.piece.begin_height) / self.piece.slope)

    @property
    def entry(self) -> Reset:
        """Puts the joint where the hand's height asks for it."""
        return Reset(A=_rows({_JOINT: self.tie.weights}), c=(0.0, 0.0, 0.0, self.tie.offset))


def with_contacts(
    learned: HybridAutomaton, grip: Grip, surroundings: Surroundings, noise: HandNoise | None = None
) -> HybridAutomaton:
    """The automaton of a held object among bodies.

    Raises:
        InputError: if the learned model has not one joint, or nothing tells where its parts' shapes are given.
    """
    noise = noise or HandNoise()
    joint = learned_joint(learned, grip)
    contacts = contact_states(grip, surroundings, joint)
    edges = [
        *_contact_edges(contacts, joint, grip, noise),
        *_latch_edges(contacts, joint),
        *_range_edges(joint, grip),
        *_resting_edges(contacts, joint, grip, surroundings),
    ]
    modes = [_free(contacts, joint, grip, surroundings)]
    modes += [_contact_mode(contact, joint, grip, surroundings) for contact in contacts]
    modes += [_latched(latch, contacts, joint, grip, surroundings) for latch in joint.latches]
    hits = list(_collisions(modes, joint, grip, surroundings))
    if hits:
        modes.append(Mode(COLLIDED, modes[0].joints, _STILL))
    automaton = HybridAutomaton(
        coordinates=(*(Coordinate(axis, "m") for axis in AXES), _joint_coordinate(joint, grip)),
        inputs=tuple(Coordinate(axis, "m") for axis in AXES),
        links=links_of(grip),
        parts=parts_of(grip),
        modes=tuple(modes),
        edges=(*edges, *hits),
        noise=Noise((*noise.process, joint.process_std), (*noise.observation, joint.observation_std)),
        provenance=learned.provenance,
    )
    check_automaton(automaton)
    return automaton


def contact_states(grip: Grip, surroundings: Surroundings, joint: LearnedJoint) -> tuple[Contact, ...]:
    """The contact states of the moving part: ``line`` and ``surface``, with the face's solid where there are more."""
    found = [
        (face, piece)
        for face in surroundings.faces
        for piece in touch_pieces(grip, face, joint.datum, joint.low, joint.high, joint.turns)
    ]
    kinds = [piece.kind for _, piece in found]
    several = len(surroundings.faces) > 1
    contacts: list[Contact] = []
    for face, piece in found:
        name = f"{piece.kind} on {face.solid}" if several else piece.kind
        if (kinds.count(piece.kind) > 1 and not several) or any(c.name == name for c in contacts):
            name += f" {1 + sum(c.piece.kind == piece.kind and c.face == face for c in contacts)}"
        contacts.append(Contact(name, face, piece))
    return tuple(contacts)


def _joint_coordinate(joint: LearnedJoint, grip: Grip) -> Coordinate:
    return Coordinate(grip.coordinate, "rad" if joint.turns else "m")


def _rows(replaced: dict[int, tuple[float, ...]]) -> tuple[tuple[float, ...], ...]:
    """The identity with some rows replaced."""
    eye = np.eye(_N)
    return tuple(replaced.get(i, tuple(map(float, eye[i]))) for i in range(_N))


def _contact_half_space(contact: Contact) -> HalfSpace:
    """Where the object touches: the chord's height of the joint is at least the hand's."""
    face, piece = contact.face, contact.piece
    a = [0.0] * _N
    a[face.axis], a[_JOINT] = -float(face.sign), piece.slope
    c = -piece.begin_height + piece.slope * piece.begin - face.sign * face.position
    return HalfSpace(tuple(a), (0.0,) * _M, c, name=f"{contact.name}: touching {face.solid}")


def _lines_on(face: Face, contacts: tuple[Contact, ...]) -> int:
    return sum(contact.face == face and contact.piece.kind == "line" for contact in contacts)


def _touching(contact: Contact, contacts: tuple[Contact, ...], grip: Grip) -> Region:
    """Where contact begins: below the touching height, and of several edges that may touch, in the range of this."""
    rows = [_contact_half_space(contact)]
    if _lines_on(contact.face, contacts) > 1:
        piece = contact.piece
        rows += [_beyond(piece.begin, piece.direction, grip), _beyond(piece.end, -piece.direction, grip, strict=True)]
    return Region(tuple(rows))


def _reversed(half_space: HalfSpace, name: str) -> HalfSpace:
    return HalfSpace(tuple(-w for w in half_space.a), half_space.b, -half_space.c, not half_space.strict, name)


def _beyond(value: float, direction: int, grip: Grip, *, strict: bool = False) -> HalfSpace:
    """theta at or beyond a value, seen along a direction."""
    bound = above if direction > 0 else below
    return bound(_JOINT, value, _N, _M, strict=strict, name=grip.coordinate)


def _latch_of(piece: TouchPiece, joint: LearnedJoint) -> Latch | None:
    """The latch at the end of a piece."""
    return next((x for x in joint.latches if x.direction == piece.direction and x.threshold == piece.end), None)


def _contact_edges(contacts: tuple[Contact, ...], joint: LearnedJoint, grip: Grip, noise: HandNoise) -> Iterator[Edge]:
    """Into contact, from a piece to the next and back, out of contact, and the end of the last piece."""
    for contact in contacts:
        piece, face = contact.piece, contact.face
        follower = next((o for o in contacts if o.face == face and o.piece.begin == piece.end), None)
        withdraws = _withdrawing(face, noise)
        if piece.kind == "line":
            yield Edge(FREE, contact.name, _touching(contact, contacts, grip), contact.entry)
            if not any(o.face == face and o.piece.end == piece.begin for o in contacts):
                yield Edge(contact.name, FREE, Region((withdraws,)))
        if follower is not None:
            onward = Region((_beyond(piece.end, piece.direction, grip),))
            yield Edge(contact.name, follower.name, onward, follower.entry)
            # Only a hand that withdraws leads back: a belief that spreads over the boundary does not.
            back = Region((withdraws, _beyond(piece.end, -piece.direction, grip, strict=True)))
            yield Edge(follower.name, contact.name, back, contact.entry)
        elif _latch_of(piece, joint) is None:
            # Pressing does not get any further: the hand is stopped.
            stop = _beyond(piece.end, piece.direction, grip, strict=True)
            yield Edge(contact.name, contact.name, Region((stop,)), _stopped(contact, {_JOINT: piece.end}))


def _withdrawing(face: Face, noise: HandNoise) -> HalfSpace:
    """A hand that moves away from a face."""
    b = [0.0] * _M
    b[face.axis] = float(face.sign)
    return HalfSpace((0.0,) * _N, tuple(b), noise.release, strict=True, name=f"withdrawing from {face.solid}")


def _stopped(contact: Contact, joint: dict[int, float]) -> Reset:
    """The hand stands where the end of a contact's piece is touched; `joint` says where theta is put."""
    face, piece = contact.face, contact.piece
    c = [0.0] * _N
    c[face.axis] = face.position + face.sign * piece.end_height
    for i, value in joint.items():
        c[i] = value
    zero = (0.0,) * _N
    return Reset(A=_rows({face.axis: zero, **dict.fromkeys(joint, zero)}), c=tuple(c))


def _latch_edges(contacts: tuple[Contact, ...], joint: LearnedJoint) -> Iterator[Edge]:
    for latch in joint.latches:
        bound = above if latch.direction > 0 else below
        guard = Region((bound(_JOINT, latch.threshold, _N, _M, name="latch"),))
        for contact in contacts:
            if _latch_of(contact.piece, joint) is latch:
                reset = _stopped(contact, {})
                yield Edge(contact.name, latch.mode, guard, reset, latch.threshold_std)
        yield Edge(FREE, latch.mode, guard, threshold_std=latch.threshold_std)


def _range_edges(joint: LearnedJoint, grip: Grip) -> Iterator[Edge]:
    """The joint's stops while it swings."""
    latched = {latch.threshold for latch in joint.latches}
    for value, direction in ((joint.low, -1), (joint.high, 1)):
        if value not in latched:
            stop = _beyond(value, direction, grip, strict=True)
            reset = Reset(A=_rows({_JOINT: (0.0,) * _N}), c=(0.0, 0.0, 0.0, value))
            yield Edge(FREE, FREE, Region((stop,)), reset)


def _resting_edges(
    contacts: tuple[Contact, ...], joint: LearnedJoint, grip: Grip, surroundings: Surroundings
) -> Iterator[Edge]:
    """A latched object stands on a face: the hand does not get lower."""
    for latch in joint.latches:
        for face in surroundings.faces:
            height = _lowest(latch, face, contacts, joint, grip)
            value = face.position + face.sign * height
            bound = below if face.sign > 0 else above
            guard = bound(face.axis, value, _N, _M, strict=True, name=AXES[face.axis])
            c = [0.0] * _N
            c[face.axis] = value
            yield Edge(latch.mode, latch.mode, Region((guard,)), Reset(A=_rows({face.axis: (0.0,) * _N}), c=tuple(c)))


def _lowest(latch: Latch, face: Face, contacts: tuple[Contact, ...], joint: LearnedJoint, grip: Grip) -> float:
    """The least height of the hand above a face with the object latched: as it latched there, or as it rests on it."""
    ends = [c.piece.end_height for c in contacts if c.face == face and _latch_of(c.piece, joint) is latch]
    return min([*ends, resting_height(grip, face, joint.datum, latch.threshold, joint.turns)])


def _hand_box(surroundings: Surroundings, low: float, high: float) -> Region:
    lower, upper = (*surroundings.lower, low), (*surroundings.upper, high)
    return box(lower, upper, _M, (*AXES, "theta"))


def _free(contacts: tuple[Contact, ...], joint: LearnedJoint, grip: Grip, surroundings: Surroundings) -> Mode:
    region = _hand_box(surroundings, joint.low, joint.high)
    rows = [
        _reversed(_contact_half_space(c), f"above {c.face.solid}: {c.name}")
        for c in contacts
        if c.piece.kind == "line" and _lines_on(c.face, contacts) == 1
    ]
    rows = [replace(row, strict=False) for row in rows]
    joints = mode_joints(grip, joint.datum, joint.turns)
    return Mode(FREE, joints, _HAND_FREE, region.intersection(Region(tuple(rows))))


def _contact_mode(contact: Contact, joint: LearnedJoint, grip: Grip, surroundings: Surroundings) -> Mode:
    tie, piece = contact.tie, contact.piece
    flow = (*_HAND_FREE[:3], tie.weights[:3])
    region = _hand_box(surroundings, *sorted((piece.begin, piece.end)))
    turned = piece.begin if piece.kind == "surface" else None
    joints = mode_joints(grip, joint.datum, joint.turns, turned_from=turned)
    return Mode(contact.name, joints, flow, region, ties=(tie,))


def _latched(
    latch: Latch, contacts: tuple[Contact, ...], joint: LearnedJoint, grip: Grip, surroundings: Surroundings
) -> Mode:
    region = _hand_box(surroundings, -np.inf, np.inf)
    rows = []
    for face in surroundings.faces:
        value = face.position + face.sign * _lowest(latch, face, contacts, joint, grip)
        bound = above if face.sign > 0 else below
        rows.append(bound(face.axis, value, _N, _M, name=AXES[face.axis]))
    joints = mode_joints(grip, joint.datum, joint.turns, held_at=latch.pin.value)
    pin = Pin(_JOINT, latch.pin.value, latch.pin.std)
    return Mode(latch.mode, joints, _HAND_FREE, region.intersection(Region(tuple(rows))), pins=(pin,))


def _collisions(modes: list[Mode], joint: LearnedJoint, grip: Grip, surroundings: Surroundings) -> Iterator[Edge]:
    for mode in modes:
        if mode.pins:
            low = high = mode.pins[0].value
        else:
            low, high = mode.invariant.interval(_JOINT)
        for region in collision_regions(grip, surroundings, joint.datum, low, high, joint.turns):
            yield Edge(mode.name, COLLIDED, region)
