"""Joints whose parameters are known only so well, and a door that has one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from micah_plan.automaton.hybrid import Coordinate, Edge, HybridAutomaton, Link, Mode, Noise, Part, Pin
from micah_plan.automaton.joint import Joint, ParameterCovariance, revolute, rigid
from micah_plan.automaton.region import Region, above, input_below

SHUT, LEVER = 0.6, 0.3
NAMES = {
    "rigid": (),
    "prismatic": ("axis_1", "axis_2"),
    "revolute": ("axis_1", "axis_2", "center_1", "center_2"),
    "screw": ("axis_1", "axis_2", "center_1", "center_2", "pitch"),
}
POSE = ("rotation_1", "rotation_2", "rotation_3", "position_1", "position_2", "position_3")


def known_to(joint: Joint, std: float, seed: int) -> Joint:
    """The joint with a random covariance of all its parameters, of about that std."""
    names = NAMES[joint.kind] + POSE
    root = std * np.random.default_rng(seed).normal(size=(len(names), len(names))) / np.sqrt(len(names))
    return replace(joint, covariance=ParameterCovariance(names, tuple(tuple(map(float, row)) for row in root @ root.T)))


def swinging(lever_std: float | None) -> Joint:
    """A hinge about z whose lever of 0.3 m along x is known to that std; None: it has no covariance."""
    joint = revolute((0, 0, 1), (0, 0, 0), (LEVER, 0, 0))
    if lever_std is None:
        return joint
    return replace(joint, covariance=ParameterCovariance(("position_1",), ((lever_std**2,),)))


def unsure_door(gain_std: float | None, process: float = 0.002, observation: float = 0.01) -> HybridAutomaton:
    """A door that latches at 0.6 rad, with a relative std of its gain; None: without covariance."""
    name = (Coordinate("door", "rad"),)
    joint = swinging(None if gain_std is None else gain_std * LEVER)
    swing = Mode("swing", (joint,), ((1.0,),))
    shut = Mode(
        "shut", (rigid((LEVER, 0, 0)),), ((0.0,),), Region((above(0, SHUT, 1, 1),)), pins=(Pin(0, SHUT, 0.004),)
    )
    edges = (
        Edge("swing", "shut", Region((above(0, SHUT, 1, 1),)), threshold_std=0.01),
        Edge("shut", "swing", Region((input_below(0, 0.0, 1, 1, strict=True),))),
    )
    links, parts, noise = (Link("base", "door", 0),), (Part("base"), Part("door")), Noise((process,), (observation,))
    return HybridAutomaton(name, name, links, parts, (swing, shut), edges, noise)
