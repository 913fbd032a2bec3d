"""Modes: their joints, dynamics, sets and measurement, the entries `modes` of a model file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from micah_plan.automaton.hybrid import HybridAutomaton, Mode, Pin, Tie
from micah_plan.documents.expressions import (
    Expression,
    RegionEntries,
    Variables,
    affine_of,
    affine_text,
    region_data,
    region_of,
)
from micah_plan.documents.joint import JointDocument, joint_data, joint_of
from micah_plan.documents.layout import Document, Name, NonNegative, Positive, doc, plain, unique
from micah_plan.documents.located import Located
from micah_plan.errors import InputError

T = TypeVar("T")


class PinDocument(Document):
    value: float = doc("Configuration at which the mode holds the coordinate [rad or m].")
    std: NonNegative = doc("Standard deviation of that value [rad or m].")


class ModeDocument(Document):
    joints: dict[Name, JointDocument] = doc("The joint of every link in this mode, by child part.")
    step: dict[Name, Expression] = doc(
        "Change of each coordinate in one step as a linear expression, e.g. `door: input door`; a coordinate that is "
        "left out does not move."
    )
    invariant: RegionEntries = doc("Half-spaces in all of which the mode's dynamics hold.")
    inputs: RegionEntries = doc("Half-spaces that admissible inputs lie in.", list)
    pins: dict[Name, PinDocument] = doc("Coordinates that the mode holds fixed, e.g. by a latch.", dict)
    ties: dict[Name, Expression] = doc(
        "Coordinates that follow others, as an affine expression of them, e.g. `theta: 0.9 - 6.8*z`: an angle that "
        "follows a height while an edge touches a table.",
        dict,
    )
    observation_std: dict[Name, Positive] = doc(
        "Std of one measurement in this mode, of coordinates that it measures in its own way, wherever it is [rad or "
        "m]; default: as under `noise`.",
        dict,
    )


def mode_of(name: str, document: ModeDocument, names: Variables, parts: Sequence[str], located: Located) -> Mode:
    """The mode that an entry describes.

    Args:
        parts: the child parts of the links, in order.
    """
    joints = located.at("joints")
    for child in document.joints:
        joints.at(child).number(child, parts, "linked part")
    missing = [child for child in parts if child not in document.joints]
    if missing:
        raise joints.error(f"missing joint of part '{missing[0]}'", "every mode has a joint for every link")

    pins = tuple(Pin(i, **dict(pin)) for i, pin in _numbered(document.pins, names, located.at("pins")))
    return Mode(
        name=name,
        joints=tuple(joint_of(document.joints[child], joints.at(child)) for child in parts),
        input_matrix=_step_of(document.step, names, located.at("step")),
        invariant=region_of(document.invariant, names, located.at("invariant")),
        inputs=region_of(document.inputs, names, located.at("inputs")),
        pins=pins,
        observation_std=tuple(_numbered(document.observation_std, names, located.at("observation_std"))),
        ties=tuple(_tie_of(own, text, names, located.at("ties", own)) for own, text in document.ties.items()),
    )


def mode_data(mode: Mode, automaton: HybridAutomaton, names: Variables) -> dict[str, Any]:
    """The entry of a mode, which `mode_of` reads back."""
    if len(mode.joints) != len(automaton.links) or mode.B.shape != (automaton.n, automaton.m):
        raise InputError(
            f"automaton: mode '{mode.name}' needs {len(automaton.links)} joints and B {(automaton.n, automaton.m)}. "
            f"Got {len(mode.joints)} and {mode.B.shape}"
        )
    at_rest, still = (0.0,) * automaton.n, (0.0,) * automaton.m
    data = {
        "joints": {link.child: joint_data(joint) for link, joint in zip(automaton.links, mode.joints, strict=True)},
        "step": {
            name: affine_text(at_rest, row, None, names)
            for name, row in zip(names.coordinates, mode.input_matrix, strict=True)
            if any(row)
        },
        "invariant": region_data(mode.invariant, names),
        "inputs": region_data(mode.inputs, names),
        "pins": unique((names.coordinates[pin.coordinate], pin) for pin in mode.pins),
        "ties": unique(
            (names.coordinates[t.coordinate], affine_text(t.weights, still, float(t.offset), names)) for t in mode.ties
        ),
        "observation_std": unique((names.coordinates[i], std) for i, std in mode.observation_std),
    }
    return plain(ModeDocument, data)


def _numbered(entries: Mapping[str, T], names: Variables, located: Located) -> list[tuple[int, T]]:
    """Entries by coordinate, with its number instead of its name."""
    return [(located.at(name).number(name, names.coordinates, "coordinate"), item) for name, item in entries.items()]


def _step_of(step: Mapping[str, str], names: Variables, located: Located) -> tuple[tuple[float, ...], ...]:
    rows = [(0.0,) * len(names.inputs) for _ in names.coordinates]
    for name, text in step.items():
        index = located.at(name).number(name, names.coordinates, "coordinate")
        change = affine_of(text, names, located.at(name))
        if any(change.a) or change.constant:
            remedy = "write only inputs, such as 'input door' or '0.5*input door'"
            raise located.at(name).error("a step is linear in the inputs", remedy)
        rows[index] = change.b
    return tuple(rows)


def _tie_of(name: str, text: str, names: Variables, located: Located) -> Tie:
    value = affine_of(text, names, located)
    if any(value.b):
        raise located.error("a tie is about coordinates, not inputs", "write e.g. '0.9 - 6.8*z'")
    return Tie(located.number(name, names.coordinates, "coordinate"), value.a, value.constant)
