"""The diagram of an automaton: modes as boxes below each other, transitions as arrows with their guards."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from micah_plan.automaton.hybrid import Edge
from micah_plan.quantities import plain

# In pixels of the panel, which is 303 wide: a box, the gap between two, and a letter of a guard.
_WIDTH, _BOX, _GAP, _LETTER, _LINE = 303.0, 26.0, 36.0, 5.7, 12.0
_LEAST_BOX, _LETTER_OF_BOX, _BESIDE = 76.0, 8.0, 12.0
_BULGE, _BULGE_PER_MODE = 16.0, 9.0
MOST_MODES = 10
"""More do not fit beside a scene; the lists of modes and transitions have all."""


@dataclass(frozen=True)
class ModeBox:
    """A mode: its name and colour, and the corner and size of its box [px]."""

    name: str
    color: str
    left: float
    top: float
    width: float
    height: float


@dataclass(frozen=True)
class TransitionArrow:
    """The transitions from one mode to another.

    Attributes:
        path, head: of the line, and of its point, in SVG's words [px].
        label: the guard as far as it fits; of several the first.
        title: all of them.
        x, y, anchor: place of the label [px], and which of its ends is there.
    """

    path: str
    head: str
    label: str
    title: str
    x: float
    y: float
    anchor: str


@dataclass(frozen=True)
class Diagram:
    """Boxes and arrows, and their size [px]."""

    width: float
    height: float
    boxes: tuple[ModeBox, ...]
    arrows: tuple[TransitionArrow, ...]


def guard_words(edge: Edge) -> str:
    """The guard of a transition as text."""
    return " and ".join(h.name or f"a'x + b'u >= {plain(h.c)}" for h in edge.guard.half_spaces) or "always"


def diagram_of(modes: Sequence[str], edges: Sequence[Edge], colors: Mapping[str, str]) -> Diagram | None:
    """The diagram of modes and the transitions between them; None for one mode, or for too many.

    Transitions from a mode to itself are ends of its range, and no arrows.
    """
    if not 1 < len(modes) <= MOST_MODES:
        return None
    width = min(max(_LEAST_BOX, *(_LETTER_OF_BOX * len(name) + 2 * _BESIDE for name in modes)), 0.5 * _WIDTH)
    left = 0.5 * (_WIDTH - width)
    boxes = tuple(
        ModeBox(name, colors[name], left, 2.0 + k * (_BOX + _GAP), width, _BOX) for k, name in enumerate(modes)
    )
    number = {name: k for k, name in enumerate(modes)}
    between = dict[tuple[int, int], list[str]]()
    for edge in edges:
        if not edge.is_self_transition and {edge.source, edge.target} <= number.keys():
            between.setdefault((number[edge.source], number[edge.target]), []).append(guard_words(edge))
    arrows = list[TransitionArrow]()
    # Labels between neighbours keep their place; those of arcs give way.
    for (source, target), guards in sorted(between.items(), key=lambda item: abs(item[0][1] - item[0][0])):
        arrows.append(_arrow(boxes, source, target, guards, arrows))
    return Diagram(_WIDTH, boxes[-1].top + _BOX + 2.0, boxes, tuple(arrows))


def _arrow(
    boxes: Sequence[ModeBox], source: int, target: int, guards: Sequence[str], others: Sequence[TransitionArrow]
) -> TransitionArrow:
    """An arrow, straight between neighbours and else curved around the boxes between: down on the right, up on the
    left.
    """
    first, last, side = boxes[source], boxes[target], 1.0 if target > source else -1.0
    if abs(target - source) == 1:
        x = 0.5 * _WIDTH + side * _BESIDE
        ends = (first.top + _BOX, last.top - 1.0) if side > 0 else (first.top, last.top + _BOX + 1.0)
        head = f"M{x:g} {ends[1]:g}l-4 {-8.0 * side:g}h8z"
        path, beside = f"M{x:g} {ends[0]:g}L{x:g} {ends[1]:g}", x + side * 5.0
    else:
        x = 0.5 * (_WIDTH + side * first.width)
        ends = first.top + 0.5 * _BOX + side * 6.0, last.top + 0.5 * _BOX - side * 6.0
        out = x + side * (_BULGE + _BULGE_PER_MODE * abs(target - source)) / 0.75
        path = f"M{x:g} {ends[0]:g}C{out:g} {ends[0]:g} {out:g} {ends[1]:g} {x + side:g} {ends[1]:g}"
        head = f"M{x + side:g} {ends[1]:g}l{8.0 * side:g} -4v8z"
        beside = x + 0.75 * (out - x) + side * 4.0
    room = int((_WIDTH - beside if side > 0 else beside) / _LETTER)
    more = f" (+{len(guards) - 1})" if guards[1:] else ""
    label = guards[0] if len(guards[0]) + len(more) <= room else guards[0][: max(room - len(more) - 1, 1)] + "…"
    title = f"{first.name} -> {last.name}: {' or '.join(guards)}"
    arrow = TransitionArrow(path, head, label + more, title, beside, 0.5 * sum(ends), "start" if side > 0 else "end")
    while abs(target - source) > 1 and any(_meet(arrow, other) for other in others):
        arrow = replace(arrow, y=arrow.y + _LINE)
    return arrow


def _meet(arrow: TransitionArrow, other: TransitionArrow) -> bool:
    """Whether the labels of two arrows overlap."""
    (a, b), (c, d) = _extent(arrow), _extent(other)
    return abs(arrow.y - other.y) < _LINE and a < d and c < b


def _extent(arrow: TransitionArrow) -> tuple[float, float]:
    length = _LETTER * len(arrow.label)
    return (arrow.x, arrow.x + length) if arrow.anchor == "start" else (arrow.x - length, arrow.x)
