"""The section `learned` of a model file and the spread of thresholds: readable, exact, and every mistake one line."""

from __future__ import annotations

from dataclasses import replace

import pytest
from attempts import parse_model, told

from micah_plan.automaton.certainty import (
    ActionChannel,
    EdgeCertainty,
    LearnedEdge,
    LearnedSegment,
    RowPosterior,
    SegmentCertainty,
)
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model import model_text

VARIANCES = (0.01, 0.01, 0.0025, 0.0004, 0.0009)


@pytest.fixture
def sure(door: HybridAutomaton) -> HybridAutomaton:
    """The door with all that learning can be sure of."""
    covariance = tuple(tuple(v if i == j else 0.0 for j in range(5)) for i, v in enumerate(VARIANCES))
    channel = ActionChannel((0.0, 0.0, 0.2), 0.94, 0.11, covariance, 0.87)
    segments = (
        LearnedSegment("revolute", 0, 0, 19, SegmentCertainty(None, (("revolute", 0.98), ("screw", 0.015)))),
        LearnedSegment(
            "rigid", 0, 20, 39, SegmentCertainty(RowPosterior((19, 20, 22), (0.04, 0.9, 0.06)), (("rigid", 1.0),))
        ),
        LearnedSegment("rigid", 3, 40, 49),
    )
    edge = LearnedEdge("base", "door", segments, EdgeCertainty(812.5, ((0.0, 0.97, 0.03), (1.0,)), channel))
    edges = (replace(door.edges[0], threshold_std=0.012), *door.edges[1:])
    return replace(door, edges=edges, learned=(edge,))


def test_it_reads_back_and_is_written_readably(sure: HybridAutomaton) -> None:
    text = model_text(sure)
    assert parse_model(text.encode(), "m.yaml") == sure
    assert model_text(parse_model(text.encode(), "m.yaml")) == text
    for line in (
        "    threshold_std: 0.012\n",
        "  - parent: base\n    child: door\n    log_evidence: 812.5\n",
        "      - [0.0, 0.97, 0.03]\n",
        "      frame_rotation: [0.0, 0.0, 0.2]\n      gain: 0.94\n      delay: 0.11\n",
        "# std 0.1 rad, 0.1 rad, 0.05 rad, 0.02, 0.03 s\n",
        "      - kind: rigid\n        rows: [20, 39]\n",
        "          rows: [19, 20, 22]  # 95 % within 20 to 22\n          probabilities: [0.04, 0.9, 0.06]\n",
        "      - kind: rigid\n        run: 3\n        rows: [40, 49]\n",
    ):
        assert line in text


def test_without_certainty_nothing_is_written(door: HybridAutomaton) -> None:
    text = model_text(door)
    assert "learned" not in text
    assert "threshold_std" not in text


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("gain:", "gian:", "key 'learned.0.actions.gian': unknown key 'gian' (and 1 more error); did you mean 'gain'?"),
        ("log_evidence: 812.5\n", "sure: 1\n", "key 'learned.0.sure': unknown key 'sure'"),
        ("    log_evidence: 812.5\n", "", "key 'learned.0': missing key 'log_evidence'; add it, or leave out"),
        ("threshold_std: 0.012", "threshold_std: -1", "key 'transitions.0.threshold_std': expected a number >= 0"),
        ("child: door\n    log", "child: dor\n    log", "no link leads from 'base' to 'dor'; links: base to door"),
        ("[0.04, 0.9, 0.06]", "[0.04, 0.9]", "expected one probability per row, found 2 for 3 rows"),
        ("[0.04, 0.9, 0.06]", "[0.04, 0.9, 0.6]", "expected probabilities that sum to 1, found 1.54; correct them"),
        ("[0.04, 0.9, 0.06]", "[0.04, 1.9, 0.06]", "start.probabilities.1': expected a number <= 1, found 1.9"),
        ("[0.0, 0.97, 0.03]", "[0.0, 0.97]", "key 'learned.0.changepoint_counts.0': expected probabilities that sum"),
        ("rows: [19, 20, 22]", "rows: [19, 22, 20]", "expected rows in increasing order"),
        ("rows: [20, 39]", "rows: [40, 39]", "expected first <= last row, found 40 > 39; swap them"),
        ("rows: [20, 39]", "rows: [20.5, 39]", "segments.1.rows.0': expected an integer, found 20.5"),
        ("rows: [20, 39]", "rows: [20]", "too few entries"),
        ("revolute: 0.98", "revolute: 0.999", "expected probabilities that sum to at most 1, found 1.014"),
        (
            "revolute: 0.98",
            "hinge: 0.98",
            "expected 'rigid', 'prismatic', 'revolute', 'screw' or 'path', found 'hinge'",
        ),
        ("[0.01, 0.0, 0.0, 0.0, 0.0]", "[0.01, 0.0, 0.0]", "expected 5 rows of 5, found 5 rows of 3, 5"),
        (
            "[0.01, 0.0, 0.0, 0.0, 0.0]",
            "[0.01, 1.0, 0.0, 0.0, 0.0]",
            "expected a symmetric positive semi-definite matrix",
        ),
        (
            "[0.01, 0.0, 0.0, 0.0, 0.0]",
            "[-0.01, 0.0, 0.0, 0.0, 0.0]",
            "expected a symmetric positive semi-definite matrix",
        ),
    ],
)
def test_a_mistake_is_one_line_with_its_place(sure: HybridAutomaton, old: str, new: str, expected: str) -> None:
    text = model_text(sure)
    assert old in text
    line = told(parse_model, text.replace(old, new, 1).encode(), "m.yaml")
    assert line.startswith("m.yaml, line ")
    assert expected in line


def test_a_start_needs_the_kinds_probabilities(sure: HybridAutomaton) -> None:
    text = model_text(sure)
    kinds = "        probabilities:\n          rigid: 1.0\n"
    assert text.count(kinds) == 1
    line = told(parse_model, text.replace(kinds, "").encode(), "m.yaml")
    assert "key 'learned.0.segments.1': missing key 'probabilities'; add it, or leave out start" in line
