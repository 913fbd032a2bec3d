"""A part fixed to another, as a handle to its door: no coordinate, no mode, but a place; and chains of moving parts."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from automaton_examples import END, SHUT, SPLIT, chain, segment

from micah_plan.automaton.build import build_automaton
from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph
from micah_plan.automaton.hybrid import HybridAutomaton, Link
from micah_plan.automaton.joint import prismatic, revolute, rigid
from micah_plan.automaton.kinematics import forward
from micah_plan.automaton.tracks import measuring_links, tracks
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError
from micah_plan.recording.value import Recording

HANDLE = rigid((0.1, 0.02, 0.0), (0.0, 0.0, 0.6, 0.8))
DOOR = chain("door", [0, SHUT, SHUT], ["revolute", "rigid"])
DRAWER = chain("drawer", [0, SPLIT, END], ["prismatic", "prismatic"])


def fixed(parent: str, child: str) -> KinematicEdge:
    return KinematicEdge(parent, child, (segment(HANDLE, (0, 59), 0.0, 0.0),))


def cabinet() -> HybridAutomaton:
    return build_automaton(
        KinematicGraph((DOOR, fixed("door", "handle"), DRAWER, fixed("handle", "sticker"))), input_limits=[0.1, 0.02]
    )


def two_hinges() -> HybridAutomaton:
    """A door on a door."""
    inner = revolute((0, 0, 1), (0.05, 0, 0), (0.4, 0, 0))
    upper = KinematicEdge(BASE, "upper", (segment(revolute((0, 0, 1), (0, 0, 0), (0.5, 0, 0)), (0, 9), -1.0, 1.0),))
    lower = KinematicEdge("upper", "lower", (segment(inner, (0, 9), -1.0, 1.0),))
    return build_automaton(KinematicGraph((upper, lower, fixed("lower", "hand"))))


def test_modes_and_coordinates_are_those_of_the_moving_parts() -> None:
    without = build_automaton(KinematicGraph((DOOR, DRAWER)), input_limits=[0.1, 0.02])
    with_handle = cabinet()
    assert with_handle.coordinates == without.coordinates
    assert with_handle.edges == without.edges
    assert with_handle.noise == without.noise
    assert [mode.name for mode in with_handle.modes] == [mode.name for mode in without.modes]
    assert [mode.pins for mode in with_handle.modes] == [mode.pins for mode in without.modes]


def test_a_fixed_part_follows_the_coordinate_of_what_carries_it() -> None:
    assert cabinet().links == (
        Link(BASE, "door", 0),
        Link("door", "handle", 0),
        Link(BASE, "drawer", 1),
        Link("handle", "sticker", 0),
    )
    for mode in cabinet().modes:
        assert [mode.joints[1].kind, mode.joints[3].kind] == ["rigid", "rigid"]
        assert forward(mode.joints[1], 0.3)[0].translation == pytest.approx(HANDLE.position)


def test_it_can_be_written_and_read(tmp_path) -> None:
    dump_model(cabinet(), tmp_path / "cabinet.yaml")
    assert load_model(tmp_path / "cabinet.yaml") == cabinet()


def test_every_mode_of_the_product_can_be_reached() -> None:
    automaton = cabinet()
    reached = {automaton.modes[0].name}
    for _ in automaton.modes:
        reached |= {edge.target for edge in automaton.edges if edge.source in reached}
    assert reached == {mode.name for mode in automaton.modes}


def test_the_moving_part_measures_the_coordinate() -> None:
    assert [(number, link.child) for number, link in measuring_links(cabinet())] == [(0, "door"), (2, "drawer")]
    wall = build_automaton(KinematicGraph((chain("wall", [0, 0], ["rigid"]),)))
    assert [link.child for _, link in measuring_links(wall)] == ["wall"]


def test_parents_come_first() -> None:
    with pytest.raises(InputError, match=r"edge door -> handle: .* earlier edge; list parents first"):
        build_automaton(KinematicGraph((fixed("door", "handle"), DOOR)))


def test_configurations_of_a_recording_with_a_fixed_part() -> None:
    automaton = cabinet()
    turn, slid = np.linspace(0.1, 1.0, 5), np.linspace(0.0, 0.15, 5)
    joints = automaton.modes[0].joints
    door, drawer = forward(joints[0], turn), forward(joints[2], slid)
    handle = door * forward(joints[1], np.zeros(5))
    sticker = handle * forward(joints[3], np.zeros(5))
    bodies = {"door": door, "handle": handle, "drawer": drawer, "sticker": sticker}
    recording = Recording(
        time=np.tile(np.arange(5.0), 4),
        position=np.concatenate([poses.translation for poses in bodies.values()]),
        quaternion=np.concatenate([poses.rotation.as_quat() for poses in bodies.values()]),
        action=np.zeros((20, 3)),
        part=tuple(name for name in bodies for _ in range(5)),
    )
    (track,) = tracks(automaton, recording)
    assert track.x == pytest.approx(np.stack([turn, slid], axis=1), abs=1e-9)
    assert track.u == pytest.approx(0.0, abs=1e-9)


def test_inputs_of_a_chain_are_read_from_displacements_that_contain_the_parents_motion() -> None:
    """Written as `execution.pose.command` writes them, wherever the parts then really went."""
    automaton = two_hinges()
    x = np.array([[0.1, 0.3], [0.4, -0.2], [0.4, -0.2], [0.5, 0.1]])
    u = np.array([[0.002, -0.003], [0.004, 0.0], [0.0, 0.005]])

    def placed(x: np.ndarray) -> list:
        upper = forward(automaton.modes[0].joints[0], x[:, 0])
        lower = upper * forward(automaton.modes[0].joints[1], x[:, 1])
        return [upper, lower, lower * forward(HANDLE, np.zeros(len(x)))]

    here, ahead = placed(x), placed(np.vstack([x[:-1] + u, x[-1:]]))
    recording = Recording(
        time=np.tile(np.arange(4.0), 3),
        position=np.concatenate([poses.translation for poses in here]),
        quaternion=np.concatenate([poses.rotation.as_quat() for poses in here]),
        action=np.concatenate([b.translation - a.translation for a, b in zip(here, ahead, strict=True)]),
        part=tuple(name for name in ("upper", "lower", "hand") for _ in range(4)),
    )
    (track,) = tracks(automaton, recording)
    assert track.x == pytest.approx(x, abs=1e-9)
    assert track.u == pytest.approx(u, abs=3e-5)
    unknown = recording.action.copy()
    unknown[5] = np.nan
    (gap,) = tracks(automaton, replace(recording, action=unknown))
    assert np.isnan(gap.u[1, 1])
    assert gap.u[[0, 2]] == pytest.approx(u[[0, 2]], abs=3e-5)


def test_a_tray_in_a_moving_carriage_has_its_own_coordinate() -> None:
    carriage = KinematicEdge(BASE, "carriage", (segment(prismatic((1, 0, 0), (0, 0, 0)), (0, 9), 0.0, 0.4),))
    tray = KinematicEdge("carriage", "tray", (segment(prismatic((0, 1, 0), (0, 0, 0.1)), (0, 9), 0.0, 0.2),))
    automaton = build_automaton(KinematicGraph((carriage, tray)))
    assert automaton.links == (Link(BASE, "carriage", 0), Link("carriage", "tray", 1))
    assert [mode.name for mode in automaton.modes] == ["prismatic/prismatic"]
