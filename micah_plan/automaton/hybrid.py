"""The hybrid automaton H = (Q, X, U, Init, f, I, E, G, R, φ) of an articulated object.

Source: MICAH, sections III-C and IV-B; Lygeros, Sastry and Tomlin, "Hybrid systems".
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.certainty import LearnedEdge
from micah_plan.automaton.effects.value import Effect, InputMemory
from micah_plan.automaton.joint import Joint, Quaternion, Vector3
from micah_plan.automaton.region import Interval, Region
from micah_plan.automaton.sensing import Light, Sensing
from micah_plan.automaton.sizes import check_sizes
from micah_plan.automaton.summary import summary_of
from micah_plan.errors import InputError, shown
from micah_plan.summaries import Summarised

Matrix = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Coordinate:
    """A continuous state or input.

    Attributes:
        name: e.g. the name of the part that it moves.
        unit: ``"rad"`` or ``"m"``; ``""`` for the place of an uncertain boundary, which nothing moves
            (`thresholds.with_boundary_states`).
    """

    name: str
    unit: str

    def __post_init__(self) -> None:
        if self.unit not in ("rad", "m", ""):
            raise InputError(f"unit of {self.name} must be one of rad, m. Got {shown(self.unit)}")


@dataclass(frozen=True)
class Primitive:
    """A shape fixed to a part, for drawing and for physics.

    Attributes:
        kind: ``"box"`` (size: full lengths x, y, z), ``"cylinder"`` (size: radius, length along z) or ``"sphere"``.
        size: in m.
        position, quaternion: its pose in the part's frame.
        color: ``"#rrggbb"``.
    """

    kind: str
    size: tuple[float, ...]
    position: Vector3 = (0.0, 0.0, 0.0)
    quaternion: Quaternion = (0.0, 0.0, 0.0, 1.0)
    color: str = "#9aa5b1"


@dataclass(frozen=True)
class Part:
    """A rigid body of the object.

    Attributes:
        handle: where a hand holds it, in the part's frame [m]; None: the part's origin.
    """

    name: str
    shapes: tuple[Primitive, ...] = ()
    handle: Vector3 | None = None


@dataclass(frozen=True)
class Link:
    """A kinematic edge: the pose of `child` relative to `parent` follows coordinate number `coordinate`."""

    parent: str
    child: str
    coordinate: int


@dataclass(frozen=True)
class Pin:
    """A coordinate that a mode fixes at one value: a rigid joint at its configurational changepoint.

    To pin means this and nothing else: no input and no noise moves the coordinate, a state elsewhere is put at `value`,
    and being in the mode is information, since the coordinate is known to `std`.

    Attributes:
        follows: another coordinate, never pinned, that adds to `value`: the place of an uncertain boundary
            (`thresholds.with_boundary_states`). None: none.
    """

    coordinate: int
    value: float
    std: float
    follows: int | None = None


@dataclass(frozen=True)
class Tie:
    """A coordinate that a mode lets follow others: x[coordinate] = offset + weights'x, as a contact makes an angle
    follow a height. No noise of its own moves it: what moves the others moves it too.

    Attributes:
        weights: (n,) with 0 for the coordinate itself.
        offset: in the coordinate's unit.
    """

    coordinate: int
    weights: tuple[float, ...]
    offset: float

    def value(self, x: Floats) -> Floats:
        """x[coordinate] for states x (..., n)."""
        return np.asarray(self.offset + x @ np.array(self.weights))


@dataclass(frozen=True)
class Reset:
    """The affine map x⁺ = A x + B u + c that a transition applies. A None stands for the identity A and zero B, c."""

    A: Matrix | None = None
    B: Matrix | None = None
    c: tuple[float, ...] | None = None

    @staticmethod
    def to(values: Mapping[int, float], n: int, ties: Sequence[Tie] = ()) -> Reset:
        """Puts some of n coordinates at values, and others where ties say; the rest keep theirs."""
        A, c = np.eye(n), np.zeros(n)
        for i, value in values.items():
            A[i], c[i] = 0.0, value
        for tie in ties:
            weights = np.array(tie.weights)
            A[tie.coordinate], c[tie.coordinate] = weights @ A, tie.offset + weights @ c
        return Reset(A=tuple(map(tuple, A.tolist())), c=tuple(c.tolist()))

    @property
    def is_identity(self) -> bool:
        return self.A is None and self.B is None and self.c is None

    def matrices(self, n: int, m: int) -> tuple[Floats, Floats, Floats]:
        """A (n, n), B (n, m), c (n,)."""
        a = np.eye(n) if self.A is None else np.array(self.A, dtype=float)
        b = np.zeros((n, m)) if self.B is None else np.array(self.B, dtype=float)
        return a, b, np.zeros(n) if self.c is None else np.array(self.c, dtype=float)

    def apply(self, x: Floats, u: Floats) -> Floats:
        """x⁺ for x (..., n), u (..., m)."""
        a, b, c = self.matrices(np.shape(x)[-1], np.shape(u)[-1])
        return np.asarray(x @ a.T + u @ b.T + c)


@dataclass(frozen=True)
class Mode:
    """A discrete state q.

    Attributes:
        name: unique in the automaton.
        joints: one per link, in the order of the automaton's links.
        input_matrix: B (n, m) of the local dynamics f: x⁺ = x + B u (u is a displacement, in the coordinate's unit).
        invariant: I(q), where the mode's dynamics hold.
        inputs: φ(q, x), the admissible inputs.
        pins: coordinates that the mode fixes.
        observation_std: (coordinate, std) of what the mode measures in its own way, wherever it is [rad or m]; the rest
            is measured as the model's noise says.
        ties: coordinates that follow others. The flow must keep them, and transitions into the mode establish them.
    """

    name: str
    joints: tuple[Joint, ...]
    input_matrix: Matrix
    invariant: Region = field(default_factory=Region)
    inputs: Region = field(default_factory=Region)
    pins: tuple[Pin, ...] = ()
    observation_std: tuple[tuple[int, float], ...] = ()
    ties: tuple[Tie, ...] = ()

    @cached_property
    def B(self) -> Floats:  # noqa: N802 (the mathematics calls it B)
        return _read_only(np.array(self.input_matrix, dtype=float))

    @cached_property
    def driven(self) -> Booleans:
        """(n,) whether an input moves the coordinate."""
        return _read_only(np.any(self.B, axis=1))

    @cached_property
    def free(self) -> Booleans:
        """(n,) whether the mode leaves the coordinate free; false where it pins it."""
        free = np.ones(len(self.input_matrix), dtype=bool)
        free[[pin.coordinate for pin in self.pins]] = False
        return _read_only(free)

    def interval(self, coordinate: int) -> Interval:
        """(low, high) of a coordinate: its pin, or what the invariant leaves; low > high if that is nothing."""
        pinned = next((pin.value for pin in self.pins if pin.coordinate == coordinate), None)
        return self.invariant.interval(coordinate) if pinned is None else (pinned, pinned)


@dataclass(frozen=True)
class Edge:
    """A transition: taken when the guard holds; of several that hold at the same moment the first listed is taken.

    A self transition (source == target) is a clamp: its reset keeps x at the end of the range.

    Attributes:
        threshold_std: how well the thresholds of the guard's half-spaces on x are known, in their unit. The object
            has one threshold, the same at every passage, but the model knows it only so well.
    """

    source: str
    target: str
    guard: Region
    reset: Reset = field(default_factory=Reset)
    threshold_std: float = 0.0

    @property
    def is_self_transition(self) -> bool:
        return self.source == self.target

    @property
    def name(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True)
class Noise:
    """Standard deviations per coordinate.

    Attributes:
        process_std: (n,) of the step that the dynamics leave unexplained [rad or m, per step].
        observation_std: (n,) of one measurement of the configuration [rad or m], in modes that state none of their own.
        light: where sensing is best; away from it `observation_std` grows. None: it is the same everywhere.
    """

    process_std: tuple[float, ...]
    observation_std: tuple[float, ...]
    light: Light | None = None


@dataclass(frozen=True, repr=False)
class HybridAutomaton(Summarised):
    """The object's motion model. Order matters: of modes for display, of edges for priority.

    Attributes:
        coordinates: X, the continuous states.
        inputs: U, the inputs (displacements).
        links: which coordinate moves which part.
        parts: the bodies, with the shapes to draw and the handle.
        modes: Q with f, I and φ.
        edges: E with G and R.
        noise: process and observation noise.
        init: Init, regions of x per mode name; empty: wherever an invariant allows.
        provenance: where the model came from (recording digest, method, seed, versions), as text.
        learned: how certain learning was; empty for a model that was not learned.
        effects: what was found to be missing and added by `with_effect`; those on guards and joints are already in
            `modes` and `edges`, the others act in every step.
        input_memories: what effects remember of inputs, where that is part of the state (`input_memory`); empty: steps
            ignore these effects.
    """

    coordinates: tuple[Coordinate, ...]
    inputs: tuple[Coordinate, ...]
    links: tuple[Link, ...]
    parts: tuple[Part, ...]
    modes: tuple[Mode, ...]
    edges: tuple[Edge, ...]
    noise: Noise
    init: tuple[tuple[str, Region], ...] = ()
    provenance: Mapping[str, str] = field(default_factory=dict)
    learned: tuple[LearnedEdge, ...] = ()
    effects: tuple[Effect, ...] = ()
    input_memories: tuple[InputMemory, ...] = ()

    def __post_init__(self) -> None:
        check_sizes(self)

    def summary(self) -> str:
        """Coordinates, modes, changes of mode and noise in a few lines."""
        return summary_of(self)

    @property
    def n(self) -> int:
        """Number of continuous states."""
        return len(self.coordinates)

    @property
    def m(self) -> int:
        """Number of inputs."""
        return len(self.inputs)

    @cached_property
    def derived(self) -> dict[Any, Any]:
        """Cache of `memoised` functions (`memo`); no part of the value, and not pickled."""
        return {}

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if name != "derived"}

    @cached_property
    def mode_names(self) -> tuple[str, ...]:
        """Names of the modes, in order."""
        return tuple(mode.name for mode in self.modes)

    @cached_property
    def coordinate_names(self) -> tuple[str, ...]:
        """(n,) names of the coordinates, in order."""
        return tuple(coordinate.name for coordinate in self.coordinates)

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """(m,) names of the inputs, in order."""
        return tuple(given.name for given in self.inputs)

    def mode_index(self, name: str) -> int:
        """Number of the mode of that name.

        Raises:
            InputError: if there is none; the message lists the names.
        """
        return _number(name, self.mode_names, "mode")

    def mode(self, name: str) -> Mode:
        """The mode of that name; raises what `mode_index` does."""
        return self.modes[self.mode_index(name)]

    def index(self, coordinate: str) -> int:
        """Number of the coordinate of that name.

        Raises:
            InputError: if there is none; the message lists the names.
        """
        return _number(coordinate, self.coordinate_names, "coordinate")

    def edges_from(self, name: str) -> tuple[Edge, ...]:
        """All edges that leave a mode, self transitions included, in order of priority."""
        return self._edges_by_source.get(name, ())

    @cached_property
    def _edges_by_source(self) -> dict[str, tuple[Edge, ...]]:
        found: dict[str, list[Edge]] = {}
        for edge in self.edges:
            found.setdefault(edge.source, []).append(edge)
        return {name: tuple(edges) for name, edges in found.items()}

    def sensing(self, mode: Mode) -> Sensing:
        """How a mode measures: by its own stds where it states them, else by the model's noise, with its light."""
        std, light = list(self.noise.observation_std), self.noise.light
        growth = [0.0] * self.n if light is None else list(light.growth)
        for i, own in mode.observation_std:
            std[i], growth[i] = own, 0.0
        return Sensing(tuple(std), tuple(growth), () if light is None else light.at)

    def pins_located_by(self, edge: Edge) -> tuple[Pin, ...]:
        """The target's pins of which the state before tells nothing: their guard is the place, or the reset puts it."""
        a, b, c = edge.reset.matrices(self.n, self.m)
        located = (a != np.eye(self.n)).any(axis=1) | b.any(axis=1) | (c != 0.0)
        located |= np.any([h.a for h in edge.guard.half_spaces], axis=0)
        return tuple(pin for pin in self.mode(edge.target).pins if located[pin.coordinate])

    def pins_met_by(self, edge: Edge) -> tuple[Pin, ...]:
        """The target's other pins that its source does not have: each is one more piece of information."""
        others = {*self.pins_located_by(edge), *self.mode(edge.source).pins}
        return tuple(pin for pin in self.mode(edge.target).pins if pin not in others)

    def ranges(self, coordinate: int, modes: Iterable[Mode] | None = None) -> list[Interval]:
        """What modes (None: all) allow for a coordinate, as intervals in increasing order; infinite without a limit.

        Only half-spaces on this coordinate alone count, and pins; others can narrow the true range further.
        """
        merged: list[Interval] = []
        for low, high in sorted(mode.interval(coordinate) for mode in (self.modes if modes is None else modes)):
            if low > high:
                continue
            if merged and low <= merged[-1][1]:
                merged[-1] = (merged[-1][0], max(merged[-1][1], high))
            else:
                merged.append((low, high))
        return merged

    def moving_joint(self, link: int) -> Joint:
        """The joint that measures a link's configuration: the first that is not rigid, over the modes in order."""
        joints = [mode.joints[link] for mode in self.modes]
        return next((joint for joint in joints if joint.moves), joints[0])

    def part(self, name: str) -> Part:
        """The part of that name, without shapes if the model describes none."""
        return next((part for part in self.parts if part.name == name), Part(name))

    def modes_at(self, x: Floats, tolerance: float = 0.0) -> tuple[str, ...]:
        """Names of the modes whose invariant x (n,) is in at zero input."""
        u = np.zeros(self.m)
        return tuple(mode.name for mode in self.modes if mode.invariant.contains(x, u, tolerance))


def _number(name: str, names: tuple[str, ...], what: str) -> int:
    if name not in names:
        raise InputError(f"unknown {what} {shown(name)}", remedy=f"choose one of {', '.join(names)}")
    return names.index(name)


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array
