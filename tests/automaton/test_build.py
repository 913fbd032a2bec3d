"""The automaton of a kinematic graph: modes, guards, clamps, invariants, pins, noise, and odd orders of segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import END, SHUT, SPLIT, cabinet, chain, detent, door, segment, two_rails

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph, Segment
from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Noise, Part, Pin, Primitive
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.local_models import local_models
from micah_plan.automaton.transition import step
from micah_plan.errors import InputError

SLIDE = prismatic([1, 0, 0], [0, 0, 0])
HINGE = revolute([0, 0, 1], [0, 0, 0], [1, 0, 0])


def held(at: float) -> object:
    return rigid([at, 0, 0], fixed_at=at)


def edge_of(*segments: Segment) -> KinematicEdge:
    return KinematicEdge(BASE, "drawer", segments)


def described(automaton: HybridAutomaton) -> dict[str, list[str]]:
    """Guards by edge name."""
    guards: dict[str, list[str]] = {}
    for edge in automaton.edges:
        guards.setdefault(edge.name, []).append(" and ".join(h.name for h in edge.guard.half_spaces))
    return guards


def between(first: str, second: str, automaton: HybridAutomaton) -> Edge:
    (edge,) = [e for e in automaton.edges if (e.source, e.target) == (first, second)]
    return edge


class TestDoor:
    def test_modes_coordinates_and_links(self) -> None:
        automaton = door()
        assert [mode.name for mode in automaton.modes] == ["revolute", "rigid"]
        assert automaton.coordinates == automaton.inputs == (Coordinate("door", "rad"),)
        assert automaton.links == (Link(BASE, "door", 0),)
        assert automaton.parts == (Part("door"),)
        assert automaton.init == ()
        assert [mode.joints[0].kind for mode in automaton.modes] == ["revolute", "rigid"]

    def test_guards(self) -> None:
        assert described(door()) == {
            "revolute -> rigid": ["door >= 1.2"],
            "rigid -> revolute": ["input door < 0"],
            "revolute -> revolute": ["door < 0"],
        }
        assert between("rigid", "revolute", door(release=0.1)).guard.half_spaces[0].name == "input door < -0.1"
        assert not between("revolute", "rigid", door()).guard.half_spaces[0].strict
        assert between("rigid", "revolute", door()).guard.half_spaces[0].strict

    def test_flow_pins_and_invariants(self) -> None:
        moving, shut = door().modes
        assert (moving.input_matrix, shut.input_matrix) == (((1.0,),), ((0.0,),))
        assert (moving.pins, shut.pins) == ((), (Pin(0, SHUT, 0.01),))
        assert [h.name for h in moving.invariant.half_spaces] == ["door >= 0", "door <= 1.2"]
        assert [h.name for h in shut.invariant.half_spaces] == ["door >= 1.17", "door <= 1.23"]

    def test_resets_are_the_identity_but_for_clamps(self) -> None:
        for edge in (e for example in (door(), detent(), cabinet()) for e in example.edges):
            assert edge.reset.is_identity is not edge.is_self_transition

    def test_a_door_that_was_latched_at_the_start(self) -> None:
        automaton = build_automaton(KinematicGraph((chain("door", [0, 0, SHUT], ["rigid", "revolute"]),)), release=0.05)
        assert described(automaton) == {
            "rigid -> revolute": ["input door > 0.05"],
            "revolute -> rigid": ["door < 0"],
            "revolute -> revolute": ["door > 1.2"],
        }
        assert step(automaton, "rigid", [0.0], [0.1]).x == pytest.approx([0.1])
        assert step(automaton, "revolute", [0.1], [-0.3]).mode == "rigid"


class TestProduct:
    def test_modes_are_the_cartesian_product(self) -> None:
        assert [mode.name for mode in cabinet().modes] == [
            "revolute/prismatic_1",
            "revolute/prismatic_2",
            "rigid/prismatic_1",
            "rigid/prismatic_2",
        ]
        assert [c.unit for c in cabinet().coordinates] == ["rad", "m"]

    def test_edges_change_one_link_at_a_time(self) -> None:
        for edge in cabinet().edges:
            changed = sum(a != b for a, b in zip(edge.source.split("/"), edge.target.split("/"), strict=True))
            assert changed == (0 if edge.is_self_transition else 1)
        assert len(cabinet().edges) == 8 + 2 + 4

    def test_guards_of_one_link_do_not_look_at_the_other(self) -> None:
        for edge in cabinet().edges:
            for half_space in edge.guard.half_spaces:
                assert sum(map(bool, (*half_space.a, *half_space.b))) == 1

    def test_input_matrices_and_pins(self) -> None:
        mode = cabinet().mode("rigid/prismatic_2")
        np.testing.assert_array_equal(mode.B, [[0, 0], [0, 1]])
        assert [pin.coordinate for pin in mode.pins] == [0]


class TestLocalModels:
    def test_repeated_kinds_are_numbered_and_thresholds_are_configurational_changepoints(self) -> None:
        models = local_models(chain("drawer", [0, SPLIT, SPLIT, END], ["prismatic", "rigid", "prismatic"]))
        assert [(m.name, m.lower, m.upper) for m in models] == [
            ("prismatic_1", 0.0, SPLIT),
            ("rigid", SPLIT, SPLIT),
            ("prismatic_2", SPLIT, END),
        ]

    def test_opening_and_closing_again_is_one_model(self) -> None:
        there = segment(SLIDE, (0, 50), 0.0, 0.4)
        pause = segment(held(0.4), (51, 60), 0.4, 0.4)
        back = segment(prismatic([1, 0.01, 0], [0, 0, 0]), (61, 90), 0.4, 0.05)
        models = local_models(edge_of(there, pause, back))
        assert [(m.name, m.lower, m.upper) for m in models] == [("prismatic", 0.0, 0.4), ("rigid", 0.4, 0.4)]
        assert models[0].joint is SLIDE

    def test_a_rest_on_the_way_is_no_model_if_the_part_was_seen_to_pass_there(self) -> None:
        segments = (
            segment(SLIDE, (0, 50), 0.0, 0.4),
            segment(SLIDE, (51, 70), 0.4, 0.2),
            segment(held(0.2), (71, 80), 0.2, 0.2),
            segment(SLIDE, (81, 99), 0.2, 0.0),
        )
        assert [m.name for m in local_models(edge_of(*segments))] == ["prismatic"]

    def test_rigid_at_the_same_configuration_twice_is_one_model(self) -> None:
        segments = (
            segment(held(0.0), (0, 9), 0.0, 0.0),
            segment(SLIDE, (10, 50), 0.0, 0.4),
            segment(SLIDE, (51, 90), 0.4, 0.0),
            segment(held(0.005), (91, 120), 0.005, 0.005),
        )
        models = local_models(edge_of(*segments))
        assert [m.name for m in models] == ["rigid", "prismatic"]
        assert models[0].joint.fixed_at == 0.005

    def test_neighbouring_rigid_models_are_one(self) -> None:
        segments = (
            segment(SLIDE, (0, 50), 0.0, 0.4),
            segment(held(0.4), (51, 90), 0.4, 0.4),
            segment(held(0.6), (91, 99), 0.6, 0.6),
        )
        models = local_models(edge_of(*segments))
        assert [(m.name, m.upper) for m in models] == [("prismatic", 0.4), ("rigid", 0.4)]

    def test_order_is_that_of_configurations_not_of_time(self) -> None:
        segments = (
            segment(SLIDE, (0, 20), 0.0, 0.2),
            segment(HINGE, (21, 40), 0.22, 0.5),
            segment(SLIDE, (41, 60), 0.0, -0.3),
        )
        models = local_models(edge_of(*segments))
        assert [m.name for m in models] == ["prismatic_1", "prismatic_2", "revolute"]
        assert [m.lower for m in models] == pytest.approx([-0.3, 0.0, 0.21])

    @pytest.mark.slow
    def test_a_door_that_was_opened_and_shut_two_thousand_times(self) -> None:
        segments = []
        for k in range(2000):
            rows, there = (30 * k, 30 * k + 19), k % 2 == 0
            ends = (0.0, SHUT) if there else (SHUT, 0.0)
            segments += [
                segment(HINGE, rows, *ends),
                segment(held(ends[1]), (rows[1] + 1, rows[1] + 10), *ends[1:] * 2),
            ]
        models = local_models(edge_of(*segments))
        assert [(m.name, m.lower, m.upper) for m in models] == [
            ("rigid_1", 0.0, 0.0),
            ("revolute", 0.0, SHUT),
            ("rigid_2", SHUT, SHUT),
        ]

    def test_without_a_switch_between_them_neighbours_meet_half_way(self) -> None:
        segments = (
            segment(SLIDE, (0, 20), 0.0, 0.2),
            segment(held(-0.1), (21, 30), -0.1, -0.1),
            segment(HINGE, (31, 40), 0.3, 0.5),
        )
        assert local_models(edge_of(*segments))[2].lower == pytest.approx(0.25)

    def test_segments_that_do_not_line_up_are_refused(self) -> None:
        inside = (
            segment(SLIDE, (0, 20), 0.0, 1.0),
            segment(held(-0.5), (21, 30), -0.5, -0.5),
            replace(segment(HINGE, (31, 40), 0.9, 1.9), configuration_start=-5.0),
            segment(SLIDE, (41, 60), 2.0, 2.1),
        )
        switched = replace(inside[3], configuration_start=-7.0)
        with pytest.raises(InputError, match=r"edge base -> drawer: its segments must follow one another"):
            local_models(edge_of(*inside[:3], switched))
        with pytest.raises(InputError, match="at least one segment"):
            local_models(edge_of())


class TestArguments:
    def test_an_edge_that_never_moved_keeps_its_coordinate(self) -> None:
        automaton = build_automaton(KinematicGraph((chain("wall", [0, 0], ["rigid"]),)))
        assert (automaton.n, automaton.coordinates[0].unit, automaton.edges) == (1, "m", ())
        assert step(automaton, "rigid", [0.0], [0.5]).x == pytest.approx([0.0])

    def test_noise_is_the_mean_over_the_rows_that_moved(self) -> None:
        segments = (
            segment(SLIDE, (0, 29), 0.0, 0.2, process_std=0.001, observation_std=0.01),
            segment(held(0.2), (30, 39), 0.2, 0.2, process_std=9.0, observation_std=0.03),
            segment(SLIDE, (40, 49), 0.2, 0.4, process_std=0.003, observation_std=0.02),
        )
        noise = build_automaton(KinematicGraph((edge_of(*segments),))).noise
        assert noise.process_std == pytest.approx([np.sqrt((30 * 1e-6 + 10 * 9e-6) / 40)], rel=1e-5)
        assert noise.observation_std == pytest.approx([np.sqrt((30 * 1e-4 + 10 * 4e-4) / 40)], rel=1e-5)

    def test_given_noise_limits_parts_and_provenance_are_used(self) -> None:
        graph = KinematicGraph((chain("drawer", [0, END], ["prismatic"]),))
        drawer, table = Part("drawer", (Primitive("box", (0.1, 0.1, 0.1)),)), Part("table")
        noise = Noise((0.5,), (0.25,))
        automaton = build_automaton(
            graph, parts=[drawer, table], noise=noise, input_limits=[0.05], provenance={"method": "champ"}
        )
        assert automaton.parts == (drawer, table)
        assert automaton.noise == noise
        assert automaton.provenance == {"method": "champ"}
        assert [h.name for h in automaton.modes[0].inputs.half_spaces] == [
            "input drawer >= -0.05",
            "input drawer <= 0.05",
        ]
        assert two_rails().modes[0].inputs.is_everything

    def test_noise_of_perfect_data_stays_positive(self) -> None:
        perfect = segment(SLIDE, (0, 20), 0.0, 0.2, process_std=0.0, observation_std=0.0)
        noise = build_automaton(KinematicGraph((edge_of(perfect),))).noise
        assert min(*noise.process_std, *noise.observation_std) > 0

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"release": -0.1}, "release must be >= 0"),
            ({"release": float("nan")}, "release must be >= 0"),
            ({"input_limits": [0.1, 0.1]}, "input_limits must be 1 positive numbers"),
            ({"input_limits": [0.0]}, "input_limits must be 1 positive numbers"),
            ({"noise": Noise((0.1, 0.1), (0.1,))}, "process_std: must be 1 numbers, one for each coordinate"),
        ],
    )
    def test_bad_arguments(self, arguments: dict[str, object], message: str) -> None:
        graph = KinematicGraph((chain("drawer", [0, END], ["prismatic"]),))
        with pytest.raises(InputError, match=message):
            build_automaton(graph, **arguments)  # type: ignore[arg-type]

    def test_a_graph_without_edges(self) -> None:
        with pytest.raises(InputError, match="at least one edge"):
            build_automaton(KinematicGraph(()))
