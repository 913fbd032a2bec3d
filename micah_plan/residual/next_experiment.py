"""Design of the next experiment: commands that separate hypotheses which a recording left tied.

Each remaining model is assumed true in turn. The loss of a rival's prediction of the following motion, with its
parameters fitted again as far as the recording allows, is the expected evidence [nats] (T-optimality: Atkinson and
Fedorov, "The design of experiments for discriminating between two rival models", Biometrika 1975). Commands are chosen
a few steps at a time, for all pairs of rivals together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from micah_plan.arrays import Booleans, Floats, Ints
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.automaton.tracks import tracks
from micah_plan.recording.value import Recording
from micah_plan.residual import messages
from micah_plan.residual.calibration import Calibration
from micah_plan.residual.candidates import candidates, equivalent_candidate
from micah_plan.residual.contenders import Contender, best_first
from micah_plan.residual.coordinate_data import CoordinateData
from micah_plan.residual.filtering import errors, noiseless_data
from micah_plan.residual.fitting import ENOUGH_INDEPENDENT, Fit
from micah_plan.residual.likelihood import LEAST_EVIDENCE
from micah_plan.residual.trace import CoordinateTrace
from micah_plan.task.experiment import Experiment, Motion
from micah_plan.task.start import Start, start_mode

# Evidence [nats] that a whole experiment aims at for every pair: thrice what an effect needs, for held-out rows.
_WANTED_NATS = 3.0 * LEAST_EVIDENCE
# A pair that no motion separates by more than this per run [nats] is left to its sentence.
_MIN_EXPECTED_NATS = 0.1
_MOST_REPETITIONS = 10
_MOST_RIVALS = 4
# Motions are made of so many pieces of so many steps; so many of each length are gone on with.
_PIECES, _STEPS, _KEPT = 6, 8, 4
_LEAST_SIZE, _GOLDEN = 0.6, 0.5 * (np.sqrt(5.0) - 1.0)
_PLACES = (0.15, 0.5, 0.85)
# Digits behind the point to which motions are compared: far above what processors add up differently.
_DIGITS_OF_WORTH = 6
# Step of a difference quotient, as a share of what is large for a parameter.
_DIFFERENCE = 0.02
# Share of the width by which a motion may be predicted to leave what was seen and is no end.
_BEYOND = 0.05
_SMALLEST_STD = 1e-4


@dataclass(frozen=True, eq=False)
class Designed:
    """A designed experiment with its expected evidence.

    Attributes:
        coordinate: that is moved.
        expected: (model, rival, expected evidence of the whole experiment [nats]) of each separated pair.
    """

    experiment: Experiment
    coordinate: str
    expected: tuple[tuple[str, str, float], ...]

    def __str__(self) -> str:
        return messages.separates(self.coordinate, self.expected)


def next_experiment(automaton: HybridAutomaton, recording: Recording, calibration: Calibration) -> Designed | None:
    """The experiment that separates a calibration's open alternatives; None if motion cannot.

    Args:
        automaton, recording: that were calibrated.
    """
    configurations = [track.x for track in tracks(automaton, recording)]
    for trace in calibration.traces:
        rivals = [_Rival.of(trace.data, model) for model in _rivals(trace)]
        designed = _designed(automaton, trace.data, rivals, np.concatenate(configurations)) if len(rivals) > 1 else None
        if designed is not None:
            return designed
    return None


def _rivals(trace: CoordinateTrace) -> list[Contender]:
    """The alternatives to separate: ties of the effects found or, if structure remains, the next best.

    If nothing was found: the model as it is, and the closest candidates.
    """
    options = [model for model in best_first(trace.alternatives) if model.names != trace.nominal.names]
    options = options or trace.held_out.competition.alone(candidates(trace.data))
    if not options:
        return []
    if trace.outcome.verdict == "none":
        return [trace.nominal, *options][:_MOST_RIVALS]
    best = trace.chosen if trace.chosen.parts else options[0]
    named = {model.names[-1]: model for model in options[::-1] if model.names[-1] != best.names[-1]}
    tied = {name for finding in trace.findings for name in finding.tied}
    if tied:
        chosen = [named[name] for name in tied if name in named]
        unseen = [equivalent_candidate(name, trace.data) for name in sorted(tied - set(named))]
        chosen += trace.held_out.competition.alone([part for part in unseen if part.term.form.layer != "frame"])
        return [best, *best_first(chosen)][:_MOST_RIVALS]
    if trace.outcome.verdict == "explained":
        return []
    last = [trace.final] if trace.final.names not in (best.names, trace.nominal.names) else []
    return [best, *last, *best_first(list(named.values()))][:_MOST_RIVALS]


@dataclass(frozen=True, eq=False)
class _Rival:
    """A model fitted to the recording, with the Fisher information of its parameters.

    Attributes:
        information: (k, k) of its own free parameters.
    """

    name: str
    fit: Fit
    information: Floats

    @classmethod
    def of(cls, data: CoordinateData, model: Contender) -> _Rival:
        count = model.fit.free.of_model
        rival = cls(" and ".join(model.names) or "nothing", model.fit, np.diag(1.0 / model.fit.free.std[:count] ** 2))
        slopes = rival.errors(data)[1].reshape(count, data.z.size)
        return replace(rival, information=rival.information + slopes @ slopes.T)

    def errors(self, data: CoordinateData) -> tuple[Floats, Floats]:
        """(S, T) normalised innovations, and (k, S, T) their derivatives by the free parameters."""
        fit, free = self.fit, self.fit.free
        steps = _DIFFERENCE * free.scale[: free.of_model]
        steps = np.where(fit.vector[free.at[: free.of_model]] + steps <= free.high[: free.of_model], steps, -steps)
        vectors = fit.moved(np.vstack([np.zeros(free.of_model), np.diag(steps)]))
        error, variance = errors(data, [fit.hypotheses(vectors)], "filter")
        error = error / np.sqrt(variance[0])
        return error[0], np.asarray((error[1:] - error[0]) / steps[:, None, None])

    def moved(self, data: CoordinateData, mode_at: _ModeAt) -> CoordinateData:
        """The data with the motion that this model predicts."""
        return noiseless_data(data, self.fit.hypotheses(self.fit.vector[None]), mode_at)

    def evidence_against(self, moved: CoordinateData) -> Floats:
        """(S,) evidence expected against this model if the data's motion occurs, after a refit [nats]."""
        error, slopes = self.errors(moved)
        against = np.einsum("kst,st->sk", slopes, error)
        information = self.information + np.einsum("kst,lst->skl", slopes, slopes)
        taken = np.einsum("sk,sk->s", against, np.linalg.solve(information, against[:, :, None])[:, :, 0])
        return np.asarray(0.5 * np.maximum((error**2).sum(axis=1) - taken, 0.0))


class _ModeAt:
    """The mode at a configuration: that of the nearest recorded row."""

    def __init__(self, data: CoordinateData) -> None:
        order = np.argsort(data.z[data.counted], kind="stable")
        self._z, self._mode = data.z[data.counted][order], data.mode[data.counted][order]

    def __call__(self, z: Floats) -> Ints:
        between = np.searchsorted(0.5 * (self._z[1:] + self._z[:-1]), z)
        return np.asarray(self._mode[between])


def _designed(
    automaton: HybridAutomaton, data: CoordinateData, rivals: Sequence[_Rival], measured: Floats
) -> Designed | None:
    """The best motion from each of several starts, if they separate at least two rivals."""
    able = _starts(automaton, data, measured)
    motions, evidence = [], []
    for start in able:
        commands, gained = _best_commands(data, rivals, start.mean[data.index])
        motions.append(Motion(start, _inputs(automaton, data, start, commands)))
        evidence.append(gained)
    if not motions:
        return None
    total = np.sum(evidence, axis=0)
    is_hopeless = total > _MIN_EXPECTED_NATS * len(motions)
    if not is_hopeless.any():
        return None
    # With few runs, each is tested for contradicting the others.
    needed = int(np.ceil(_WANTED_NATS / total[is_hopeless].min()))
    repetitions = int(np.clip(needed, np.ceil(ENOUGH_INDEPENDENT / len(motions)), _MOST_REPETITIONS))
    names = list(combinations([rival.name for rival in rivals], 2))
    expected = tuple((*names[k], float(repetitions * total[k])) for k in np.flatnonzero(is_hopeless))
    return Designed(Experiment(automaton, tuple(motions), repetitions), data.coordinate, expected)


def _starts(automaton: HybridAutomaton, data: CoordinateData, measured: Floats) -> list[Start]:
    """Measured states spread over the visited range, in modes that move the coordinate; rounded for files."""
    std = tuple(max(std_of_coordinate, _SMALLEST_STD) for std_of_coordinate in automaton.noise.observation_std)
    low, high = data.visited
    starts = []
    for share in _PLACES:
        nearest = np.argsort(np.abs(measured[:, data.index] - (low + share * (high - low))), kind="stable")
        for row in nearest[: len(measured) // 3 + 1]:
            start = Start(tuple(float(value) for value in np.round(measured[row], 4)), std)
            mode, _ = start_mode(automaton, start)
            if mode is not None and automaton.mode(mode).B[data.index].any():
                starts.append(replace(start, mode=mode))
                break
    return starts


def _best_commands(data: CoordinateData, rivals: Sequence[_Rival], start: float) -> tuple[Floats, Floats]:
    """(T,) commands of the coordinate [rad or m], and (pairs,) expected evidence of one run [nats]."""
    menu = _command_patterns(data)
    kept = np.zeros((1, 0))
    for number in range(_PIECES):
        # Sizes that never repeat say more of what else might be: a fixed sequence that fills the interval evenly.
        sizes = _LEAST_SIZE + (1.0 - _LEAST_SIZE) * (((number * _STEPS + np.arange(_STEPS)) * _GOLDEN) % 1.0)
        pieces = [[float(f"{value:.3g}") for value in row] for row in menu * sizes + 0.0]
        tried = np.array([[*before, *piece] for before in kept for piece in pieces])
        evidence, is_inside = _expected_evidence(data, rivals, start, tried)
        # A pair that is already separated is worth little more: all pairs should be.
        worth = np.log1p(evidence / LEAST_EVIDENCE).sum(axis=0) - np.where(is_inside, 0.0, np.inf)
        # A motion and its mirror image are often equally informative: the first is taken, not the larger by rounding.
        order = np.argsort(-np.round(worth, _DIGITS_OF_WORTH), kind="stable")[:_KEPT]
        kept = tried[order]
    return kept[0], evidence[:, order[0]]


def _command_patterns(data: CoordinateData) -> Floats:
    """(P, _STEPS) command patterns: on and back, small and large, alternating, a single pulse, growing, rest."""
    sizes = np.abs(data.u[data.counted_starts])
    largest = float(sizes.max())
    k, ones = np.arange(_STEPS), np.ones(_STEPS)
    once, turns, grows = (k == 0) * 1.0, (-1.0) ** k, (k + 1.0) / _STEPS
    shapes = [s * share * ones for share in (1.0, 0.4, 0.15) for s in (1.0, -1.0)]
    shapes += [share * turns for share in (1.0, -1.0, 0.3)] + [once, -once, grows, -grows, 0.0 * ones]
    shapes += [s * np.where(k < _STEPS // 2, 1.0, -1.0) for s in (1.0, -1.0)]
    return largest * np.array(shapes)


def _expected_evidence(
    data: CoordinateData, rivals: Sequence[_Rival], start: float, commands: Floats
) -> tuple[Floats, Booleans]:
    """(pairs, S) expected evidence [nats], averaged over the true rival, and (S,) whether motions stay in range."""
    imagined, mode_at = _simulated_runs(data, start, commands), _ModeAt(data)
    moved = [rival.moved(imagined, mode_at) for rival in rivals]
    low, high = data.visited
    room = _BEYOND * (high - low)
    lowest = min(low - room, data.lower if np.isfinite(data.lower) else np.inf)
    highest = max(high + room, data.upper if np.isfinite(data.upper) else -np.inf)
    z = np.stack([motion.z for motion in moved])
    is_inside = ((z > lowest - room) & (z < highest + room)).all(axis=(0, 2))
    pairs = combinations(range(len(rivals)), 2)
    evidence = [0.5 * (rivals[b].evidence_against(moved[a]) + rivals[a].evidence_against(moved[b])) for a, b in pairs]
    return np.array(evidence), np.asarray(is_inside)


def _simulated_runs(data: CoordinateData, start: float, commands: Floats) -> CoordinateData:
    """Data of S runs with commands (S, T) from one start, placed after the recorded rows."""
    count, steps = commands.shape
    shape = (count, steps + 1)
    u = np.hstack([commands, np.zeros((count, 1))])
    counted = np.ones(shape, dtype=bool)
    counted[:, 0] = False
    made = replace(
        data,
        z=np.full(shape, start),
        u=u,
        place=start + u,
        earlier=np.full((2, count, data.earlier.shape[2]), np.nan),
        moving=np.zeros(count),
        counted=counted,
        time=np.tile(data.period * np.arange(steps + 1), (count, 1)),
        order=np.ones(shape),
        mode=np.zeros(shape, dtype=np.int64),
        run=np.arange(count),
        action=None,
        row_ends=None,
        noise=np.ones(shape),
        whole=None,
    )
    vars(made)["blur"] = data.blur  # that of the recording: what is imagined has no noise
    return made


def _inputs(
    automaton: HybridAutomaton, data: CoordinateData, start: Start, commands: Floats
) -> tuple[tuple[float, ...], ...]:
    """(T, m) inputs that command the coordinate accordingly."""
    per_input = np.asarray(automaton.mode(start.mode or automaton.modes[0].name).B)[data.index]
    number = int(np.argmax(np.abs(per_input)))
    rows = np.zeros((len(commands), automaton.m))
    rows[:, number] = commands / per_input[number]
    return tuple(tuple(row) for row in rows.tolist())
