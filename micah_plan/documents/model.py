"""Model files (`models/*.yaml`): a hybrid automaton, read and written as exactly what it was."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.automaton.certainty import LearnedEdge
from micah_plan.automaton.check import checks
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton, Link
from micah_plan.automaton.region import Region
from micah_plan.documents.expressions import RegionEntries, Variables, region_data, region_of
from micah_plan.documents.joint import joint_remark
from micah_plan.documents.layout import Document, Line, Name, Names, NonNegative, Unit, doc, plain, unique
from micah_plan.documents.learned import LearnedEdgeDocument, learned_data, learned_of, learned_remarks
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.mode import ModeDocument, mode_data, mode_of
from micah_plan.documents.noise import NoiseDocument, noise_data, noise_of
from micah_plan.documents.parts import PartDocument, parts_data, parts_of
from micah_plan.documents.transition import TransitionDocument, edge_data, edge_of
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml, write_yaml
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes, replace_file

MODEL_FORMAT = "micah-plan/model/1"
# A model is square matrices of its coordinates, in each mode and transition: what a file may ask for is bounded.
MOST_ENTRIES = 10_000_000
_HEADER = """Motion model of an articulated object. Lengths in m, angles in rad, quaternions scalar last, poses in the
base frame. Half-spaces read `door >= 1.2`, `input door < -0.01` or `0.5*x + 2*z - input x > 0.1`; the state `door` is a
configuration, `input door` its commanded change per step. The order of modes and transitions matters."""


class LinkDocument(Document):
    parent: Name = doc("Part (or base) that the child's pose is relative to; a base or an earlier child.")
    child: Name = doc("Part that moves.")
    coordinate: Name = doc("Coordinate that its pose follows.")


class InitialDocument(Document):
    mode: Name = doc("Mode that the object may be in at first.")
    region: RegionEntries = doc("Half-spaces that the state then lies in.")


class EffectDocument(Document):
    name: Name = doc("Name of a registered form, e.g. `gain`.")
    coordinate: Name = doc("Coordinate that it acts on.")
    parameters: dict[Name, float] = doc("All parameters of the form, in its units.")
    std: dict[Name, NonNegative] = doc("Their standard deviations, if estimated.", dict)
    modes: Names = doc("Modes in which it acts; absent: in all.", tuple)
    note: Line = doc("What a person should know of it.", "")


class ModelDocument(Document):
    """The hybrid automaton of an articulated object."""

    format: Literal["micah-plan/model/1"] = doc("Format and version of this file.")
    provenance: dict[Name, Line] = doc("Where the model came from: recording digest, method, seed, versions.", dict)
    coordinates: Annotated[dict[Name, Unit], Field(min_length=1)] = doc(
        "The continuous states and their units (rad or m), in order."
    )
    inputs: Annotated[dict[Name, Unit], Field(min_length=1)] = doc(
        "The inputs (displacements per step) and their units, in order."
    )
    links: list[LinkDocument] = doc("Which coordinate moves which part, parents first.")
    parts: dict[Name, PartDocument] = doc("Shapes and handles of the parts.", dict)
    noise: NoiseDocument = doc("Process and observation noise.")
    modes: Annotated[dict[Name, ModeDocument], Field(min_length=1)] = doc("The discrete states.")
    transitions: list[TransitionDocument] = doc(
        "Edges between modes; of several whose guards hold at once the first listed is taken."
    )
    init: list[InitialDocument] = doc("Initial states; empty: wherever an invariant holds.", list)
    learned: list[LearnedEdgeDocument] = doc("What learning was sure of, by edge of the kinematic graph.", list)
    effects: list[EffectDocument] = doc(
        "What calibration added. Those on guards and joints are already in modes and transitions; the others act in "
        "every step.",
        list,
    )


def load_model(path: str | Path) -> HybridAutomaton:
    """The automaton that a model file holds.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    return usable_model(read_bytes(path, LARGEST_TEXT_BYTES), str(path))


def dump_model(automaton: HybridAutomaton, path: str | Path) -> None:
    """Write a model file, at once or not at all.

    Raises:
        InputError: if the automaton is not one that a file may hold, or the file cannot be written.
    """
    replace_file(path, model_text(automaton).encode())


def usable_model(content: bytes, source: str) -> HybridAutomaton:
    """As `parse_model`, and what the file describes is also an automaton that the algorithms can use.

    Raises:
        InputError: also for what `automaton.check` refuses, with the place in the file.
    """
    located = read_yaml(content, source)
    automaton = automaton_of(located)
    for place, check in checks(automaton):
        with located.at(*(("transitions", *place[1:]) if place[:1] == ("edges",) else place)).locating_errors():
            check()
    return automaton


def parse_model(content: bytes, source: str) -> HybridAutomaton:
    """The automaton that the content of a model file describes, usable or not; `source` names the file in messages."""
    return automaton_of(read_yaml(content, source))


def model_text(automaton: HybridAutomaton) -> str:
    """The text of a model file that reads back as exactly this automaton.

    Raises:
        InputError: if the automaton is not one that a file may hold.
    """
    return write_yaml(model_data(automaton), _HEADER, _remarks(automaton))


def automaton_of(located: Located) -> HybridAutomaton:
    """The automaton that the data of a model file describes.

    Raises:
        InputError: if the layout is another, or names, sizes or values do not agree with each other.
    """
    document = validated(located, ModelDocument)
    entries = len(document.coordinates) ** 2 * (len(document.modes) + len(document.transitions))
    if entries > MOST_ENTRIES:
        problem = f"its matrices have {entries} entries, more than {MOST_ENTRIES}"
        raise located.error(problem, "use fewer coordinates, modes or transitions")
    names, modes = Variables(tuple(document.coordinates), tuple(document.inputs)), list(document.modes)
    links = _links_of(document.links, names, located.at("links"))
    _check_parts(document, located)
    children = [link.child for link in links]
    return HybridAutomaton(
        coordinates=tuple(Coordinate(name, unit) for name, unit in document.coordinates.items()),
        inputs=tuple(Coordinate(name, unit) for name, unit in document.inputs.items()),
        links=links,
        parts=parts_of(document.parts, located.at("parts")),
        modes=tuple(
            mode_of(name, mode, names, children, located.at("modes", name)) for name, mode in document.modes.items()
        ),
        edges=tuple(
            edge_of(edge, names, modes, located.at("transitions", i)) for i, edge in enumerate(document.transitions)
        ),
        noise=noise_of(document.noise, names.coordinates, located.at("noise")),
        init=tuple(_init_of(item, names, modes, located.at("init", i)) for i, item in enumerate(document.init)),
        provenance=document.provenance,
        learned=tuple(_learned_of(edge, links, located.at("learned", i)) for i, edge in enumerate(document.learned)),
        effects=tuple(
            _effect_of(effect, names, modes, located.at("effects", i)) for i, effect in enumerate(document.effects)
        ),
    )


def model_data(automaton: HybridAutomaton) -> dict[str, Any]:
    """The data of a model file that `automaton_of` reads back as exactly this automaton.

    Raises:
        InputError: if the automaton is not one that a file may hold (a name twice, a number that is not finite, sizes
            that disagree).
    """
    names = Variables(automaton.coordinate_names, automaton.input_names)
    entries = {
        "format": MODEL_FORMAT,
        "provenance": automaton.provenance,
        "coordinates": unique((c.name, c.unit) for c in automaton.coordinates),
        "inputs": unique((c.name, c.unit) for c in automaton.inputs),
        "links": [{**vars(link), "coordinate": names.coordinates[link.coordinate]} for link in automaton.links],
        "parts": parts_data(automaton.parts),
        "noise": noise_data(automaton.noise, names.coordinates),
        "modes": unique((mode.name, mode_data(mode, automaton, names)) for mode in automaton.modes),
        "transitions": [edge_data(edge, names) for edge in automaton.edges],
        "init": [{"mode": mode, "region": region_data(region, names)} for mode, region in automaton.init],
        "learned": [learned_data(edge) for edge in automaton.learned],
        "effects": [_effect_data(effect) for effect in automaton.effects],
    }
    data = plain(ModelDocument, entries)
    if automaton_of(Located(data, "automaton")) != automaton:
        problem = "automaton: sizes of its parts do not agree, so it cannot be written"
        raise InputError(problem, remedy="check its values")
    return data


def _remarks(automaton: HybridAutomaton) -> dict[KeyPath, str]:
    """Remarks for people by key path: standard deviations of what was estimated, and how sure learning was."""
    remarks: dict[KeyPath, str] = {}
    for i, edge in enumerate(automaton.learned):
        remarks |= {("learned", i, *path): remark for path, remark in learned_remarks(edge).items()}
    for mode in automaton.modes:
        for link, joint in zip(automaton.links, mode.joints, strict=True):
            remark = joint_remark(joint)
            if remark is not None:
                remarks["modes", mode.name, "joints", link.child, "covariance", "names"] = remark
    return remarks


def _links_of(documents: Sequence[LinkDocument], names: Variables, located: Located) -> tuple[Link, ...]:
    children, links = [link.child for link in documents], []
    for i, link in enumerate(documents):
        if link.child == link.parent:
            raise located.at(i, "child").error("a part moves itself", "links form a tree")
        if link.child in children[:i]:
            raise located.at(i, "child").error(f"part '{link.child}' hangs on two parents", "links form a tree")
        if link.parent in children[i:]:
            raise located.at(i, "parent").error(f"parent '{link.parent}' is linked only later", "list parents first")
        coordinate = located.at(i, "coordinate").number(link.coordinate, names.coordinates, "coordinate")
        links.append(Link(link.parent, link.child, coordinate))
    return tuple(links)


def _check_parts(document: ModelDocument, located: Located) -> None:
    known = dict.fromkeys([BASE, *(name for link in document.links for name in (link.parent, link.child))])
    for name in document.parts:
        located.at("parts", name).number(name, known, "part")


def _init_of(document: InitialDocument, names: Variables, modes: list[str], located: Located) -> tuple[str, Region]:
    located.at("mode").number(document.mode, modes, "mode")
    return document.mode, region_of(document.region, names, located.at("region"))


def _learned_of(document: LearnedEdgeDocument, links: Sequence[Link], located: Located) -> LearnedEdge:
    edges = [(link.parent, link.child) for link in links]
    if (document.parent, document.child) not in edges:
        names = ", ".join(f"{parent} to {child}" for parent, child in edges) or "none"
        problem = f"no link leads from {shown(document.parent)} to {shown(document.child)}"
        raise located.error(problem, f"links: {names}")
    return learned_of(document, located)


def _effect_of(document: EffectDocument, names: Variables, modes: list[str], located: Located) -> Effect:
    located.at("coordinate").number(document.coordinate, names.coordinates, "coordinate")
    for mode in document.modes:
        located.at("modes").number(mode, modes, "mode")
    with located.at("name").locating_errors():
        own = [parameter.name for parameter in form(document.name).parameters]
    values = located.at("parameters").in_order(document.parameters, own, "parameter")
    std = located.at("std").in_order(document.std, own, "parameter") if document.std else ()
    return Effect(**dict(document) | {"parameters": tuple(zip(own, values, strict=True)), "std": std})


def _effect_data(effect: Effect) -> dict[str, Any]:
    """The entry of an effect, which `_effect_of` reads back."""
    parameters = dict(effect.parameters)
    std = dict(zip(parameters, effect.std, strict=True)) if effect.std else {}
    return plain(EffectDocument, {**vars(effect), "parameters": parameters, "std": std})
