"""Validity of measurements: readings that the belief excludes, or that are missing, are repeated first.

A tracker may leap, freeze, measure in millimetres or see nothing. The filter then restarts from the measurement, or
continues without it, and is as certain as before. So the machine holds still and measures again. A constant measurement
is believed, as of a part that is elsewhere than planned; further leaps, or an unseen part, end the execution.

A belief can also be wrong without excluding any measurement: commands go half as far as modelled, or measurements come
a step late. Then the filter lags behind the state for as long as it moves, always on the same side. The sum of its
innovations shows it (Page, "Continuous inspection schemes", Biometrika 1954); at rest it catches up.
"""

from __future__ import annotations

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.belief.filter import innovations
from micah_plan.belief.hybrid_belief import HybridBelief
from micah_plan.execution import messages

_LOOKS, _MOST_EXCLUDED = 3, 8  # measurements that the belief excludes, in a row and in all
_BLIND = 10  # steps without a measurement
_BIASED, _SURPRISING = 4.5, 3.5  # stds of a sum of innovations, and of one: in one of 2,000 steps
_FEWEST = 4  # innovations, or distances
_OFF_JOINT, _OFF_JOINT_LEAST = 5.0, 0.02  # of the usual distance from a joint, and m; noise alone reaches three times
# Looks at rest before a filter that was behind is believed, at most.
# So many in a row are enough if they lie within so many stds.
_SETTLES, _CALM, _WITHIN = 6, 2, 2.0


class Watch:
    """Watches the measurements of one execution.

    Attributes:
        failure: why it ends; empty while it need not.
    """

    def __init__(self, automaton: HybridAutomaton) -> None:
        self.failure = ""
        self._automaton = automaton
        self._sums, self._numbers = np.zeros(automaton.n), np.zeros(automaton.n)
        self._excluded = self._excluded_in_all = self._unseen = self._settled = self._calm = 0
        self._moves = self._was_surprised = self._is_off = False
        self._off: list[float] = []

    @property
    def is_biased(self) -> bool:
        """Whether innovations are biased: repeatedly by a little, or once by much."""
        enough = self._numbers >= _FEWEST
        off = np.abs(self._sums[enough]) > _BIASED * np.sqrt(self._numbers[enough])
        return self._was_surprised or bool(off.any())

    def record_innovation(self, belief: HybridBelief, z: Floats) -> None:
        """Record a measurement z (n,) [rad or m] and the belief before it; only steps with a command count for bias.

        Measurements with a noise that depends on the place are ignored: in the dark, another look is uninformative.
        """
        self._is_off = False
        if not self._is_uniform(belief):
            return
        stds = innovations(self._automaton, belief, z)
        measured = np.isfinite(stds)
        sizes = np.abs(stds[measured])
        self._calm = self._calm + 1 if sizes.size and (sizes < _WITHIN).all() else 0
        if self._moves:
            self._was_surprised |= bool((sizes > _SURPRISING).any())
            self._sums[measured] += np.clip(stds[measured], -_BIASED, _BIASED)
            self._numbers[measured] += 1

    def record_pose_error(self, belief: HybridBelief, off: float) -> None:
        """Record by how much parts were measured off their joints [m].

        Ignored where noise depends on the unknown place.
        """
        usual = float(np.median(self._off)) if len(self._off) >= _FEWEST else np.inf
        self._is_off = self._is_uniform(belief) and off > _OFF_JOINT * usual + _OFF_JOINT_LEAST
        self._off += [] if self._is_off else [off]

    def looks_again(self, belief: HybridBelief, *, is_lost: bool, unseen: Booleans | None, ends: bool) -> bool:
        """Whether the machine should hold still and measure again.

        Args:
            belief: after the measurement.
            is_lost: whether the belief excludes the measurement still, though it began anew.
            unseen: (l,) parts that were not measured; None: all were.
            ends: whether the goal is believed reached.
        """
        is_excluded = self._is_uniform(belief) and (is_lost or belief.was_reinitialised or self._is_off)
        self._excluded = self._excluded + 1 if is_excluded else 0
        self._excluded_in_all += is_excluded
        self._unseen = self._unseen + 1 if unseen is not None and unseen.all() else 0
        if self._excluded > _LOOKS:
            self.failure = messages.contradicted_in_a_row(self._excluded)
        elif self._excluded_in_all > _MOST_EXCLUDED:
            self.failure = messages.contradicted(self._excluded_in_all)
        elif self._unseen >= _BLIND:
            self.failure = messages.nothing_seen(self._unseen)
        enough = self._settled >= _SETTLES or (self._settled >= _CALM and self._calm >= _CALM)
        settles = ends and self.is_biased and not enough
        self._settled = self._settled + 1 if settles else 0
        holds = not self.failure and (self._excluded > 0 or self._unseen > 0 or settles)
        self._moves = not holds
        return holds

    def _is_uniform(self, belief: HybridBelief) -> bool:
        return self._automaton.sensing(self._automaton.modes[belief.most_likely]).is_uniform
