"""The product of a learned automaton with the contacts of its moving part, compacted: `with_contacts`.

The state is the hand's position and the joint, (x, y, z, theta); the input is the hand's displacement. Only contacts
move the joint. Modes (MICAH, section V-C, for the stapler; here for any joint and face):
- *free*: the joint keeps its place except for large noise, it swings;
- *line*, *surface*: the joint follows the hand's height above the face (a `Tie`), see `touch`;
- the learned rigid modes, one each: a rigid object moves alike in any contact, so contacts do not multiply them.

Guards follow from geometry and from the learned threshold: contact begins where the hand is as low as the touching
height, lies flush at the end of a line piece, latches at the configurational changepoint; it ends when the hand
withdraws. A latched object cannot be pressed into the face; where it latched against one, the hand's height is known.

Joints of a contact product: the one that it takes from a learned automaton, and those of the hand that it adds.

Three slides carry the hand, the held part may turn in it, and the object's own joint carries the moving part.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from micah_plan.automaton.check import check_automaton
from micah_plan.automaton.contacts.hit import collision_regions
from micah_plan.automaton.contacts.touch import TouchPiece, resting_height, touch_pieces
from micah_plan.automaton.contacts.values import AXES, COLLIDED, HINGE, Face, Grip, HandNoise, Surroundings
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Pin, Reset, Tie
from micah_plan.automaton.joint import IDENTITY, Joint, JointKind, prismatic, revolute, rigid
from micah_plan.automaton.region import HalfSpace, Region, above, below, box
from micah_plan.errors import InputError
from micah_plan.quantities import quantity

FREE = "free"
_N, _M, _JOINT = 4, 3, 3
_HAND_FREE = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
_STILL = ((0.0, 0.0, 0.0),) * 4

HAND = "hand"
_CARRIAGES = ("hand_x", "hand_y", HAND)


@dataclass(frozen=True)
class Contact:
    """A contact state of the moving part.

    Attributes:
        name: of its mode.
        face: touched.
        piece: how the joint follows.
    """

    name: str
    face: Face
    piece: TouchPiece

    @property
    def is_line(self) -> bool:
        """Whether the contact is an edge; else it is a flat surface."""
        return self.piece.kind == "line"

    @property
    def tie(self) -> Tie:
        """The joint as a function of the hand's height."""
        weights = [0.0] * _N
        weights[self.face.axis] = self.face.sign / self.piece.slope
        height = -self.face.sign * self.face.position
        return Tie(_JOINT, tuple(weights), self.piece.begin + (height - self.piece.begin_height) / self.piece.slope)

    @property
    def entry(self) -> Reset:
        """The reset that sets the joint from the hand's height."""
        return Reset.to({}, _N, [self.tie])

    @property
    def touching(self) -> HalfSpace:
        """States in contact: the chord's height of the joint is at least the hand's."""
        face, piece = self.face, self.piece
        a = [0.0] * _N
        a[face.axis], a[_JOINT] = -float(face.sign), piece.slope
        c = -piece.begin_height + piece.slope * piece.begin - face.sign * face.position
        return HalfSpace(tuple(a), (0.0,) * _M, c, name=f"{self.name}: touching {face.solid}")

    @property
    def above(self) -> HalfSpace:
        """States without contact, excluding the boundary."""
        touching = self.touching
        a = tuple(-w for w in touching.a)
        return HalfSpace(a, touching.b, -touching.c, name=f"above {self.face.solid}: {self.name}")

    @property
    def end_of_hand(self) -> dict[int, float]:
        """Position of the hand at the end of the piece, by coordinate."""
        return {self.face.axis: self.face.position + self.face.sign * self.piece.end_height}


def with_contacts(
    learned: HybridAutomaton, grip: Grip, surroundings: Surroundings, noise: HandNoise | None = None
) -> HybridAutomaton:
    """The automaton of a held object among bodies.

    Raises:
        InputError: if the learned model does not have exactly one joint, the frame of its parts' shapes is not defined,
            or the hand does not reach the end of a contact.
    """
    noise = noise or HandNoise()
    joint = learned_joint(learned, grip)
    product = _Product(grip, surroundings, noise, joint, contact_states(grip, surroundings, joint))
    for contact in product.contacts:
        _check_reach(contact, surroundings)
    modes, edges = product.modes(), product.edges()
    hits = list(product.collisions(modes))
    if hits:
        modes.append(Mode(COLLIDED, modes[0].joints, _STILL))
    hand = tuple(Coordinate(axis, "m") for axis in AXES)
    automaton = HybridAutomaton(
        coordinates=(*hand, Coordinate(grip.coordinate, "rad" if joint.turns else "m")),
        inputs=hand,
        links=links_of(grip),
        parts=(grip.held, grip.moving),
        modes=tuple(modes),
        edges=(*edges, *hits),
        noise=Noise((*noise.process, joint.process_std), (*noise.observation, joint.observation_std)),
        provenance=learned.provenance,
        learned=tuple(
            replace(learned_edge, parent=grip.held.name, child=grip.moving.name) for learned_edge in learned.learned
        ),
    )
    check_automaton(automaton)
    return automaton


def _check_reach(contact: Contact, surroundings: Surroundings) -> None:
    """Raises InputError if the hand cannot reach the end of the contact, where the object latches."""
    for axis, value in contact.end_of_hand.items():
        low, high = surroundings.lower[axis], surroundings.upper[axis]
        if not low <= value <= high:
            text = (
                f"pressed against '{contact.face.solid}' to the end, the object is held at {AXES[axis]} = {value:.4g} m"
            )
            raise InputError(
                f"contacts: {text}, beyond reach: {low:g} to {high:g}",
                remedy=f"let reach include it, or leave '{contact.face.solid}' out of contacts",
            )


def contact_states(grip: Grip, surroundings: Surroundings, joint: LearnedJoint) -> tuple[Contact, ...]:
    """The contact states of the moving part: ``line`` and ``surface``, with the face's solid where there are more."""
    frames = [
        (face, piece)
        for face in surroundings.faces
        for piece in touch_pieces(grip, face, joint.datum, joint.low, joint.high, joint.turns)
    ]
    kinds = [piece.kind for _, piece in frames]
    several = len(surroundings.faces) > 1
    contacts: list[Contact] = []
    for face, piece in frames:
        name = f"{piece.kind} on {face.solid}" if several else piece.kind
        if (kinds.count(piece.kind) > 1 and not several) or any(c.name == name for c in contacts):
            name += f" {1 + sum(c.piece.kind == piece.kind and c.face == face for c in contacts)}"
        contacts.append(Contact(name, face, piece))
    return tuple(contacts)


@dataclass(frozen=True)
class _Product:
    """Builds modes and edges."""

    grip: Grip
    surroundings: Surroundings
    noise: HandNoise
    joint: LearnedJoint
    contacts: tuple[Contact, ...]

    def modes(self) -> list[Mode]:
        """The free mode, the contacts, and the latches."""
        return [self._free(), *map(self._contact, self.contacts), *map(self._latched, self.joint.latches)]

    def edges(self) -> list[Edge]:
        """All edges but collisions."""
        return [*self._contact_edges(), *self._latch_edges(), *self._range_edges(), *self._resting_edges()]

    def collisions(self, modes: list[Mode]) -> Iterator[Edge]:
        """Edges from every mode into a body."""
        for mode in modes:
            low, high = mode.interval(_JOINT)
            for region in collision_regions(
                self.grip, self.surroundings, self.joint.datum, low, high, self.joint.turns
            ):
                yield Edge(mode.name, COLLIDED, region)

    def _free(self) -> Mode:
        rows = [c.above for c in self.contacts if c.is_line and self._lines_on(c.face) == 1]
        joints = mode_joints(self.grip, self.joint)
        return Mode(FREE, joints, _HAND_FREE, self._hand_region(self.joint.low, self.joint.high, rows))

    def _contact(self, contact: Contact) -> Mode:
        tie, piece = contact.tie, contact.piece
        low, high = sorted((piece.begin, piece.end))
        joints = mode_joints(self.grip, self.joint, turned_from=None if contact.is_line else piece.begin)
        flow = (*_HAND_FREE[:3], tie.weights[:3])
        return Mode(contact.name, joints, flow, self._hand_region(low, high), ties=(tie,))

    def _latched(self, latch: LatchedMode) -> Mode:
        at = latch.pin.value
        rows = [
            _half_space_beyond(f.axis, self._lowest_hand_position(latch, f), f.sign, AXES[f.axis])
            for f in self.surroundings.faces
        ]
        joints, pin = mode_joints(self.grip, self.joint, rigid_at=at), Pin(_JOINT, at, latch.pin.std)
        return Mode(latch.mode, joints, _HAND_FREE, self._hand_region(-np.inf, np.inf, rows), pins=(pin,))

    def _contact_edges(self) -> Iterator[Edge]:
        """Edges into contact, between pieces, out of contact, and at the end of the last piece."""
        for contact in self.contacts:
            piece, face = contact.piece, contact.face
            on_face = [contact for contact in self.contacts if contact.face == face]
            follower = next((following for following in on_face if following.piece.begin == piece.end), None)
            if contact.is_line:
                yield Edge(FREE, contact.name, self._contact_guard(contact), contact.entry)
                if not any(before.piece.end == piece.begin for before in on_face):
                    yield Edge(contact.name, FREE, Region((self._withdrawal_guard(face),)))
            if follower is not None:
                onward = Region((self._past(piece.end, piece.direction),))
                yield Edge(contact.name, follower.name, onward, follower.entry)
                # Only a hand that withdraws leads back: a belief that spreads over the boundary does not.
                back = Region((self._withdrawal_guard(face), self._past(piece.end, -piece.direction, strict=True)))
                yield Edge(follower.name, contact.name, back, contact.entry)
            elif self._latch_after(contact) is None:
                # Pressing does not get any further: the hand is stopped.
                stop = Region((self._past(piece.end, piece.direction, strict=True),))
                yield Edge(contact.name, contact.name, stop, Reset.to({**contact.end_of_hand, _JOINT: piece.end}, _N))

    def _latch_edges(self) -> Iterator[Edge]:
        for latch in self.joint.latches:
            guard = Region((_half_space_beyond(_JOINT, latch.threshold, latch.direction, "latch"),))
            for contact in self.contacts:
                if self._latch_after(contact) is latch:
                    yield Edge(contact.name, latch.mode, guard, Reset.to(contact.end_of_hand, _N), latch.threshold_std)
            yield Edge(FREE, latch.mode, guard, threshold_std=latch.threshold_std)

    def _range_edges(self) -> Iterator[Edge]:
        """Edges at the joint's stops while it swings freely."""
        latched = {latch.threshold for latch in self.joint.latches}
        for value, direction in ((self.joint.low, -1), (self.joint.high, 1)):
            if value not in latched:
                stop = Region((self._past(value, direction, strict=True),))
                yield Edge(FREE, FREE, stop, Reset.to({_JOINT: value}, _N))

    def _resting_edges(self) -> Iterator[Edge]:
        """Edges of a latched object on a face, below which the hand cannot go."""
        for latch in self.joint.latches:
            for face in self.surroundings.faces:
                value = self._lowest_hand_position(latch, face)
                guard = _half_space_beyond(face.axis, value, -face.sign, AXES[face.axis], strict=True)
                yield Edge(latch.mode, latch.mode, Region((guard,)), Reset.to({face.axis: value}, _N))

    def _contact_guard(self, contact: Contact) -> Region:
        """The guard of contact: below the touching height, in the range of its edge if several edges may touch."""
        rows, piece = [contact.touching], contact.piece
        if self._lines_on(contact.face) > 1:
            rows.append(self._past(piece.begin, piece.direction))
            rows.append(self._past(piece.end, -piece.direction, strict=True))
        return Region(tuple(rows))

    def _lines_on(self, face: Face) -> int:
        return sum(contact.face == face and contact.is_line for contact in self.contacts)

    def _past(self, value: float, direction: int, *, strict: bool = False) -> HalfSpace:
        return _half_space_beyond(_JOINT, value, direction, self.grip.coordinate, strict=strict)

    def _latch_after(self, contact: Contact) -> LatchedMode | None:
        """The latch at the end of a contact's piece."""
        end = contact.piece.direction, contact.piece.end
        return next((latch for latch in self.joint.latches if (latch.direction, latch.threshold) == end), None)

    def _withdrawal_guard(self, face: Face) -> HalfSpace:
        """The guard of a hand that moves away from a face."""
        b = [0.0] * _M
        b[face.axis] = float(face.sign)
        return HalfSpace((0.0,) * _N, tuple(b), self.noise.release, strict=True, name=f"withdrawing from {face.solid}")

    def _lowest_hand_position(self, latch: LatchedMode, face: Face) -> float:
        """Lowest hand position of a latched object at a face: as it latched, or as it rests [m]."""
        heights = [c.piece.end_height for c in self.contacts if c.face == face and self._latch_after(c) is latch]
        heights.append(resting_height(self.grip, face, self.joint.datum, latch.threshold, self.joint.turns))
        return face.position + face.sign * min(heights)

    def _hand_region(self, low: float, high: float, rows: Sequence[HalfSpace] = ()) -> Region:
        """The hand within its limits, the joint between two values, and further half-spaces."""
        lower, upper = (*self.surroundings.lower, low), (*self.surroundings.upper, high)
        return box(lower, upper, _M, (*AXES, "theta")).intersection(Region(tuple(rows)))


def _half_space_beyond(coordinate: int, value: float, direction: int, name: str, *, strict: bool = False) -> HalfSpace:
    """The half-space of a coordinate at or beyond a value in a direction."""
    return (above if direction > 0 else below)(coordinate, value, _N, _M, strict=strict, name=name)


@dataclass(frozen=True)
class LatchedMode:
    """A rigid mode that the joint reaches.

    Attributes:
        mode: its name.
        pin: of the joint.
        threshold: configuration at which it is reached [rad or m]; threshold_std: of it.
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
    latches: tuple[LatchedMode, ...]
    process_std: float
    observation_std: float

    @property
    def turns(self) -> bool:
        return self.kind == "revolute"


def learned_joint(automaton: HybridAutomaton, grip: Grip) -> LearnedJoint:
    """The joint of a learned automaton.

    Raises:
        InputError: unless it has one coordinate that one mode moves, by a revolute or prismatic joint, by one turn at
            most, and a datum.
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
    above = [latch.threshold for latch in latches if latch.direction > 0]
    below = [latch.threshold for latch in latches if latch.direction < 0]
    high = mode.interval(0)[1]
    datum = [*above, high][0] if grip.datum is None else grip.datum
    if grip.datum is None and not math.isfinite(datum):
        remedy = "give the configuration at which the parts' shapes are described as `datum`"
        raise InputError("the model neither latches nor ends anywhere, so its shapes have no datum", remedy=remedy)
    low = max([datum - grip.travel, *below])
    high = min([max(datum, high if math.isfinite(high) else datum), *above])
    if kind == "revolute" and high - low > 2 * math.pi:
        problem = f"the contacts of a part that turns are those of one turn, {quantity(2 * math.pi, 'rad')}"
        raise InputError(f"{problem}. Got {quantity(high - low, 'rad')}", remedy="lower `travel`")
    return LearnedJoint(
        kind,
        mode.name,
        low,
        high,
        datum,
        latches,
        automaton.noise.process_std[0],
        automaton.noise.observation_std[0],
    )


def _latch(automaton: HybridAutomaton, edge: Edge) -> LatchedMode | None:
    """The rigid mode that an edge leads to; None for other targets."""
    pins = automaton.mode(edge.target).pins
    bound = edge.guard.half_spaces[0].bound if len(edge.guard.half_spaces) == 1 else None
    if not pins or bound is None:
        return None
    return LatchedMode(edge.target, pins[0], bound.value, edge.threshold_std, 1 if bound.is_lower else -1)


def links_of(grip: Grip) -> tuple[Link, ...]:
    """Links: base to hand by x, y and z; hand to held part, and held to moving part, by the joint."""
    chain = (BASE, *_CARRIAGES)
    slides = [Link(chain[i], chain[i + 1], i) for i in range(3)]
    return (*slides, Link(HAND, grip.held.name, 3), Link(grip.held.name, grip.moving.name, 3))


def mode_joints(
    grip: Grip, joint: LearnedJoint, *, rigid_at: float | None = None, turned_from: float | None = None
) -> tuple[Joint, ...]:
    """The joints of a mode, one per link.

    Args:
        rigid_at: configuration of the object's joint where the mode pins it.
        turned_from: configuration from which on the held part turns in the hand by as much as the joint closes.
    """
    rotation = Rotation.from_rotvec(grip.rotation)
    position, quaternion = -rotation.apply(grip.point), rotation.as_quat()
    slides = [prismatic(axis, (0.0, 0.0, 0.0)) for axis in np.eye(3)]
    if turned_from is None:
        in_hand = rigid(position, quaternion, 0.0 if rigid_at is None else rigid_at)
    else:
        axis = rotation.apply(HINGE)
        start = Rotation.from_rotvec(-turned_from * axis)
        in_hand = revolute(axis, (0.0, 0.0, 0.0), start.apply(position), (start * rotation).as_quat())
    offset = (0.0 if rigid_at is None else rigid_at) - joint.datum
    if joint.turns:
        place, at = np.zeros(3), Rotation.from_rotvec((0.0, -offset, 0.0)).as_quat()
        hinge = revolute((0.0, -1.0, 0.0), (0.0, 0.0, 0.0), place, at)
    else:
        place, at = np.array([0.0, 0.0, offset]), np.array(IDENTITY)
        hinge = prismatic((0.0, 0.0, 1.0), place)
    return (*slides, in_hand, hinge if rigid_at is None else rigid(place, at, rigid_at))
