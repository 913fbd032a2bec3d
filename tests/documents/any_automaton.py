"""Hypothesis strategies: automata with all that a model file can say, valid by construction."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st

from micah_plan.automaton.certainty import (
    ActionChannel,
    EdgeCertainty,
    LearnedEdge,
    LearnedSegment,
    RowPosterior,
    SegmentCertainty,
)
from micah_plan.automaton.hybrid import (
    Coordinate,
    Edge,
    HybridAutomaton,
    Link,
    Mode,
    Noise,
    Part,
    Pin,
    Primitive,
    Reset,
)
from micah_plan.automaton.joint import JOINT_KINDS, Joint, ParameterCovariance, prismatic, revolute, rigid, screw
from micah_plan.automaton.path import path
from micah_plan.automaton.region import HalfSpace, Region
from micah_plan.automaton.sensing import Light

NUMBERS = st.floats(allow_nan=False, allow_infinity=False, width=64)
PLACES = st.floats(-1e6, 1e6)
MODERATE = st.floats(-1e3, 1e3)
STDS = st.floats(1e-12, 1e3)
VISIBLE = st.characters(exclude_categories=["C", "Z"])
NAMES = st.text(VISIBLE, min_size=1, max_size=12) | st.sampled_from(
    ["x", "door", "input", "1", "true", "null", "upper arm", 'a"b', "it's", "e", "a: b", "#", "-", "~", "<<", "é"]
)
TEXTS = st.text(VISIBLE | st.just(" "), max_size=20)
VECTORS = st.tuples(MODERATE, MODERATE, MODERATE)
DIRECTIONS = VECTORS.map(lambda v: v if np.linalg.norm(v) > 1e-3 else (0.0, 0.0, 1.0))
QUATERNIONS = st.tuples(*[MODERATE] * 4).map(lambda v: v if np.linalg.norm(v) > 1e-3 else (0.0, 0.0, 0.0, 1.0))


def rows(count: int, width: int, numbers: st.SearchStrategy[float] = NUMBERS) -> st.SearchStrategy:
    return st.tuples(*[st.tuples(*[numbers] * width)] * count)


@st.composite
def covariances(draw: st.DrawFn) -> ParameterCovariance:
    names = draw(st.lists(st.sampled_from(["axis_1", "center_2", "pitch", "rotation_3"]), min_size=1, unique=True))
    root = np.array(draw(rows(len(names), len(names), st.floats(-1, 1))))
    return ParameterCovariance(tuple(names), tuple(map(tuple, (root @ root.T).tolist())))


@st.composite
def joints(draw: st.DrawFn) -> Joint:
    position, quaternion, axis = draw(VECTORS), draw(QUATERNIONS), draw(DIRECTIONS)
    made = {
        "rigid": lambda: rigid(position, quaternion, draw(MODERATE)),
        "prismatic": lambda: prismatic(axis, position, quaternion),
        "revolute": lambda: revolute(axis, draw(VECTORS), position, quaternion),
        "screw": lambda: screw(axis, draw(VECTORS), draw(MODERATE), position, quaternion),
        "path": lambda: path(draw(knots())),
    }[draw(st.sampled_from(JOINT_KINDS))]()
    return Joint(**{**vars(made), "covariance": draw(st.none() | covariances())})


@st.composite
def knots(draw: st.DrawFn) -> np.ndarray:
    c = np.cumsum(draw(st.lists(st.floats(0.01, 1.0), min_size=4, max_size=6)))
    poses = [(*draw(VECTORS), *draw(QUATERNIONS)) for _ in c]
    return np.column_stack([c, poses])


@st.composite
def half_spaces(draw: st.DrawFn, n: int, m: int) -> HalfSpace:
    weights = st.sampled_from([0.0, 1.0, -1.0, 0.5]) | NUMBERS
    row = draw(st.tuples(*[weights] * (n + m)).map(lambda w: w if any(w) else (-1.0, *w[1:])))
    return HalfSpace(row[:n], row[n:], draw(NUMBERS), draw(st.booleans()), draw(NAMES | st.just("")))


def regions(n: int, m: int) -> st.SearchStrategy[Region]:
    return st.lists(half_spaces(n, m), max_size=3).map(lambda rows: Region(tuple(rows)))


def resets(n: int, m: int) -> st.SearchStrategy[Reset]:
    few = st.sampled_from([0.0, 1.0, -1.0, 0.1]) | NUMBERS
    return st.builds(Reset, st.none() | rows(n, n, few), st.none() | rows(n, m, few), st.none() | st.tuples(*[few] * n))


SHAPES = st.builds(
    Primitive,
    st.just("box"),
    st.tuples(*[STDS] * 3),
    VECTORS,
    QUATERNIONS.map(lambda q: tuple((np.array(q) / np.linalg.norm(q)).tolist())),
    st.sampled_from(["#000000", "#9aA5b1"]),
) | st.builds(Primitive, st.just("sphere"), st.tuples(STDS))


@st.composite
def modes(draw: st.DrawFn, name: str, links: int, n: int, m: int) -> Mode:
    pinned = draw(st.lists(st.integers(0, n - 1), unique=True, max_size=n))
    return Mode(
        name,
        tuple(draw(joints()) for _ in range(links)),
        draw(rows(n, m, st.sampled_from([0.0, 1.0]) | NUMBERS)),
        draw(regions(n, m)),
        draw(regions(n, m)),
        tuple(Pin(i, draw(PLACES), draw(st.floats(0, 10))) for i in pinned),
        tuple((i, draw(STDS)) for i in draw(st.lists(st.integers(0, n - 1), unique=True, max_size=n))),
    )


@st.composite
def lights(draw: st.DrawFn, n: int) -> Light:
    places = draw(st.lists(st.integers(0, n - 1), unique=True, min_size=1, max_size=n))
    return Light(tuple((i, draw(PLACES)) for i in places), draw(st.tuples(*[st.floats(0, 10)] * n)))


@st.composite
def shares(draw: st.DrawFn, size: int) -> tuple[float, ...]:
    """Numbers that sum to 1."""
    weights = np.array([draw(st.floats(0, 1)) for _ in range(size)]) + 1e-3
    return tuple((weights / weights.sum()).tolist())


@st.composite
def segments(draw: st.DrawFn) -> LearnedSegment:
    start, length = draw(st.integers(0, 10**6)), draw(st.integers(0, 100))
    certainty = None
    if draw(st.booleans()):
        rows = sorted(draw(st.sets(st.integers(0, 10**6), min_size=1, max_size=4)))
        kinds = draw(st.lists(st.sampled_from(JOINT_KINDS), unique=True))
        probabilities = [p * draw(st.floats(0, 1)) for p in draw(shares(len(kinds)))]
        certainty = SegmentCertainty(
            draw(st.none() | st.just(RowPosterior(tuple(rows), draw(shares(len(rows)))))),
            tuple(zip(kinds, probabilities, strict=True)),
        )
    return LearnedSegment(
        draw(st.sampled_from(JOINT_KINDS)), draw(st.integers(-5, 5)), start, start + length, certainty
    )


@st.composite
def channels(draw: st.DrawFn) -> ActionChannel:
    root = np.array(draw(rows(5, 5, st.floats(-1, 1))))
    covariance = tuple(map(tuple, (root @ root.T).tolist()))
    commands = draw(st.sampled_from(["displacement", "position"]))
    return ActionChannel(draw(VECTORS), draw(MODERATE), draw(MODERATE), covariance, draw(st.floats(0, 1)), commands)


@st.composite
def learned(draw: st.DrawFn, links: list[Link]) -> LearnedEdge:
    link = draw(st.sampled_from(links))
    certainty = None
    if draw(st.booleans()):
        counts = tuple(draw(shares(size)) for size in draw(st.lists(st.integers(1, 4), max_size=2)))
        certainty = EdgeCertainty(draw(MODERATE), counts, draw(st.none() | channels()))
    return LearnedEdge(link.parent, link.child, tuple(draw(st.lists(segments(), max_size=3))), certainty)


@st.composite
def automata(draw: st.DrawFn) -> HybridAutomaton:
    units = st.sampled_from(["rad", "m"])
    coordinates = draw(
        st.lists(st.builds(Coordinate, NAMES, units), min_size=1, max_size=3, unique_by=lambda c: c.name)
    )
    inputs = draw(st.lists(st.builds(Coordinate, NAMES, units), min_size=1, max_size=2, unique_by=lambda c: c.name))
    n, m = len(coordinates), len(inputs)
    parts = draw(st.lists(NAMES.filter(lambda s: s != "base"), min_size=1, max_size=3, unique=True))
    bodies = ["base", *parts]
    links = [Link(draw(st.sampled_from(bodies[: i + 1])), p, draw(st.integers(0, n - 1))) for i, p in enumerate(parts)]
    names = draw(st.lists(NAMES, min_size=1, max_size=3, unique=True))
    spreads = st.just(0.0) | st.floats(0, 10)
    edge = st.builds(Edge, st.sampled_from(names), st.sampled_from(names), regions(n, m), resets(n, m), spreads)
    described = draw(st.lists(st.sampled_from(bodies), unique=True))
    return HybridAutomaton(
        tuple(coordinates),
        tuple(inputs),
        tuple(links),
        tuple(Part(p, tuple(draw(st.lists(SHAPES, max_size=2))), draw(st.none() | VECTORS)) for p in described),
        tuple(draw(modes(name, len(links), n, m)) for name in names),
        tuple(draw(st.lists(edge, max_size=3))),
        Noise(draw(st.tuples(*[st.floats(0, 10)] * n)), draw(st.tuples(*[STDS] * n)), draw(st.none() | lights(n))),
        tuple(draw(st.lists(st.tuples(st.sampled_from(names), regions(n, m)), max_size=2))),
        draw(st.dictionaries(NAMES, TEXTS, max_size=3)),
        tuple(draw(st.lists(learned(links), max_size=2))),
    )
