"""A hybrid automaton -> the plain data of a model file, in the form that reads best."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.hybrid import Edge, HybridAutomaton, Mode, Part, Primitive, Reset
from micah_plan.automaton.joint import Joint
from micah_plan.automaton.region import Region
from micah_plan.automaton.sensing import Light
from micah_plan.documents.expressions import Variables, affine_text, canonical_name, half_space_text, parse_affine
from micah_plan.documents.learned_values import learned_comments, learned_data
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.model_document import MODEL_FORMAT, ModelDocument
from micah_plan.documents.model_values import automaton_of
from micah_plan.documents.part_document import IDENTITY, ZERO
from micah_plan.documents.validation import validated
from micah_plan.errors import InputError

_DEFAULT_COLOR = Primitive("box", (1.0, 1.0, 1.0)).color


def model_data(automaton: HybridAutomaton) -> dict[str, Any]:
    """The data of a model file that reads back as exactly this automaton.

    Raises:
        InputError: if the automaton is not one that a file may hold (a name twice, a number that is not finite, sizes
            that disagree).
    """
    names = Variables(automaton.coordinate_names, automaton.input_names)
    data = {
        "format": MODEL_FORMAT,
        "provenance": dict(automaton.provenance),
        "coordinates": _unique((c.name, c.unit) for c in automaton.coordinates),
        "inputs": _unique((c.name, c.unit) for c in automaton.inputs),
        "links": [
            {"parent": link.parent, "child": link.child, "coordinate": names.coordinates[link.coordinate]}
            for link in automaton.links
        ],
        "parts": _unique((part.name, _part(part)) for part in automaton.parts),
        "noise": {
            "process_std": _by_name(names.coordinates, automaton.noise.process_std),
            "observation_std": _by_name(names.coordinates, automaton.noise.observation_std),
            **light_data(automaton.noise.light, names.coordinates),
        },
        "modes": _unique((mode.name, _mode(mode, automaton, names)) for mode in automaton.modes),
        "transitions": [_transition(edge, names) for edge in automaton.edges],
        "init": [{"mode": mode, "region": _region(region, names)} for mode, region in automaton.init],
        "learned": learned_data(automaton.learned),
        "effects": [_effect(effect) for effect in automaton.effects],
    }
    data = {key: value for key, value in data.items() if value or key in ("links", "transitions")}
    located = Located(data, "automaton")
    if automaton_of(validated(located, ModelDocument), located) != automaton:
        raise InputError(
            "automaton: sizes of its parts do not agree, so it cannot be written", remedy="check its values"
        )
    return data


def std_comments(automaton: HybridAutomaton) -> dict[KeyPath, str]:
    """Remarks with the standard deviations of what was estimated, by key path."""
    remarks: dict[KeyPath, str] = learned_comments(automaton.learned)
    for mode in automaton.modes:
        for link, joint in zip(automaton.links, mode.joints, strict=True):
            if joint.covariance is not None:
                stds = np.sqrt(np.maximum(np.diag(np.array(joint.covariance.matrix)), 0.0))
                path = ("modes", mode.name, "joints", link.child, "covariance", "names")
                remarks[path] = "std " + ", ".join(
                    f"{std:.2g} {_unit(name)}" for name, std in zip(joint.covariance.names, stds, strict=True)
                )
    return remarks


def _unit(parameter: str) -> str:
    kind = parameter.split("_")[0]
    return "m/rad" if kind == "pitch" else "rad" if kind in ("axis", "rotation") else "m"


def _unique(items: Any) -> dict[str, Any]:
    result: dict[str, Any] = {}
    for name, value in items:
        if name in result:
            raise InputError(f"automaton: the name '{name}' is used twice", remedy="names are unique")
        result[name] = value
    return result


def _floats(values: Sequence[float]) -> list[float]:
    return [float(value) for value in values]


def _by_name(names: Sequence[str], values: Sequence[float]) -> dict[str, float]:
    if len(names) != len(values):
        raise InputError(f"automaton: expected {len(names)} standard deviations, found {len(values)}")
    return dict(zip(names, _floats(values), strict=True))


def light_data(light: Light | None, names: Sequence[str]) -> dict[str, Any]:
    """The entry of a light in a noise section; none without a light."""
    if light is None:
        return {}
    place = _unique((names[i], float(value)) for i, value in light.at)
    return {"light": {"at": place, "growth": _by_name(names, light.growth)}}


def _without_defaults(data: Mapping[str, Any], defaults: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in data.items() if key not in defaults or value != defaults[key]}


def _part(part: Part) -> dict[str, Any]:
    data: dict[str, Any] = {} if part.handle is None else {"handle": _floats(part.handle)}
    if part.shapes:
        data["shapes"] = [shape_data(shape) for shape in part.shapes]
    return data


def shape_data(shape: Primitive) -> dict[str, Any]:
    """The entry of a solid."""
    data = {
        "kind": shape.kind,
        "size": _floats(shape.size),
        "position": _floats(shape.position),
        "quaternion": _floats(shape.quaternion),
        "color": shape.color,
    }
    defaults = {"position": list(ZERO), "quaternion": list(IDENTITY), "color": _DEFAULT_COLOR}
    return _without_defaults(data, defaults)


def _mode(mode: Mode, automaton: HybridAutomaton, names: Variables) -> dict[str, Any]:
    if len(mode.joints) != len(automaton.links) or mode.B.shape != (automaton.n, automaton.m):
        raise InputError(
            f"automaton: mode '{mode.name}' needs {len(automaton.links)} joints and B {(automaton.n, automaton.m)}. "
            f"Got {len(mode.joints)} and {mode.B.shape}"
        )
    nothing = (0.0,) * automaton.n
    data = {
        "joints": {link.child: _joint(joint) for link, joint in zip(automaton.links, mode.joints, strict=True)},
        "step": {
            name: affine_text(nothing, row, None, names)
            for name, row in zip(names.coordinates, mode.input_matrix, strict=True)
            if any(row)
        },
        "invariant": _region(mode.invariant, names),
    }
    if mode.inputs.half_spaces:
        data["inputs"] = _region(mode.inputs, names)
    if mode.pins:
        data["pins"] = _unique(
            (names.coordinates[pin.coordinate], {"value": float(pin.value), "std": float(pin.std)}) for pin in mode.pins
        )
    if mode.ties:
        still = (0.0,) * automaton.m
        data["ties"] = _unique(
            (names.coordinates[t.coordinate], affine_text(t.weights, still, float(t.offset), names)) for t in mode.ties
        )
    if mode.observation_std:
        data["observation_std"] = _unique((names.coordinates[i], float(std)) for i, std in mode.observation_std)
    return data


def _effect(effect: Effect) -> dict[str, Any]:
    data: dict[str, Any] = {"name": effect.name, "coordinate": effect.coordinate}
    data["parameters"] = {name: float(value) for name, value in effect.parameters}
    if effect.std:
        data["std"] = {name: float(std) for (name, _), std in zip(effect.parameters, effect.std, strict=True)}
    extra = {"modes": list(effect.modes), "note": effect.note}
    return data | {key: value for key, value in extra.items() if value}


def _joint(joint: Joint) -> dict[str, Any]:
    data: dict[str, Any] = {
        "kind": joint.kind,
        "position": _floats(joint.position),
        "quaternion": _floats(joint.quaternion),
        "axis": _floats(joint.axis),
        "center": _floats(joint.center),
        "pitch": float(joint.pitch),
        "held": float(joint.held),
    }
    defaults = {"quaternion": list(IDENTITY), "axis": list(ZERO), "center": list(ZERO), "pitch": 0.0, "held": 0.0}
    data = _without_defaults(data, defaults)
    if joint.covariance is not None:
        matrix = [_floats(row) for row in joint.covariance.matrix]
        data["covariance"] = {"names": list(joint.covariance.names), "matrix": matrix}
    return data


def _region(region: Region, names: Variables) -> list[Any]:
    entries: list[Any] = []
    for half_space in region.half_spaces:
        if (len(half_space.a), len(half_space.b)) != (len(names.coordinates), len(names.inputs)):
            raise InputError(f"automaton: half-space '{half_space.name}' has weights of another state or input size")
        text = half_space_text(half_space, names)
        own_name = half_space.name not in ("", canonical_name(half_space, names))
        entries.append({half_space.name: text} if own_name else text)
    return entries


def _transition(edge: Edge, names: Variables) -> dict[str, Any]:
    data: dict[str, Any] = {"source": edge.source, "target": edge.target, "guard": _region(edge.guard, names)}
    spread = {"threshold_std": float(edge.threshold_std)} if edge.threshold_std else {}
    return {**data, **_reset(edge.reset, names), **spread}


def _reset(reset: Reset, names: Variables) -> dict[str, Any]:
    """Expressions where they mean exactly this reset, else its matrices."""
    if reset.is_identity:
        return {}
    n, m = len(names.coordinates), len(names.inputs)
    a, b, c = reset.matrices(n, m)
    if a.shape != (n, n) or b.shape != (n, m) or c.shape != (n,):
        raise InputError(f"automaton: a reset has matrices of sizes {a.shape}, {b.shape}, {c.shape}")
    texts: dict[str, str] = {
        name: affine_text(a[i], b[i], c[i], names)
        for i, name in enumerate(names.coordinates)
        if not (np.array_equal(a[i], np.eye(n)[i]) and not b[i].any() and c[i] == 0.0)
    }
    says = {name: parse_affine(text, names) for name, text in texts.items()}
    says_constant = any(value.has_constant for value in says.values())
    exact = (
        (reset.A is None) == np.array_equal(a, np.eye(n))
        and (reset.B is None) == (not b.any())
        and (reset.c is not None) == says_constant
    )
    if exact:
        is_number = {name: not any((*value.a, *value.b)) for name, value in says.items()}
        return {"reset": {name: float(text) if is_number[name] else text for name, text in texts.items()}}
    matrices: dict[str, Any] = {}
    if reset.A is not None:
        matrices["A"] = a.tolist()
    if reset.B is not None:
        matrices["B"] = b.tolist()
    if reset.c is not None:
        matrices["c"] = c.tolist()
    return {"reset_matrices": matrices}
