"""A model document -> hybrid automaton: names to indices, expressions to matrices, and what must agree does."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Reset,
    Tie,
)
from micah_plan.automaton.joint import Joint, ParameterCovariance
from micah_plan.automaton.learned import LearnedEdge
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.sensing import Light
from micah_plan.documents.expressions import Affine, Variables, parse_affine, parse_half_space
from micah_plan.documents.learned_values import learned_of
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.model_document import (
    CovarianceDocument,
    EffectDocument,
    JointDocument,
    LightDocument,
    MatricesDocument,
    ModeDocument,
    ModelDocument,
    TransitionDocument,
)
from micah_plan.documents.part_document import ZERO
from micah_plan.documents.part_values import check_unit, parts_of
from micah_plan.errors import InputError, shown

_SYMMETRY_TOLERANCE = 1e-6
_UNUSED: Mapping[str, tuple[str, ...]] = {
    "rigid": ("axis", "center", "pitch"),
    "prismatic": ("center", "pitch", "held"),
    "revolute": ("pitch", "held"),
    "screw": ("held",),
}


# A model is square matrices of its coordinates, in each mode and transition: what a file may ask for is bounded.
MOST_ENTRIES = 10_000_000


def automaton_of(document: ModelDocument, located: Located) -> HybridAutomaton:
    """The automaton that a model file describes.

    Args:
        document: the validated layout.
        located: the data that it was validated from, for the places in messages.

    Raises:
        InputError: if names, sizes or values do not agree with each other.
    """
    entries = len(document.coordinates) ** 2 * (len(document.modes) + len(document.transitions))
    if entries > MOST_ENTRIES:
        problem = f"its matrices have {entries} entries, more than {MOST_ENTRIES}"
        raise located.error((), problem, "use fewer coordinates, modes or transitions")
    return _Builder(document, located).automaton()


def region_of(entries: Iterable[tuple[str, str | None]], names: Variables, located: Located, path: KeyPath) -> Region:
    """The region that a list of half-spaces describes."""
    return Region(tuple(_half_space(entry, names, located, (*path, i)) for i, entry in enumerate(entries)))


def _half_space(entry: tuple[str, str | None], names: Variables, located: Located, path: KeyPath) -> HalfSpace:
    try:
        return parse_half_space(entry[0], names, entry[1])
    except InputError as error:
        raise located.error(path, error.problem, error.remedy) from None


def by_name(
    values: Mapping[str, float], names: Sequence[str], what: str, located: Located, path: KeyPath
) -> list[float]:
    """The values in the order of the names, each of which must be there once.

    Raises:
        InputError: for an unknown or a missing name.
    """
    for name in values:
        if name not in names:
            raise located.unknown((*path, name), what, name, names)
    missing = [name for name in names if name not in values]
    if missing:
        raise located.error(path, f"missing value of {what} {', '.join(map(repr, missing))}", "give every one a value")
    return [values[name] for name in names]


def light_of(light: LightDocument | None, names: Sequence[str], located: Located, path: KeyPath) -> Light | None:
    """The light that a file describes; a coordinate without growth gains nothing.

    Raises:
        InputError: for an unknown name.
    """
    if light is None:
        return None
    for name in light.at:
        if name not in names:
            raise located.unknown((*path, "at", name), "coordinate", name, names)
    growth = by_name({**dict.fromkeys(names, 0.0), **light.growth}, names, "coordinate", located, (*path, "growth"))
    return Light(tuple((names.index(name), value) for name, value in light.at.items()), tuple(growth))


class _Builder:
    def __init__(self, document: ModelDocument, located: Located) -> None:
        self._document = document
        self._located = located
        self._names = Variables(tuple(document.coordinates), tuple(document.inputs))
        self._children = [link.child for link in document.links]

    def automaton(self) -> HybridAutomaton:
        document = self._document
        return HybridAutomaton(
            coordinates=tuple(Coordinate(name, unit) for name, unit in document.coordinates.items()),
            inputs=tuple(Coordinate(name, unit) for name, unit in document.inputs.items()),
            links=self._links(),
            parts=self._parts(),
            modes=tuple(self._mode(name, mode) for name, mode in document.modes.items()),
            edges=tuple(self._edge(edge, ("transitions", i)) for i, edge in enumerate(document.transitions)),
            noise=self._noise(),
            init=tuple(
                (
                    self._known_mode(item.mode, ("init", i, "mode")),
                    region_of(item.region, self._names, self._located, ("init", i, "region")),
                )
                for i, item in enumerate(document.init)
            ),
            provenance=dict(document.provenance),
            learned=self._learned(),
            effects=tuple(self._effect(effect, ("effects", i)) for i, effect in enumerate(document.effects)),
        )

    def _effect(self, effect: EffectDocument, path: KeyPath) -> Effect:
        self._index(effect.coordinate, (*path, "coordinate"))
        modes = tuple(self._known_mode(name, (*path, "modes")) for name in effect.modes)
        try:
            known = [parameter.name for parameter in form(effect.name).parameters]
        except InputError as error:
            raise self._located.error((*path, "name"), error.problem, error.remedy) from None
        values = by_name(effect.parameters, known, "parameter", self._located, (*path, "parameters"))
        std = by_name(effect.std, known, "parameter", self._located, (*path, "std")) if effect.std else []
        pairs = tuple(zip(known, values, strict=True))
        return Effect(effect.name, effect.coordinate, pairs, tuple(std), modes, effect.note)

    def _index(self, name: str, path: KeyPath) -> int:
        if name not in self._names.coordinates:
            raise self._located.unknown(path, "coordinate", name, self._names.coordinates)
        return self._names.coordinates.index(name)

    def _known_mode(self, name: str, path: KeyPath) -> str:
        if name not in self._document.modes:
            raise self._located.unknown(path, "mode", name, self._document.modes)
        return name

    def _links(self) -> tuple[Link, ...]:
        links = []
        for i, link in enumerate(self._document.links):
            if link.child in self._children[:i] or link.child == link.parent:
                problem = (
                    f"part '{link.child}' hangs on two parents" if link.child != link.parent else "a part moves itself"
                )
                raise self._located.error(("links", i, "child"), problem, "links form a tree")
            if link.parent in self._children[i:]:
                problem = f"parent '{link.parent}' is linked only later"
                raise self._located.error(("links", i, "parent"), problem, "list parents first")
            links.append(Link(link.parent, link.child, self._index(link.coordinate, ("links", i, "coordinate"))))
        return tuple(links)

    def _parts(self) -> tuple[Part, ...]:
        known = list(dict.fromkeys([BASE, *(n for link in self._document.links for n in (link.parent, link.child))]))
        for name in self._document.parts:
            if name not in known:
                raise self._located.unknown(("parts", name), "part", name, known)
        return parts_of(self._document.parts, self._located)

    def _learned(self) -> tuple[LearnedEdge, ...]:
        edges = [(link.parent, link.child) for link in self._document.links]
        for i, edge in enumerate(self._document.learned):
            if (edge.parent, edge.child) not in edges:
                names = ", ".join(f"{parent} to {child}" for parent, child in edges) or "none"
                problem = f"no link leads from {shown(edge.parent)} to {shown(edge.child)}"
                raise self._located.error(("learned", i), problem, f"links: {names}")
        return learned_of(self._document.learned, self._located)

    def _noise(self) -> Noise:
        noise, names = self._document.noise, self._names.coordinates
        process = by_name(noise.process_std, names, "coordinate", self._located, ("noise", "process_std"))
        observation = by_name(noise.observation_std, names, "coordinate", self._located, ("noise", "observation_std"))
        return Noise(
            tuple(process), tuple(observation), light_of(noise.light, names, self._located, ("noise", "light"))
        )

    def _mode(self, name: str, mode: ModeDocument) -> Mode:
        path: KeyPath = ("modes", name)
        for child in mode.joints:
            if child not in self._children:
                raise self._located.unknown((*path, "joints", child), "linked part", child, self._children)
        missing = [child for child in self._children if child not in mode.joints]
        if missing:
            problem = f"missing joint of part '{missing[0]}'"
            raise self._located.error((*path, "joints"), problem, "every mode has a joint for every link")
        pins = []
        for coordinate, pin in mode.pins.items():
            pins.append(Pin(self._index(coordinate, (*path, "pins", coordinate)), pin.value, pin.std))
        return Mode(
            name=name,
            joints=tuple(self._joint(mode.joints[child], (*path, "joints", child)) for child in self._children),
            input_matrix=self._step(mode.step, (*path, "step")),
            invariant=region_of(mode.invariant, self._names, self._located, (*path, "invariant")),
            inputs=region_of(mode.inputs, self._names, self._located, (*path, "inputs")),
            pins=tuple(pins),
            ties=tuple(
                self._tie(coordinate, text, (*path, "ties", coordinate)) for coordinate, text in mode.ties.items()
            ),
            observation_std=tuple(
                (self._index(coordinate, (*path, "observation_std", coordinate)), std)
                for coordinate, std in mode.observation_std.items()
            ),
        )

    def _tie(self, name: str, text: str, path: KeyPath) -> Tie:
        value = self._affine(text, path)
        if any(value.b):
            raise self._located.error(path, "a tie is about coordinates, not inputs", "write e.g. '0.9 - 6.8*z'")
        return Tie(self._index(name, path), tuple(value.a), value.constant)

    def _affine(self, text: str, path: KeyPath) -> Affine:
        try:
            return parse_affine(text, self._names)
        except InputError as error:
            raise self._located.error(path, error.problem, error.remedy) from None

    def _step(self, step: Mapping[str, str], path: KeyPath) -> tuple[tuple[float, ...], ...]:
        rows = [(0.0,) * len(self._names.inputs) for _ in self._names.coordinates]
        for name, text in step.items():
            index = self._index(name, (*path, name))
            change = self._affine(text, (*path, name))
            if any(change.a) or change.constant:
                remedy = "write only inputs, such as 'input door' or '0.5*input door'"
                raise self._located.error((*path, name), "a step is linear in the inputs", remedy)
            rows[index] = change.b
        return tuple(rows)

    def _joint(self, joint: JointDocument, path: KeyPath) -> Joint:
        check_unit(self._located, joint.quaternion, (*path, "quaternion"))
        for key in _UNUSED[joint.kind]:
            if getattr(joint, key) not in (ZERO, 0.0):
                problem = f"a {joint.kind} joint has no {key}"
                raise self._located.error((*path, key), problem, "remove it or correct the kind")
        if joint.kind != "rigid":
            check_unit(self._located, joint.axis, (*path, "axis"))
        covariance = None
        if joint.covariance is not None:
            covariance = self._covariance(joint.covariance, (*path, "covariance"))
        return Joint(
            joint.kind, joint.position, joint.quaternion, joint.axis, joint.center, joint.pitch, joint.held, covariance
        )

    def _covariance(self, covariance: CovarianceDocument, path: KeyPath) -> ParameterCovariance:
        names, rows = covariance.names, covariance.matrix
        if len(set(names)) < len(names):
            raise self._located.error((*path, "names"), "a parameter is named twice", "name each once")
        self._check_size(rows, len(names), len(names), (*path, "matrix"))
        matrix = np.array(rows)
        scale = float(np.abs(matrix).max())
        symmetric = np.abs(matrix - matrix.T).max() <= _SYMMETRY_TOLERANCE * scale
        lowest = 0.0 if scale == 0.0 else float(np.linalg.eigvalsh(matrix / scale)[0])
        if not symmetric or lowest < -_SYMMETRY_TOLERANCE:
            problem = "expected a symmetric positive semi-definite matrix"
            raise self._located.error((*path, "matrix"), problem, "correct it or leave the covariance out")
        return ParameterCovariance(tuple(names), tuple(map(tuple, rows)))

    def _check_size(self, rows: Sequence[Sequence[float]], height: int, width: int, path: KeyPath) -> None:
        if len(rows) != height or any(len(row) != width for row in rows):
            found = f"{len(rows)} rows of {', '.join(sorted({str(len(row)) for row in rows}))}"
            raise self._located.error(path, f"expected {height} rows of {width}, found {found}")

    def _edge(self, edge: TransitionDocument, path: KeyPath) -> Edge:
        source = self._known_mode(edge.source, (*path, "source"))
        target = self._known_mode(edge.target, (*path, "target"))
        if edge.reset and edge.reset_matrices is not None:
            problem = "both 'reset' and 'reset_matrices' are given"
            raise self._located.error((*path, "reset_matrices"), problem, "keep one of them")
        guard = region_of(edge.guard, self._names, self._located, (*path, "guard"))
        if edge.reset_matrices is not None:
            reset = self._matrices(edge.reset_matrices, (*path, "reset_matrices"))
        else:
            reset = self._reset(edge.reset, (*path, "reset"))
        return Edge(source, target, guard, reset, edge.threshold_std)

    def _reset(self, reset: Mapping[str, str], path: KeyPath) -> Reset:
        """The affine map of the expressions: A, B and c are there only if the expressions say something of them."""
        n, m = len(self._names.coordinates), len(self._names.inputs)
        a, b, c, has_constant = np.eye(n), np.zeros((n, m)), np.zeros(n), False
        for name, text in reset.items():
            index = self._index(name, (*path, name))
            value = self._affine(text, (*path, name))
            a[index], b[index], c[index] = value.a, value.b, value.constant
            has_constant |= value.has_constant
        return Reset(
            None if np.array_equal(a, np.eye(n)) else tuple(map(tuple, a.tolist())),
            tuple(map(tuple, b.tolist())) if b.any() else None,
            tuple(c.tolist()) if has_constant else None,
        )

    def _matrices(self, matrices: MatricesDocument, path: KeyPath) -> Reset:
        n, m = len(self._names.coordinates), len(self._names.inputs)
        for key, rows, width in (("A", matrices.A, n), ("B", matrices.B, m)):
            if rows is not None:
                self._check_size(rows, n, width, (*path, key))
        if matrices.c is not None:
            self._check_size([matrices.c], 1, n, (*path, "c"))
        return Reset(
            None if matrices.A is None else tuple(map(tuple, matrices.A)),
            None if matrices.B is None else tuple(map(tuple, matrices.B)),
            None if matrices.c is None else tuple(matrices.c),
        )
