"""Effects with memory of earlier inputs: as a filter of inputs, and as coordinates of the state.

A delay remembers the inputs of the last steps, a lag the arriving command, a backlash the place within the play, and a
part that follows places those of the last steps and its velocity. The output of a memory is the same formula
(`EffectForm.respond`) wherever it is kept:

- An `InputChannel` keeps it outside the state, for one run or many: plants, roll-outs and predictions send inputs
  through it before the automaton's step.
- `with_memory_states` keeps it in the state (x, m): planner and filter need that. Inputs are known, so m starts at
  rest, is known exactly, has no noise and is not measured. A step of (x, m) is a step of x with the output of the
  memory (`passed_on`). Goals, guards and joints depend on x only.

A memory changes from step to step, not within one: guards, resets and motion of a step see its output, and it is
updated when the step ends.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from micah_plan.arrays import Floats, Ints
from micah_plan.automaton import messages
from micah_plan.automaton.augmented import augment_state, fix_augmented_state
from micah_plan.automaton.effects.form import REMEMBERING, Operations, Value
from micah_plan.automaton.effects.memories import is_as_commanded
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect, InputMemory
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton
from micah_plan.automaton.memo import memoised


@memoised
def with_memory_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over (x, m), cached; unchanged without memories or if m is included already."""
    memories = (
        () if automaton.input_memories else tuple(memory for memory in _memories(automaton, _only_input) if memory.size)
    )
    if not memories:
        return automaton
    added = [
        Coordinate(f"{memory.effect.coordinate} {memory.effect.name} {k + 1}", automaton.inputs[memory.input].unit)
        for memory in memories
        for k in range(memory.size)
    ]
    return replace(augment_state(automaton, added), input_memories=memories)


def without_memory_states(automaton: HybridAutomaton) -> HybridAutomaton:
    """The automaton over x, whose steps omit effects with memory."""
    if not automaton.input_memories:
        return automaton
    return replace(fix_augmented_state(automaton, own_size(automaton)), input_memories=())


def own_size(automaton: HybridAutomaton) -> int:
    """Number of coordinates without the memories, which come last."""
    return automaton.n - sum(memory.size for memory in automaton.input_memories)


def memory_at_rest(automaton: HybridAutomaton, x: Sequence[float] | None = None) -> tuple[float, ...]:
    """(k,) values of m at rest in a state (n,), None: at 0; empty without memories."""
    start = np.zeros(automaton.n) if x is None else x
    return tuple(
        float(value)
        for input_memory in automaton.input_memories
        for value in _at_rest(input_memory.effect, start[input_memory.coordinate])
    )


def towards(automaton: HybridAutomaton, at: Floats, x: Floats, u: Floats) -> Floats:
    """The inputs (..., m) at x (..., n) that lead to the places to which u (..., m) leads from `at` (..., n).

    Where commands are displacements (no `follow`) they are unchanged, since they do not depend on the place.
    """
    command = u
    for effect in automaton.effects:
        if form(effect.name).layer == "place":
            i = automaton.index(effect.coordinate)
            if moved := _strongest_input(automaton, effect):
                command = command.copy() if command is u else command
                command[..., moved[0]] += (at[..., i] - x[..., i]) / moved[1]
    return command


def passed_on(
    ops: Operations, memories: Sequence[InputMemory], mode: str, x: Sequence[Value], u: Sequence[Value]
) -> tuple[list[Value], dict[int, Value]]:
    """(inputs that reach the mode, next values of the memories by coordinate) for one step.

    An effect that acts in other modes only keeps its memory up to date, without changing the input.

    Args:
        x, u: n states and m inputs: floats, arrays or CasADi expressions.

    Returns:
        the inputs, and the next values by number of their coordinate.
    """
    passed, after = list(u), dict[int, Value]()
    for memory in memories:
        out, kept = _through_memory(
            ops, memory, x[memory.coordinate], passed[memory.input], tuple(x[memory.coordinates])
        )
        after |= dict(enumerate(kept, start=memory.first))
        if memory.effect.acts_in(mode):
            passed[memory.input] = out
    return passed, after


def passed_arrays(memories: Sequence[InputMemory], mode: str, x: Floats, u: Floats) -> tuple[Floats, Floats]:
    """(inputs (..., m) that reach the mode, states (..., n) with the next values of the memories)."""
    if not memories:
        return u, x
    passed, after = passed_on(np, memories, mode, np.moveaxis(x, -1, 0), np.moveaxis(u, -1, 0))  # type: ignore[arg-type]
    kept = np.array(x)
    for i, value in after.items():
        kept[..., i] = value
    return np.stack([np.broadcast_to(value, np.shape(u)[:-1]) for value in passed], axis=-1), kept


class InputChannel:
    """The memory of one run, or of t runs in parallel; without effects with memory it passes inputs unchanged."""

    def __init__(self, automaton: HybridAutomaton, memory: Mapping[Effect, Sequence[float]] | None = None) -> None:
        """Args: the model, and the memories of its effects; at rest if omitted."""
        self._memories = _memories(automaton, _strongest_input)
        self._acts = [np.array([memory.effect.acts_in(q) for q in automaton.mode_names]) for memory in self._memories]
        self._kept: list[tuple[Value, ...] | None] = [None] * len(self._memories)
        for k, own in enumerate(self._memories):
            self._kept[k] = tuple(memory[own.effect]) if memory and own.effect in memory else None

    def pass_on(self, u: ArrayLike, mode: str | Ints = "", x: Floats | None = None) -> Floats:
        """The input (..., m) that reaches the automaton when u (..., m) is commanded: one call per step.

        Args:
            mode: name of the mode, or the index of each run's mode (t,).
            x: (..., n) states from which the inputs lead; None: 0, for effects that do not depend on them.
        """
        passed = np.array(u, dtype=float)
        for k, memory in enumerate(self._memories):
            sent = passed[..., memory.input].copy()
            c = 0.0 * sent if x is None else x[..., memory.coordinate]
            kept = self._kept[k]
            out, self._kept[k] = _through_memory(
                np, memory, c, sent, _at_rest(memory.effect, c) if kept is None else kept
            )
            acts = memory.effect.acts_in(mode) if isinstance(mode, str) else self._acts[k][mode]
            passed[..., memory.input] = np.where(acts, out, sent)
        return passed


def effects_left_out(automaton: HybridAutomaton, memory: bool = False) -> tuple[str, ...]:
    """One line per effect that prediction and calibration use, but planner, filter and nominal plant ignore.

    Args:
        memory: whether effects with memory are listed even where their memory can be a state.
    """
    carried = [automaton.coordinates[link.coordinate].name for link in automaton.links if link.parent != BASE]
    lines = []
    for effect in automaton.effects:
        layer = form(effect.name).layer
        depends_on_past = layer in REMEMBERING and not is_as_commanded(effect)
        depends_on_past = depends_on_past and (memory or _only_input(automaton, effect) is None)
        if depends_on_past or (layer == "frame" and effect.coordinate in carried):
            lines.append(messages.effect_left_out(effect.name, effect.coordinate, depends_on_past))
    return tuple(lines)


def _through_memory(
    ops: Operations, memory: InputMemory, c: Value, u: Value, kept: tuple[Value, ...]
) -> tuple[Value, tuple[Value, ...]]:
    """(input behind one memory at configuration c, its next values)."""
    out, after = form(memory.effect.name).respond(ops, c, memory.scale * u, kept, memory.effect.values)
    return out / memory.scale, after


def _at_rest(effect: Effect, c: Value = 0.0) -> tuple[Value, ...]:
    return form(effect.name).at_rest_in(c, effect.values)


def _memories(
    automaton: HybridAutomaton, input_of: Callable[[HybridAutomaton, Effect], tuple[int, float] | None]
) -> tuple[InputMemory, ...]:
    """Memories of the effects that have an input, appended to the automaton's coordinates in order."""
    memories: list[InputMemory] = []
    first = automaton.n
    for effect in automaton.effects:
        remembers = form(effect.name).layer in REMEMBERING and not is_as_commanded(effect)
        command = input_of(automaton, effect) if remembers else None
        if command is not None:
            i, (j, scale) = automaton.index(effect.coordinate), command
            memories.append(InputMemory(effect, j, i, scale, first, len(_at_rest(effect))))
            first += memories[-1].size
    return tuple(memories)


def _strongest_input(automaton: HybridAutomaton, effect: Effect) -> tuple[int, float] | None:
    """The input that moves an effect's coordinate most in the first mode that does, and its command per unit of it.

    None where no input moves it: then there is no memory.
    """
    i = automaton.index(effect.coordinate)
    mode = next((mode for mode in automaton.modes if mode.driven[i]), None)
    if mode is None:
        return None
    j = int(np.argmax(np.abs(mode.B[i])))
    return j, float(mode.B[i, j])


def _only_input(automaton: HybridAutomaton, effect: Effect) -> tuple[int, float] | None:
    """`_strongest_input` if the memory can be a state; else None.

    It can if the coordinate is moved by one input of its own, in the same way in every mode that moves it, and no reset
    adds that input at once.
    """
    i = automaton.index(effect.coordinate)
    strongest = _strongest_input(automaton, effect)
    if strongest is None:
        return None
    j, scale = strongest
    moving = [mode.B[i] for mode in automaton.modes if mode.driven[i]]
    if any(np.delete(mode.B[:, j], i).any() for mode in automaton.modes):
        return None
    alone = all(row[j] == scale and np.count_nonzero(row) == 1 for row in moving)
    added = any(edge.reset.B is not None and any(row[j] for row in edge.reset.B) for edge in automaton.edges)
    return (j, scale) if alone and not added else None
