"""Inputs that a step must avoid: those that trigger an unplanned transition.

Whether a guard on the input alone holds (carried faster, a glass spills; pulled harder, a string tears) follows from
the input that is sent, which is known exactly. So, as with the largest step and with admissible inputs, feedback is
clipped where it would cause such a transition, in roll-outs and in execution; the plan needs no margin for it, only
enough steps. This applies to guards without a transition back: a lost contact can be made again, and may be lost by
feedback.

Guards on places as well keep the margin: where the place is uncertain, slowing down whenever it may be the wrong one
costs more plans than it saves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from micah_plan.arrays import Floats
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode
from micah_plan.automaton.memo import memoised
from micah_plan.automaton.region import HalfSpace

STRICT_SHARE = 1e-3
"""How far inside of a strict guard, or outside of one that is not, a plan must be, as a share of a step, where no
uncertainty asks for more."""


# A mode that is less likely is not feared.
_LEAST_WEIGHT = 1e-3


def leads_back(automaton: HybridAutomaton, edge: Edge) -> bool:
    """Whether an edge can be undone by one back: a contact can be made again, a broken part cannot be mended."""
    return any(back.target == edge.source for back in automaton.edges_from(edge.target))


@memoised
def _final_guards(automaton: HybridAutomaton, mode: Mode) -> tuple[tuple[HalfSpace, ...], ...]:
    """The guards on the input alone of a mode's irreversible transitions."""
    # What is sent arrives later or in part, or leads to a place: how fast depends on where the part is.
    if automaton.input_memories or any(form(effect.name).layer == "place" for effect in automaton.effects):
        return ()
    edges = (edge for edge in automaton.edges_from(mode.name) if not edge.is_self_transition)
    guards = (edge.guard for edge in edges if not leads_back(automaton, edge))
    return tuple(guard.half_spaces for guard in guards if guard.on_input and not guard.on_state)


def needs_margin(automaton: HybridAutomaton, edge: Edge) -> bool:
    """Whether a plan keeps a margin to the half-spaces on inputs of a guard that it must not enter.

    Not where feedback is cut off, nor where it may take the transition since one leads back.
    """
    is_final = edge.guard.half_spaces in _final_guards(automaton, automaton.mode(edge.source))
    return not is_final and not leads_back(automaton, edge)


def cut_off(automaton: HybridAutomaton, weights: Floats, u: Floats, max_step: Floats, planned: Floats) -> Floats:
    """(t, m) inputs moved out of the guards that a planned input (m,) is outside of.

    Of a guard that it is out of by several half-spaces, the one that it misses by most is kept to.

    Args:
        weights: (t, q) of the modes in each of t beliefs: of all that are possible the guards count.
    """
    cut = u.copy()
    for number, mode in enumerate(automaton.modes):
        possible = weights[:, number] > _LEAST_WEIGHT
        for guard in _final_guards(automaton, mode):
            missed = [(h.c - float(np.array(h.b) @ planned)) / float(np.linalg.norm(h.b)) for h in guard]
            if max(missed) > 0.0:
                kept = guard[int(np.argmax(missed))]
                b = np.array(kept.b)
                inside = cut @ b - kept.c + STRICT_SHARE * float(np.abs(b) @ max_step)
                cut -= np.outer(np.maximum(0.0, inside) * possible, b / float(b @ b))
    return cut


def admissible_inputs(mode: Mode, max_step: Floats) -> tuple[Floats, Floats]:
    """(m,) lowest and (m,) highest inputs of a mode within the largest step, each bounded by itself.

    Half-spaces that couple inputs, or inputs and states, are left out.
    """
    return _bounded(mode.inputs.half_spaces, -max_step, max_step)


def input_bounds(automaton: HybridAutomaton, mode: Mode, max_step: Floats) -> tuple[Floats, Floats]:
    """Bounds as of `admissible_inputs`, restricted to inputs that trigger no transition; zero is within them."""
    rows = list(mode.inputs.half_spaces)
    for edge in automaton.edges_from(mode.name):
        if len(edge.guard.half_spaces) == 1 and not edge.is_self_transition:
            rows += [h.opposite for h in edge.guard.half_spaces]
    return _bounded([h for h in rows if h.c < 0.0], -max_step, max_step)


def _bounded(half_spaces: Sequence[HalfSpace], lowest: Floats, highest: Floats) -> tuple[Floats, Floats]:
    """(m,) lowest and (m,) highest inputs, from the half-spaces that bound a single input."""
    lowest, highest = lowest.copy(), highest.copy()
    for h in half_spaces:  # b'u >= c
        at = np.flatnonzero(h.b)
        if len(at) == 1 and not h.on_state:
            (j,), bound = at, h.c / h.b[at[0]]
            if h.b[j] > 0.0:
                lowest[j] = max(lowest[j], bound)
            else:
                highest[j] = min(highest[j], bound)
    return lowest, highest
