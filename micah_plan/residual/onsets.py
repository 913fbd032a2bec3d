"""Onsets: an object that changed is modelled as it was before and as it is now.

An effect with an onset in a run of some recording acts in that run from then on and in all later ones. The run is
identified by its rows: in a later recording without them, the effect acts from the start. Effects with an onset
relative to the run start again in every run, a number of seconds after its beginning.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from micah_plan.arrays import ROUND_OFF, Booleans, Floats
from micah_plan.automaton.effects.value import Effect, Since
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import Track
from micah_plan.recording.value import Recording
from micah_plan.residual.compared_runs import Place, consecutive_parts, read_tracks, rows_of


def with_onset_digest(effect: Effect, recording: Recording) -> Effect:
    """The effect with a digest of the run in which it set in, by which that recording is recognised."""
    since = effect.since
    if since is None or since.run is None:
        return effect
    return replace(effect, since=replace(since, digest=recording.select(run=since.run).digest()))


def effects_with_onset(automaton: HybridAutomaton, recording: Recording) -> tuple[Effect, ...]:
    """The effects of a model with an onset in a recording."""
    began = [effect for effect in automaton.effects if effect.since is not None]
    return tuple(effect for effect in began if _is_of(effect.since, recording))


def _is_of(since: Since | None, recording: Recording) -> bool:
    if since is None or since.run is None:
        return since is not None
    return since.run in recording.runs and recording.select(run=since.run).digest() == since.digest


def is_active(since: Since, run: int, time: Floats) -> Booleans:
    """(T,) whether an onset lies before times (T,) of a run [s since its start]."""
    if since.run is None or run == since.run:
        return np.asarray(time >= since.time - ROUND_OFF)
    return np.full(time.shape, run > since.run)


def model_per_run(
    automaton: HybridAutomaton, recording: Recording
) -> list[tuple[HybridAutomaton, list[tuple[Place, Track]]]]:
    """(model of each part of a recording, these parts: contiguous rows with the same effects).

    In the order of their places all parts follow each other.
    """
    gates = effects_with_onset(automaton, recording)
    every = _parts(automaton, recording, gates)
    result = []
    for active in dict.fromkeys(active for _, active, _ in every):
        idle = [effect for effect in gates if effect not in active]
        model = replace(automaton, effects=tuple(e for e in automaton.effects if e not in idle)) if idle else automaton
        parts = _parts(model, recording, gates) if idle else every
        result.append((model, [(place, part) for place, acting, part in parts if acting == active]))
    return result


def _parts(
    automaton: HybridAutomaton, recording: Recording, gates: Sequence[Effect]
) -> list[tuple[Place, tuple[Effect, ...], Track]]:
    """Stretches of all runs in which the same effects act: their rows, with the effects."""
    parts = []
    for number, track in enumerate(read_tracks(automaton, recording)[0]):
        for piece in consecutive_parts(track):
            time = piece.time - track.time[0]
            acting = [is_active(effect.since, track.run, time) for effect in gates if effect.since is not None]
            changes = [row for acts_at in acting for row in np.flatnonzero(np.diff(acts_at)) + 1]
            edges = sorted({0, len(time) - 1, *map(int, changes)})
            for first, last in pairwise(edges):
                active = tuple(effect for effect, acts_at in zip(gates, acting, strict=True) if acts_at[first])
                parts.append(((number, float(time[first])), active, rows_of(piece, first, last + 1)))
    return parts
