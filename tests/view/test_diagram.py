"""The diagram of an automaton: every mode and every transition of a model, once, and no label over another."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import pytest

from micah_plan import HybridAutomaton, load
from micah_plan.view.diagram import MOST_MODES, TransitionArrow, diagram_of
from micah_plan.view.model_page import model_page
from micah_plan.view.palette import mode_colors

MODELS = sorted(path.stem for path in (Path(__file__).parents[2] / "models").glob("*.yaml"))


def _model(repository: Path, name: str) -> HybridAutomaton:
    model = load(repository / "models" / f"{name}.yaml")
    assert isinstance(model, HybridAutomaton)
    return model


def _ends(arrow: TransitionArrow) -> tuple[float, float]:
    """The heights at which a line begins and ends."""
    pairs = re.findall(r"[-0-9.e]+ [-0-9.e]+", arrow.path)
    return float(pairs[0].split()[1]), float(pairs[-1].split()[1])


@pytest.mark.parametrize("name", MODELS)
def test_a_diagram_has_every_mode_and_transition_of_a_shipped_model(repository: Path, name: str) -> None:
    model = _model(repository, name)
    drawn = diagram_of(model.mode_names, model.edges, mode_colors(model))
    between = {(edge.source, edge.target) for edge in model.edges if not edge.is_self_transition}
    if len(model.modes) == 1:
        assert drawn is None
        return
    assert drawn is not None
    assert [box.name for box in drawn.boxes] == list(model.mode_names)
    assert {tuple(arrow.title.split(": ", 1)[0].split(" -> ")) for arrow in drawn.arrows} == between
    assert len(drawn.arrows) == len(between)
    of = {box.name: box for box in drawn.boxes}
    for arrow in drawn.arrows:
        source, target = (of[name] for name in arrow.title.split(": ", 1)[0].split(" -> "))
        begin, end = _ends(arrow)
        assert source.top - 1 <= begin <= source.top + source.height + 1
        assert target.top - 1 <= end <= target.top + target.height + 1
        assert (begin < end) == (source.top < target.top)
    for a, b in combinations(drawn.arrows, 2):
        assert a.anchor != b.anchor or abs(a.y - b.y) >= 12.0 or abs(a.x - b.x) > 5.0
    page = model_page(model)
    assert all(f'data-mode="{mode}"' in page for mode in model.mode_names)


def test_too_many_modes_are_lists_only(repository: Path) -> None:
    model = _model(repository, "walled_domain")
    names = [f"m{k}" for k in range(MOST_MODES + 1)]
    colors = dict.fromkeys(names, "#000000")
    assert diagram_of(names, (), colors) is None
    assert diagram_of(names[:-1], (), colors) is not None
    some = diagram_of(("free", "wall_x"), model.edges, mode_colors(model))
    assert some is not None
    assert [arrow.title for arrow in some.arrows] == ["free -> wall_x: x <= -20", "wall_x -> free: input x > 0"]
