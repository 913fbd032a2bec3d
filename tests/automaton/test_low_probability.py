"""What a model rests on although learning was not sure of it is said where the model is used."""

from __future__ import annotations

from dataclasses import replace

import pytest

from micah_plan.automaton.certainty import (
    EdgeCertainty,
    LearnedEdge,
    LearnedSegment,
    SegmentCertainty,
    low_probability_warnings,
)
from micah_plan.documents.problem import load_problem
from micah_plan.planning.solver import solve


def edge(hinge: float, one_stop: float = 0.98) -> LearnedEdge:
    """A door that is a hinge, shut from row 80 on: how sure that is."""
    kinds = (("rigid", 0.0), ("revolute", hinge), ("screw", 1 - hinge))
    segments = (
        LearnedSegment("revolute", 0, 0, 79, SegmentCertainty(None, kinds)),
        LearnedSegment("rigid", 0, 80, 120, SegmentCertainty(None, (("rigid", 1.0), ("revolute", 0.0)))),
    )
    return LearnedEdge("base", "door", segments, EdgeCertainty(0.0, ((0.0, one_stop, 1 - one_stop),)))


def test_what_is_sure_needs_no_words() -> None:
    assert low_probability_warnings([edge(0.6)]) == ()
    assert (
        low_probability_warnings([replace(edge(0.1), segments=(LearnedSegment("revolute", 0, 0, 79),), certainty=None)])
        == ()
    )


def test_a_doubtful_kind_is_reported_with_the_next_likely_one() -> None:
    (line,) = low_probability_warnings([edge(0.59)])
    assert "door is revolute relative to base (rows 0 to 79) with a probability of only 59 %, screw with 41 %" in line


@pytest.mark.parametrize(
    ("one_stop", "said"),
    [(0.3, "changes 1 time in run 0 with a probability of only 30 %, 2 times with 70 %"), (0.7, None)],
)
def test_a_doubtful_number_of_changes_is_reported(one_stop: float, said: str | None) -> None:
    lines = low_probability_warnings([edge(0.9, one_stop)])
    assert len(lines) == (said is not None)
    assert said is None or said in lines[0]


def test_a_plan_on_a_doubtful_model_warns(repository) -> None:
    problem = load_problem(repository / "problems" / "drawer_open.yaml")
    (own,) = problem.automaton.learned
    unsure = tuple(
        replace(one, certainty=SegmentCertainty(None, ((one.kind, 0.5), ("screw", 0.45)))) for one in own.segments
    )
    doubtful = replace(problem, automaton=replace(problem.automaton, learned=(replace(own, segments=unsure),)))
    assert solve(problem).warnings == ()
    plan = solve(doubtful)
    assert plan.outcome == "solved"
    assert len(plan.warnings) == len(unsure)
    assert "probability of only 50 %" in plan.warnings[0]


def test_doubts_stay_when_the_object_is_held_among_bodies(repository) -> None:
    problem = load_problem(repository / "problems" / "stapler_on_books.yaml")
    names = {(one.parent, one.child) for one in problem.automaton.learned}
    assert names == {("upper_arm", "lower_arm")}
    assert names <= {(link.parent, link.child) for link in problem.automaton.links}
