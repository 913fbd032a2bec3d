"""Settings of the planner, with defaults that serve ordinary problems."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class PlannerSettings:
    """Settings with defaults that serve ordinary problems.

    Attributes:
        confidence: probability with which guards and invariants must hold, and roll-outs reach the goal.
        samples_per_mode: roadmap states per mode of the high-level search.
        search_limit: largest number of linear programmes of the search where the hand may leave objects anywhere; a
            search that reaches it without a mode sequence reports that.
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
        """Margin at boundaries in standard deviations: k with Φ(k) = confidence."""
        from scipy.special import ndtri

        return float(ndtri(self.confidence))
