"""Effects on geometry: the frame in which an action was given, and where the joint really is."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import final

import numpy as np

from micah_plan.automaton.augmented import mapped
from micah_plan.automaton.effects.fit_start import CoordinateSeries, EquivalentEffect, FitStart
from micah_plan.automaton.effects.form import EffectForm, Operations, Parameter, Value, Values
from micah_plan.automaton.hybrid import HybridAutomaton, Mode
from micah_plan.automaton.joint import Joint, axis_basis, rigid, twisting

# Actions across the joint that are smaller than this share of the commands are uninformative about their frame.
_ACROSS = 0.1
# A turn may make commands as long as the actions, give or take what a gain is uncertain by.
_AS_LONG = 1.02


@final
class FrameRotation(EffectForm):
    """The action was given in a frame that is turned by the rotation vector relative to the base frame."""

    name = "frame_rotation"
    sentence = "Actions are given in a frame that is turned against the base frame."
    source = "Murray, Li and Sastry, ch. 2: exponential coordinates of rotations"
    parameters = tuple(Parameter(f"rotation_{k}", "rad", 0.0, -3.2, 3.2) for k in (1, 2, 3))
    complexity_rank = 17
    experiments = (
        (
            "gain",
            "command a displacement across the joint: in a turned frame it moves the part, with a gain it does not",
        ),
    )

    def frame_command(self, ops: Operations, action: Values, direction: Values, p: Values) -> Value:
        squared = p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + 1e-18
        angle = squared**0.5
        along, bent = ops.sin(angle) / angle, (1.0 - ops.cos(angle)) / squared
        once = _cross(p, action)
        twice = _cross(p, once)
        turned = [a + along * b + bent * c for a, b, c in zip(action, once, twice, strict=True)]
        return turned[0] * direction[0] + turned[1] * direction[1] + turned[2] * direction[2]

    def initial_guess(self, data: CoordinateSeries) -> FitStart | None:
        """Starts only where actions across the joint vary independently.

        A small rotation adds to each command a share of the action across the joint. If that is proportional to the
        command along it (a hand that always pushes at one angle, the chord of a long step), it acts like a gain or a
        saturation.
        """
        if data.action is None:
            return None
        rows = data.counted_starts
        tangent, u = data.path.tangents(data.z[rows])[:, 3:], data.u[rows]
        squared = np.maximum((tangent**2).sum(axis=1, keepdims=True), 1e-12)
        across = np.cross(data.action[rows], tangent) / squared
        along = np.stack([np.ones_like(u), u, u * np.abs(u), u * u], axis=1)
        transverse = across - along @ np.linalg.lstsq(along, across, rcond=1e-9)[0]
        if np.sqrt(np.mean(transverse**2, axis=0)).max() < _ACROSS * data.command_size:
            return None
        return FitStart(np.vstack([0.4 * np.eye(3), -0.4 * np.eye(3)]), (0, 1, 2), [0.3] * 3)

    def equivalent_effect(self, data: CoordinateSeries) -> EquivalentEffect | None:
        """A gain, unless commands across the joint are informative: a rotation along the joint only scales commands."""
        if data.action is None or self.initial_guess(data) is not None:
            return None
        rows = data.counted_starts
        arm2 = (data.path.tangents(data.z[rows])[:, 3:] ** 2).sum(axis=1)
        longest2 = float((data.action[rows] ** 2).sum(axis=1) @ (1.0 / np.maximum(arm2, 1e-12)))
        told2 = max(float((data.u[rows] ** 2).sum()), 1e-300)
        return EquivalentEffect("gain", _AS_LONG * float(np.sqrt(longest2 / told2)))


@final
class ScrewPitch(EffectForm):
    """The part also moves along the axis of rotation, by an additional `pitch` per rad."""

    name = "screw_pitch"
    sentence = "The part moves along its axis of rotation while it turns."
    source = "Murray, Li and Sastry, ch. 2: screws"
    parameters = (Parameter("pitch", "m/rad", 0.0),)
    in_library = False

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        return _with_joints(automaton, coordinate, lambda joint: _turned_about(joint, pitch=p[0]))


@final
class AxisOffset(EffectForm):
    """The axis of rotation is displaced by `offset_1`, `offset_2` along the directions of `joint.axis_basis`."""

    name = "axis_offset"
    sentence = "The axis of rotation is displaced from that of the model."
    source = "Sturm et al., JAIR 2011: parameters of articulated objects"
    parameters = (Parameter("offset_1", "m", 0.0), Parameter("offset_2", "m", 0.0))
    in_library = False

    def rebuilt(self, automaton: HybridAutomaton, coordinate: int, p: Sequence[float]) -> HybridAutomaton:
        return _with_joints(automaton, coordinate, lambda joint: _turned_about(joint, p))


def _turned_about(joint: Joint, by: Sequence[float] = (0.0, 0.0), pitch: float = 0.0) -> Joint:
    """A rotating joint with its axis displaced [m] along `axis_basis`, and additional pitch [m/rad]."""
    if not joint.turns:
        return joint
    center = np.array(joint.center) + np.array(by) @ axis_basis(joint.axis)
    kind = "screw" if pitch else joint.kind
    made = twisting(kind, joint.axis, center, joint.pitch + pitch, joint.position, joint.quaternion)
    return replace(made, covariance=joint.covariance)


def rigid_at(moving: Joint, c: float, before: Joint) -> Joint:
    """A rigid joint at configuration c of a moving one; `before` if the joint does not move."""
    if not moving.moves:
        return replace(before, fixed_at=c)
    from micah_plan.automaton.kinematics import forward  # SciPy's transforms take long to load

    pose = forward(moving, c)[0]
    return rigid(pose.translation, pose.rotation.as_quat(), c)


def _with_joints(automaton: HybridAutomaton, coordinate: int, change: Callable[[Joint], Joint]) -> HybridAutomaton:
    """The automaton with the joints of a coordinate changed, including rigid ones at the changed motion's ends."""

    def changed(number: int, joint: Joint) -> Joint:
        if automaton.links[number].coordinate != coordinate:
            return joint
        if not joint.moves:
            return rigid_at(change(automaton.moving_joint(number)), joint.fixed_at, joint)
        return change(joint)

    def changed_mode(mode: Mode) -> Mode:
        return replace(mode, joints=tuple(changed(number, joint) for number, joint in enumerate(mode.joints)))

    return mapped(automaton, changed_mode)


def _cross(a: Values, b: Values) -> list[Value]:
    """The cross product of two vectors of three values."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
