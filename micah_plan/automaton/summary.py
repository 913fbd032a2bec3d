"""A hybrid automaton in a few lines."""

from __future__ import annotations

from typing import TYPE_CHECKING

from micah_plan.quantities import count, interval, quantity
from micah_plan.summaries import aligned, listed

if TYPE_CHECKING:
    from micah_plan.automaton.hybrid import Edge, HybridAutomaton

_MOST = 4


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
