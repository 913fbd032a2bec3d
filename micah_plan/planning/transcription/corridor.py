"""Which boundaries on x a phase must respect between its first knot and its end."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.region import HalfSpace
from micah_plan.automaton.turning import turn_of
from micah_plan.planning.limits import Limits
from micah_plan.planning.transcription.guess import PhaseGuess

_SMALLEST_STD = 1e-9


@dataclass(frozen=True)
class CorridorRow:
    """One boundary at one knot: sign * (a'mean - c) >= 0, and >= k-sigma if it is uncertain.

    Attributes:
        half_space: the boundary.
        sign: +1 to stay inside it (an invariant), -1 to stay outside (a guard that must not be taken).
        step: knot within the phase, from 1.
        uncertain: whether it should hold at k-sigma; else (a clamp) for the mean only.
        scale: length of one step across it [its unit].
        spread: variance across it by which the estimate wanders in closed loop and that of the boundary itself where
            it is a threshold, to be added to the belief's.
        margin, std: of the guess, with the spread.
    """

    half_space: HalfSpace
    sign: float
    step: int
    uncertain: bool
    scale: float
    spread: float
    margin: float
    std: float

    @property
    def name(self) -> str:
        return f"'{self.half_space.name}'" if self.sign > 0 else f"staying out of '{self.half_space.name}'"

    def slack_start(self, k: float) -> float:
        """The slack that makes the guess feasible, in steps."""
        return max(0.0, k * self.std - self.margin) / self.scale


def corridor(automaton: HybridAutomaton, limits: Limits, guess: PhaseGuess) -> list[CorridorRow]:
    """The rows of a phase for knots 1..N, knot by knot. A boundary that the mode cannot move across has none."""
    mode = automaton.mode(guess.mode)
    leaving = None if guess.edge is None else automaton.edges[guess.edge]
    exits = () if leaving is None else leaving.guard.half_spaces
    turn = None if leaving is None else turn_of(automaton, leaving)
    fixed = _fixed_boundaries(automaton, mode, exits)
    obstacles = _obstacles(automaton, mode, guess.edge)
    # A step stays out of a convex set if both its ends are outside of the same half-space.
    walls = [[_farthest(rows, guess, step) for step in range(1, guess.steps + 1)] for rows in obstacles]
    rows = []
    stds = _threshold_stds(automaton, mode, [h for h, *_ in fixed])
    for step in range(1, guess.steps + 1):
        mean, factor = guess.means[step], guess.factors[step]
        chosen = list(fixed)
        if guess.edge is None or step < guess.steps:
            near = [h for wall in walls for h in wall[step - 1 : step + 1]]
            chosen += [(h, -1.0, True) for h in dict.fromkeys(near)]
        if turn is not None and step < guess.steps:
            chosen.append((turn.half_space, -1.0, True))
            chosen += [(h, 1.0, True) for h in turn.sides if step == guess.steps - 1]
        for half_space, sign, uncertain in chosen:
            a = np.array(half_space.a)
            if np.any(a @ mode.B):
                scale = float(np.abs(a) @ limits.speed)
                margin, spread = sign * (float(a @ mean) - half_space.c), float(a @ guess.spreads[step] @ a)
                spread += stds.get(half_space, 0.0) ** 2
                std = float(np.hypot(np.linalg.norm(factor.T @ a), np.sqrt(max(0.0, spread))))
                rows.append(CorridorRow(half_space, sign, step, uncertain, scale, spread, margin, std))
    return rows


def _threshold_stds(automaton: HybridAutomaton, mode: Mode, boundaries: list[HalfSpace]) -> dict[HalfSpace, float]:
    """Stds of the thresholds at which the mode is left: of guards, and of boundaries that end at one."""
    stds: dict[HalfSpace, float] = {}
    for edge in automaton.edges_from(mode.name):
        for guard in edge.guard.half_spaces if edge.threshold_std else ():
            ends = [h for h in boundaries if h.excludes(guard)]
            for half_space in (guard, *ends):
                stds[half_space] = max(stds.get(half_space, 0.0), edge.threshold_std)
    return stds


def _fixed_boundaries(
    automaton: HybridAutomaton, mode: Mode, exits: tuple[HalfSpace, ...]
) -> list[tuple[HalfSpace, float, bool]]:
    """(boundary, sign, uncertain) of the invariant and clamps, without the boundary through which the phase leaves."""
    clamps = [edge.guard.half_spaces for edge in automaton.edges_from(mode.name) if edge.is_self_transition]
    ends = [rows[0] for rows in clamps if len(rows) == 1 and not rows[0].on_input]
    rows = [h for h in mode.invariant.half_spaces if not h.on_input and not any(h.faces(g) for g in exits)]
    inside = [(h, 1.0, not any(h.faces(end) for end in ends)) for h in rows]
    free_ends = [end for end in ends if not any(h.faces(end) for h in mode.invariant.half_spaces)]
    return inside + [(end, -1.0, False) for end in free_ends]


def _obstacles(automaton: HybridAutomaton, mode: Mode, exit_edge: int | None) -> list[tuple[HalfSpace, ...]]:
    """Guards on x of the transitions that the phase does not take, unless they lie outside the invariant anyway."""
    obstacles = []
    for index, edge in enumerate(automaton.edges):
        rows = edge.guard.half_spaces
        if edge.source != mode.name or edge.is_self_transition or index == exit_edge or not rows:
            continue
        if not edge.guard.on_state:
            continue
        outside = any(h.excludes(g) for h in mode.invariant.half_spaces for g in rows)
        if not outside and not edge.guard.on_input:
            obstacles.append(rows)
    return obstacles


def _farthest(guard: tuple[HalfSpace, ...], guess: PhaseGuess, step: int) -> HalfSpace:
    """The half-space of a guard that the step to this knot is outside of by most standard deviations."""

    def outside(h: HalfSpace) -> float:
        a = np.array(h.a)
        away = h.c - guess.means[step - 1 : step + 1] @ a
        stds = np.linalg.norm(a @ guess.factors[step - 1 : step + 1], axis=-1)
        return float(np.min(away / (stds + _SMALLEST_STD * float(np.linalg.norm(a)))))

    return max((h for h in guard if h.on_state), key=outside)
