"""What contradicts itself is refused with its place; what only looks odd is not."""

from __future__ import annotations

from dataclasses import replace

import pytest
from automaton_examples import cabinet, detent, door, guard, plain, two_rails

from micah_plan.automaton.check import contradictions
from micah_plan.automaton.effects.add import with_effect
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Mode, Noise, Reset
from micah_plan.automaton.plausible import suspicions_of_automaton
from micah_plan.automaton.region import Region
from micah_plan.documents.model import load_model
from micah_plan.errors import InputError

GAIN = Effect("gain", "door", (("gain", 0.9),))
LATE = Edge("revolute", "rigid", guard(([1], [0], 1.5)))


def found(automaton: HybridAutomaton) -> tuple[tuple[str | int, ...], str] | None:
    """Place and line of the first contradiction."""
    for place, check in contradictions(automaton):
        try:
            check()
        except InputError as error:
            return place, str(error)
    return None


def with_edges(*edges: Edge) -> HybridAutomaton:
    return replace(door(), edges=(*door().edges, *edges))


def with_invariant(region: Region) -> HybridAutomaton:
    first: Mode = door().modes[0]
    return replace(door(), modes=(replace(first, invariant=region), door().modes[1]))


MISTAKES = [
    (
        replace(door(), coordinates=(Coordinate("door", "m"),)),
        ("coordinates", "door"),
        "coordinate door: expected the unit rad of the revolute joint of door, found m; write rad",
    ),
    (
        replace(two_rails(), coordinates=(Coordinate("drawer", "rad"),)),
        ("coordinates", "drawer"),
        "coordinate drawer: expected the unit m of the prismatic joint of drawer, found rad; write m",
    ),
    (
        replace(door(), inputs=(Coordinate("door", "m"),)),
        ("inputs", "door"),
        "input door: expected the unit rad of the coordinate door that it moves, found m; write rad",
    ),
    (
        with_edges(LATE, replace(LATE, reset=Reset(c=(0.1,)))),
        ("edges", len(door().edges) + 1),
        f"it has the same modes and guard as transition {len(door().edges)} (counted from 0), so it is never taken",
    ),
    (
        with_edges(Edge("revolute", "rigid", guard(([1], [0], -5.0)))),
        ("edges", len(door().edges), "guard"),
        "edge revolute -> rigid: its guard holds everywhere in mode revolute, which is never stayed in",
    ),
    (
        with_edges(Edge("rigid", "revolute", guard(([1], [0], 1.0)))),
        ("edges", len(door().edges), "guard"),
        "edge rigid -> revolute: its guard holds everywhere in mode rigid, which is never stayed in",
    ),
    (
        with_edges(Edge("revolute", "rigid", guard(([1e-300], [0], 1.0)))),
        ("edges", len(door().edges), "guard"),
        "expected a limit of door of at most 1e+06 rad in size, found 1e+300; give it in m or rad",
    ),
    (
        with_invariant(guard(([1], [0], 0.0), ([-1], [0], -1e9))),
        ("modes", "revolute", "invariant"),
        "mode revolute: expected a limit of door of at most 1e+06 rad in size, found 1e+09",
    ),
    (
        replace(door(), effects=(GAIN, GAIN)),
        ("effects", 1),
        "effect gain of door is there twice, with the same values; remove one of the two",
    ),
]


@pytest.mark.parametrize(("automaton", "place", "line"), MISTAKES)
def test_a_contradiction_is_reported_with_its_place(
    automaton: HybridAutomaton, place: tuple[str | int, ...], line: str
) -> None:
    told = found(automaton)
    assert told is not None
    assert told[0] == place
    assert line in told[1]
    assert "\n" not in told[1]


ONE = [[1.0]]
MEANT = [
    door(),
    door(release=0.01),
    two_rails(),
    detent(),
    cabinet(),
    with_effect(door(), GAIN, replace(GAIN, parameters=(("gain", 0.8),))),
    with_edges(LATE, Edge("revolute", "rigid", guard(([1], [0], 1.6)))),
    with_edges(Edge("revolute", "rigid", guard(([1], [0], -5.0), ([0], [1], 0.1)))),  # only with an input
    plain({"a": ONE, "b": ONE}, [Edge("a", "b", guard(([1], [0], 0.5)))]),
    # A hand that moves in m turns a part.
    HybridAutomaton(
        (Coordinate("turn", "rad"),), (Coordinate("hand", "m"),), (), (), (Mode("a", (), ((4.0,),)),), (),
        Noise((0.01,), (0.01,)),
    ),
]  # fmt: skip


@pytest.mark.parametrize("automaton", MEANT)
def test_what_may_be_meant_is_left_alone(automaton: HybridAutomaton) -> None:
    assert found(automaton) is None


def test_a_part_that_jumps_from_mode_to_mode_is_suspected() -> None:
    automaton = door()
    far = replace(automaton.modes[1].joints[0], position=(51.2, 0.0, 0.0))
    automaton = replace(automaton, modes=(automaton.modes[0], replace(automaton.modes[1], joints=(far,))))
    millimetres, there, back = suspicions_of_automaton(automaton)
    assert millimetres.startswith("modes.rigid.joints.door: 51.2 m is farther than a room is wide")
    assert there.startswith("transition revolute -> rigid: part door jumps by 5")
    assert back.startswith("transition rigid -> revolute: part door jumps by 5")


@pytest.mark.parametrize(("size", "is_told"), [(0.4, False), (40.0, False), (400.0, True)])
def test_a_door_of_400_m_is_suspected(size: float, is_told: bool) -> None:
    """Lengths in millimetres about an axis through the origin of the handle's frame, and a slide of as many metres."""
    swing, held = (replace(mode.joints[0], center=(-size, 0.0, 0.0), position=(0.0, 0.0, 0.0)) for mode in door().modes)
    modes = (replace(mode, joints=(joint,)) for mode, joint in zip(door().modes, (swing, held), strict=True))
    lines = suspicions_of_automaton(replace(door(), modes=tuple(modes)))
    assert any("revolute.joints.door: radius: 400 m is farther than a room" in line for line in lines) == is_told
    slide = plain({"a": ONE}, [])
    mode = replace(slide.modes[0], invariant=guard(([1], [0], 0.0), ([-1], [0], -size)))
    lines = suspicions_of_automaton(replace(slide, coordinates=(Coordinate("drawer", "m"),), modes=(mode,)))
    assert any("coordinates.drawer: range: 400 m" in line for line in lines) == is_told


def test_a_number_of_one_step_that_is_larger_than_the_range_is_suspected() -> None:
    def drifting(by: float) -> HybridAutomaton:
        return replace(door(), effects=(Effect("bias", "door", (("bias", by),), modes=("revolute",)),))

    def beyond(automaton: HybridAutomaton) -> list[str]:
        return [line for line in suspicions_of_automaton(automaton) if "the whole range of" in line]

    assert beyond(drifting(-0.05)) == []
    (drift,) = beyond(drifting(-5.0))
    assert drift.startswith("modes.revolute: drift of door: 5 rad")
    noisy = replace(door().noise, process_std=(30.0,), observation_std=(1.0,))
    (noise,) = beyond(replace(door(), noise=noisy))
    assert noise.startswith("noise.process_std.door: 30 rad")


@pytest.mark.parametrize("automaton", [two_rails(), detent(), plain({"a": ONE}, [])])
def test_parts_that_stay_where_they_are_are_not_suspected(automaton: HybridAutomaton) -> None:
    assert suspicions_of_automaton(automaton) == ()


def test_a_transition_behind_a_more_general_one_is_never_taken(repository):
    """A hand lets go: anywhere the thing falls, only on the shelf it stays. The more general one comes last."""
    picking = load_model(repository / "models" / "picking.yaml")
    assert suspicions_of_automaton(picking) == ()
    falls = next(edge for edge in picking.edges if edge.target == "dropped")
    wrong = replace(picking, edges=(falls, *(edge for edge in picking.edges if edge is not falls)))
    lines = suspicions_of_automaton(wrong)
    assert len(lines) == 2
    assert all("holds -> free" in line and "never taken" in line for line in lines)
