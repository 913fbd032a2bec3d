"""The hybrid automaton H = (Q, X, U, Init, f, I, E, G, R, φ) of an articulated object.

Source: MICAH, sections III-C and IV-B; Lygeros, Sastry and Tomlin, "Hybrid systems".

Wrong sizes in an automaton made by hand are reported when it is made, with the names of its elements. Values can still
be inconsistent; `check.check_automaton` reports where.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.certainty import LearnedEdge
from micah_plan.automaton.effects.value import Effect, InputMemory
from micah_plan.automaton.joint import Joint, Quaternion, Vector3
from micah_plan.automaton.region import Interval, Region
from micah_plan.automaton.sensing import Light, Sensing
from micah_plan.errors import InputError, shown
from micah_plan.quantities import count, interval, quantity
from micah_plan.summaries import Summarised, aligned, listed

Matrix = tuple[tuple[float, ...], ...]

Sizes = tuple[int, ...]

_MOST = 4


@dataclass(frozen=True)
class Coordinate:
    """A continuous state or input.

    Attributes:
        name: e.g. the name of the part that it moves.
        unit: ``"rad"`` or ``"m"``; ``""`` for the threshold of an uncertain boundary, which nothing moves
            (`drawn_thresholds.with_boundary_states`).
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

    In the mode, no input and no noise moves the coordinate, a state elsewhere is set to `value`, and being in the mode
    is information, since the coordinate is known to `std`.

    Attributes:
        follows: another coordinate, never pinned, that adds to `value`: the place of an uncertain boundary
            (`drawn_thresholds.with_boundary_states`). None: none.
    """

    coordinate: int
    value: float
    std: float
    follows: int | None = None


@dataclass(frozen=True)
class Tie:
    """A tied coordinate of a mode: x[coordinate] = offset + weights'x, without noise of its own.

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

    def words(self, names: Sequence[str]) -> str:
        """The tie as an equation of coordinates by name, as ``h2 = -2 h1 + 0.1``."""
        terms = [f"{weight:g} {name}" for weight, name in zip(self.weights, names, strict=True) if weight]
        terms += [f"{self.offset:g}"] if self.offset or not terms else []
        return f"{names[self.coordinate]} = {' + '.join(terms)}".replace("+ -", "- ")


@dataclass(frozen=True)
class Reset:
    """The affine map x⁺ = A x + B u + c that a transition applies. A None stands for the identity A and zero B, c."""

    A: Matrix | None = None
    B: Matrix | None = None
    c: tuple[float, ...] | None = None

    @staticmethod
    def to(values: Mapping[int, float], n: int, ties: Sequence[Tie] = ()) -> Reset:
        """A reset that sets some of n coordinates to values and others by ties; the rest are unchanged."""
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
        observation_std: (coordinate, std) of measurements in this mode, at any place [rad or m]; others have the
            model's noise.
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
        """(n, m) input matrix."""
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
        """(low, high) of a coordinate: its pin, or the bounds of the invariant; low > high if empty."""
        return self.intervals[coordinate]

    @cached_property
    def intervals(self) -> tuple[Interval, ...]:
        """(n,) intervals of all coordinates, see `interval`."""
        pinned = {pin.coordinate: (pin.value, pin.value) for pin in reversed(self.pins)}
        coordinates = range(len(self.input_matrix))
        return tuple(pinned[i] if i in pinned else self.invariant.interval(i) for i in coordinates)


@dataclass(frozen=True)
class Edge:
    """A transition: taken when the guard holds; of several that hold at the same moment the first listed is taken.

    A self transition (source == target) is a clamp: its reset keeps x at the end of the range.

    Attributes:
        threshold_std: std of the thresholds of the guard's half-spaces on x, in their unit. The object has one
            threshold, the same at every passage; the std is that of its estimate.
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
        init: Init, regions of x per mode name; empty: the invariants.
        provenance: origin of the model (recording digest, method, seed, versions), as text.
        learned: how certain learning was; empty for a model that was not learned.
        effects: added by `with_effect`; those on guards and joints are already in `modes` and `edges`, the others act
            in every step.
        input_memories: memories of effects, where they are part of the state (`input_memory`); empty: steps ignore
            these effects.
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
        """Cache of `memoised` functions (`memo`); excluded from comparison and pickling.

        Cached values refer to the automaton: kept with it, both are freed together, which a separate table could not
        do.
        """
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
        number = self._mode_numbers.get(name)
        return _number(name, self.mode_names, "mode") if number is None else number

    def has_mode(self, name: str) -> bool:
        """Whether a mode with this name exists."""
        return name in self._mode_numbers

    @cached_property
    def _mode_numbers(self) -> dict[str, int]:
        """Mode indices by name; the first of repeated names."""
        return {name: i for i, name in reversed(list(enumerate(self.mode_names)))}

    def mode(self, name: str) -> Mode:
        """The mode of a name; raises as `mode_index` does."""
        return self.modes[self.mode_index(name)]

    def index(self, coordinate: str) -> int:
        """Index of a coordinate by name.

        Raises:
            InputError: if there is none; the message lists the names.
        """
        return _number(coordinate, self.coordinate_names, "coordinate")

    def state(self, values: Mapping[str, float] | ArrayLike) -> Floats:
        """(n,) a state from values by the names of coordinates, or in their order [rad or m].

        Raises:
            InputError: an unknown or a missing name, a wrong number of values, or one that is not finite.
        """
        state_vector = vector(values, self.coordinate_names, "x", "coordinate")
        missing = [name for name in self.coordinate_names if isinstance(values, Mapping) and name not in values]
        if missing:
            raise InputError(f"the state has no value of {', '.join(missing)}", remedy="give one of each coordinate")
        return state_vector

    def input(self, values: Mapping[str, float] | ArrayLike) -> Floats:
        """(m,) an input from values by the names of inputs, 0 where there is none; or in their order [rad or m].

        Raises:
            InputError: an unknown name, a wrong number of values, or one that is not finite.
        """
        return vector(values, self.input_names, "u", "input")

    def named(self, x: ArrayLike) -> dict[str, float]:
        """The values of a state (n,) by the names of their coordinates [rad or m]."""
        return dict(zip(self.coordinate_names, self.state(x).tolist(), strict=True))

    def edge(self, name: str, number: int | None = None) -> Edge:
        """The transition ``"source -> target"``.

        Args:
            number: index among edges of that name, in order of priority, from 0; None: there is one.

        Raises:
            InputError: if there is none, or several and no number.
        """
        names = tuple(edge.name for edge in self.edges)
        _number(name, names, "transition")
        edges = [edge for edge in self.edges if edge.name == name]
        if number is None and len(edges) > 1:
            raise InputError(f"{len(edges)} transitions are {shown(name)}", remedy="choose one by a number from 0")
        if not 0 <= (number or 0) < len(edges):
            raise InputError(
                f"there is no transition {shown(name)} number {number}", remedy=f"give 0 to {len(edges) - 1}"
            )
        return edges[number or 0]

    def edges_from(self, name: str) -> tuple[Edge, ...]:
        """All edges that leave a mode, self transitions included, in order of priority."""
        return self._edges_by_source.get(name, ())

    @cached_property
    def _edges_by_source(self) -> dict[str, tuple[Edge, ...]]:
        by_name: dict[str, list[Edge]] = {}
        for edge in self.edges:
            by_name.setdefault(edge.source, []).append(edge)
        return {name: tuple(edges) for name, edges in by_name.items()}

    def sensing(self, mode: Mode) -> Sensing:
        """The measurement model of a mode: its own stds where stated, else the model's noise with its light."""
        std, light = list(self.noise.observation_std), self.noise.light
        growth = [0.0] * self.n if light is None else list(light.growth)
        for i, own in mode.observation_std:
            std[i], growth[i] = own, 0.0
        return Sensing(tuple(std), tuple(growth), () if light is None else light.at)

    def pins_located_by(self, edge: Edge) -> tuple[Pin, ...]:
        """The target's pins that do not depend on the state before: located by the guard, or set by the reset."""
        a, b, c = edge.reset.matrices(self.n, self.m)
        located = (a != np.eye(self.n)).any(axis=1) | b.any(axis=1) | (c != 0.0)
        located |= np.any([h.a for h in edge.guard.half_spaces], axis=0)
        return tuple(pin for pin in self.mode(edge.target).pins if located[pin.coordinate])

    def pins_met_by(self, edge: Edge) -> tuple[Pin, ...]:
        """Pins of the target that are not located by the edge: each adds information."""
        others = {*self.pins_located_by(edge), *self.mode(edge.source).pins}
        return tuple(pin for pin in self.mode(edge.target).pins if pin not in others)

    def ranges(self, coordinate: int, modes: Iterable[Mode] | None = None) -> list[Interval]:
        """(low, high) intervals of a coordinate over modes (None: all), merged and in increasing order.

        Only half-spaces on this coordinate alone, and pins; others can narrow the true range further.
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
    """The index of a name; an InputError lists the names that there are."""
    if name not in names:
        remedy = f"choose one of {', '.join(dict.fromkeys(names))}" if names else f"the model has no {what}"
        raise InputError(f"unknown {what} {shown(name)}", remedy=remedy)
    return names.index(name)


def vector(values: Mapping[str, float] | ArrayLike, names: tuple[str, ...], symbol: str, what: str) -> Floats:
    """Finite values by names, 0 where there is none, or in their order.

    Args:
        symbol: name of the vector in errors; what: the elements with one value each.
    """
    if isinstance(values, Mapping):
        for name in values:
            _number(name, names, what)
        values = [values.get(name, 0.0) for name in names]
    try:
        array = np.array(values, dtype=float)
    except (TypeError, ValueError):
        array = np.full(0, np.nan)
    if array.shape != (len(names),) or not np.isfinite(array).all():
        shown_values = values.tolist() if isinstance(values, np.ndarray) else values
        raise InputError(f"{symbol} must be {len(names)} finite numbers. Got {shown(shown_values)}")
    return array


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    array.setflags(write=False)
    return array


def check_sizes(automaton: HybridAutomaton) -> None:
    """Refuse matrices, regions and stds whose sizes do not match the coordinates and inputs.

    Raises:
        InputError: with the mode, edge or noise, the size it must have and for which names, and the one it has.
    """
    n, m = automaton.n, automaton.m
    rows = f"one for each coordinate ({', '.join(coordinate.name for coordinate in automaton.coordinates)})"
    columns = f"one column for each input ({', '.join(given.name for given in automaton.inputs)})"
    for mode in automaton.modes:
        _check_mode(automaton, mode, f"{rows}, {columns}")
    for edge in automaton.edges:
        _check_edge(edge, n, m, rows)
    for name in ("process_std", "observation_std"):
        _check_length(getattr(automaton.noise, name), n, f"noise: {name}", rows)
    for name, region in automaton.init:
        _check_region(region, n, m, f"init of mode {name}")


def _check_mode(automaton: HybridAutomaton, mode: Mode, why: str) -> None:
    n, m, where = automaton.n, automaton.m, f"mode {mode.name}"
    if len(mode.joints) != len(automaton.links):
        names = ", ".join(link.child for link in automaton.links) or "none"
        raise InputError(
            f"{where}: must have {len(automaton.links)} joints, one for each link ({names}). Got {len(mode.joints)}"
        )
    _check_matrix(mode.input_matrix, (n, m), f"{where}: input_matrix", why)
    _check_region(mode.invariant, n, m, f"{where}: invariant")
    _check_region(mode.inputs, n, m, f"{where}: inputs")


def _check_edge(edge: Edge, n: int, m: int, rows: str) -> None:
    where = f"edge {edge.name}"
    _check_region(edge.guard, n, m, f"{where}: guard")
    for name, matrix, size in (("A", edge.reset.A, (n, n)), ("B", edge.reset.B, (n, m))):
        if matrix is not None:
            _check_matrix(matrix, size, f"{where}: reset matrix {name}", rows)
    if edge.reset.c is not None:
        _check_length(edge.reset.c, n, f"{where}: reset offset c", rows)


def _check_region(region: Region, n: int, m: int, where: str) -> None:
    for k, half_space in enumerate(region.half_spaces):
        if (len(half_space.a), len(half_space.b)) != (n, m):
            named = f" '{half_space.name}'" if half_space.name else ""
            raise InputError(
                f"{where}, half-space {k + 1}{named}: must have {n} weights of coordinates and {m} of inputs. "
                f"Got {len(half_space.a)} and {len(half_space.b)}"
            )


def _check_matrix(matrix: Sequence[Sequence[float]], size: Sizes, where: str, why: str) -> None:
    try:
        widths = {len(row) for row in matrix}
    except TypeError:
        raise InputError(f"{where}: must be rows of numbers, {why}. Got {shown(matrix)}") from None
    if len(matrix) != size[0] or widths - {size[1]}:
        shape = f"{len(matrix)} x {' or '.join(map(str, sorted(widths))) or 0}"
        raise InputError(f"{where}: must be {size[0]} x {size[1]}: {why}. Got {shape}")


def _check_length(values: Sequence[float], n: int, where: str, rows: str) -> None:
    if len(values) != n:
        raise InputError(f"{where}: must be {n} numbers, {rows}. Got {len(values)}")


def summary_of(automaton: HybridAutomaton) -> str:
    """Its coordinates with their ranges, modes, changes of mode, noise and effects."""
    changes = [edge for edge in automaton.edges if not edge.is_self_transition]
    more = f"; and {len(changes) - _MOST} more" if len(changes) > _MOST else ""
    return aligned(
        "Hybrid automaton",
        {
            "coordinates": listed([_coordinate(automaton, i) for i in range(automaton.n)]),
            "parts": listed([f"{link.child} on {link.parent}" for link in automaton.links]),
            "modes": listed(automaton.mode_names),
            "changes": "; ".join(_change(edge) for edge in changes[:_MOST]) + more,
            "step noise": _stds(automaton, automaton.noise.process_std),
            "measured to": _stds(automaton, automaton.noise.observation_std),
            "effects": listed([f"{effect.name} of {effect.coordinate}" for effect in automaton.effects]),
            "learned": "" if not automaton.learned else "from a recording",
        },
    )


def _coordinate(automaton: HybridAutomaton, i: int) -> str:
    ranges = " or ".join(interval(*ends, automaton.coordinates[i].unit, degrees=False) for ends in automaton.ranges(i))
    return f"{automaton.coordinates[i].name} ({ranges or 'nowhere'})"


def _change(edge: Edge) -> str:
    names = [half_space.name for half_space in edge.guard.half_spaces if half_space.name]
    at = f" where {' and '.join(names)}" if names else f" ({count(len(edge.guard.half_spaces), 'condition')})"
    return f"{edge.name}{at}"


def _stds(automaton: HybridAutomaton, stds: tuple[float, ...]) -> str:
    units = [coordinate.unit for coordinate in automaton.coordinates]
    return listed([quantity(std, unit, digits=2, degrees=False) for std, unit in zip(stds, units, strict=True)])
