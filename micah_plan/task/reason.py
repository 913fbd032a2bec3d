"""Reasons of failure with their remedies."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

Code = Literal[
    "start_in_no_mode", "start_outside_mode", "start_in_obstacle",
    "goal_in_no_mode", "goal_outside_range", "goal_in_obstacle", "no_transition_to_goal",
    "coordinate_not_moved", "inputs_keep_coordinates", "too_few_revisits", "search_limit_reached", "not_connected",
    "constraint_in_the_way", "guard_unreachable", "guard_empty", "reset_outside_mode", "mode_empty",
    "too_few_knots", "optimisation_failed", "constraint_missed", "too_little_room", "time_limit_reached",
    "too_many_trials", "leaves_mode_sequence", "ends_in_other_mode", "misses_goal", "breaks_constraint",
    "arm_cannot_follow", "arm_cannot_release", "grasp_meets_obstacle", "support_uncertain",
]  # fmt: skip
"""What stands in the way of a plan, for programmes; sentences may change, these do not."""

OfferKind = Literal[
    "tolerance", "target", "start", "confidence", "root", "revisits",
    "max_knots", "max_step", "noise", "start_std", "surer", "samples_per_mode", "search_limit", "candidates",
]  # fmt: skip
"""What a remedy can change; those of the second line by a factor."""


@dataclass(frozen=True)
class Offer:
    """A change to a problem, which a remedy names once planning with it has succeeded.

    Attributes:
        words: of the remedy, which name the change without a number.
        named: the words that precede the number.
        kind: of the change.
        values: (coordinate, value [its unit]) of tolerances, targets and starts; (axis, place [m]) of the robot's root;
            (0, number) of confidence and revisits; (0, factor) of others.
        growth: factor on a change by a factor that is not enough (its inverse for factors below 1).
    """

    words: str
    named: str
    kind: OfferKind
    values: tuple[tuple[int, float], ...]
    growth: float = 4.0


def one_of(ways: Sequence[str | Offer]) -> str:
    """Remedies in words: ``a``, ``a, or b``, ``a, b, or c``."""
    *others, last = [way if isinstance(way, str) else way.words for way in ways]
    return f"{', '.join(others)}, or {last}" if others else last


@dataclass(frozen=True)
class Reason:
    """Why something is impossible, with remedies.

    Attributes:
        code: of the obstacle, for programmes.
        sentence: the obstacle with its amount.
        ways: remedies, each in words or as a change that can be tried; at least one.
    """

    code: Code
    sentence: str
    ways: tuple[str | Offer, ...]

    @property
    def remedy(self) -> str:
        """The remedies in words."""
        return one_of(self.ways)

    def __str__(self) -> str:
        """Sentence and remedy in one line."""
        return f"{self.sentence}; {self.remedy}"
