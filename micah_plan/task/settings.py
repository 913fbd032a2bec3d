"""Settings of the planner, with defaults that serve ordinary problems.

**Time.** When planning must end, which every stage asks now and then, and how long its stages took.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import inf
from time import perf_counter, process_time

from micah_plan.task.reason import Reason


@dataclass(frozen=True)
class PlannerSettings:
    """Settings with defaults that serve ordinary problems.

    Attributes:
        confidence: probability with which guards and invariants must hold, and roll-outs reach the goal.
        samples_per_mode: roadmap states per mode of the high-level search.
        search_limit: linear programmes that the search solves at most where the hand may leave objects anywhere; where
            the limit ended it without a sequence of modes, the answer says so.
        candidates: how many of the cheapest mode sequences are optimised.
        revisits: how many times a mode sequence may come back to a mode that it has been in.
        max_step: largest input per step and input coordinate [rad or m]; None: from the automaton's admissible inputs,
            else a twentieth of the coordinate's range.
        max_knots: upper limit of knots over the whole plan.
        pace: share of the largest step that a path is planned with. The rest is for the feedback and the optimisation;
            1 is the fastest plan.
        weight_goal, weight_covariance, weight_effort: of the final squared goal error and the final variance (both over
            the squared tolerance) and of the squared inputs (over the squared max_step). The first also weighs the
            probabilities of missing a guard and of crossing a boundary.
        time_limit_s: limit of processor time of each optimisation [s].
        solve_time_limit_s: the same of search, optimisations, verification and the arm together [s].
        verification_trials: roll-outs that check a plan.
        tightening_rounds: how often planning is repeated with more room after too many roll-outs failed.
        replan_every: steps after which execution optimises the rest of the plan again (receding horizon); 0: never.
    """

    confidence: float = 0.95
    samples_per_mode: int = 100
    search_limit: int = 2000
    candidates: int = 4
    revisits: int = 0
    max_step: tuple[float, ...] | None = None
    max_knots: int = 60
    pace: float = 0.6
    weight_goal: float = 1.0
    weight_covariance: float = 1.0
    weight_effort: float = 0.05
    time_limit_s: float = 20.0
    solve_time_limit_s: float = 120.0
    verification_trials: int = 1000
    tightening_rounds: int = 3
    replan_every: int = 0

    @property
    def sigmas(self) -> float:
        """How many standard deviations of room the confidence asks for at a boundary: k with Φ(k) = confidence."""
        from scipy.special import ndtri

        return float(ndtri(self.confidence))


# The least time that a solver is given, so that it can say that the time is over [s].
_SHORTEST_S = 1e-3


class TimeLimitError(Exception):
    """The time is over.

    Attributes:
        reason: in which stage, how far that was, and what to do.
    """

    def __init__(self, limit_s: float, stage: str, state: str, remedy: str) -> None:
        reached = f"the time limit of {limit_s:g} s (solve_time_limit_s) was reached in the {stage}"
        self.reason = Reason(f"{reached}: {state}", (remedy,))
        super().__init__(str(self.reason))


class Deadline:
    """A limit of processor time that begins when it is made, so that a busy machine gives the same answer."""

    def __init__(self, limit_s: float, clock: Callable[[], float] = process_time) -> None:
        """Args: the limit [s], and what tells the time [s]."""
        self.limit_s, self._clock = limit_s, clock
        self._end = clock() + limit_s

    @property
    def left_s(self) -> float:
        """Time left [s], always above 0: for solvers that take a limit."""
        return max(_SHORTEST_S, self._end - self._clock())

    def is_over(self) -> bool:
        """Whether no time is left."""
        return self._clock() >= self._end

    def check(self, stage: str, state: str, lower: str = "") -> None:
        """Go on if there is time.

        Args:
            stage: where this is.
            state: how far it is.
            lower: the setting that makes the stage shorter.

        Raises:
            TimeLimitError: if there is none.
        """
        if self.is_over():
            remedy = "raise solve_time_limit_s" + (f" or lower {lower}" if lower else "")
            raise TimeLimitError(self.limit_s, stage, state, remedy)


NEVER = Deadline(inf)


class Clock:
    """Seconds by stage since it was made."""

    def __init__(self) -> None:
        self._began = perf_counter()
        self._seconds = {"search": 0.0, "build": 0.0, "optimise": 0.0}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """A context whose duration is added to a stage."""
        began = perf_counter()
        try:
            yield
        finally:
            self._seconds[name] += perf_counter() - began

    def timings(self) -> dict[str, float]:
        """Each stage, and ``"total"`` [s]."""
        return {**self._seconds, "total": perf_counter() - self._began}
