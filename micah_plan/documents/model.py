"""Model files (`models/*.yaml`): hybrid automata, written and read back without loss."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from micah_plan.automaton.check import checks
from micah_plan.automaton.effects.registry import form
from micah_plan.automaton.effects.value import Effect, Since
from micah_plan.automaton.graph import BASE
from micah_plan.automaton.hybrid import Coordinate, HybridAutomaton, Link, Mode
from micah_plan.automaton.joint import ParameterCovariance
from micah_plan.automaton.region import Region
from micah_plan.documents.expressions import RegionEntries
from micah_plan.documents.fields import (
    BY_NAME,
    ITEMS,
    CoordinateName,
    Digest,
    Line,
    ModeName,
    ModeNames,
    Name,
    Names,
    NonNegative,
    PartName,
    Unit,
    named,
)
from micah_plan.documents.joint import CovarianceDocument, joint_remark
from micah_plan.documents.layout import Document, Mark, Scope, doc, plain_data, unique
from micah_plan.documents.learned import LearnedEdgeDocument, learned_remarks
from micah_plan.documents.located import KeyPath, Located
from micah_plan.documents.mode import ModeDocument, TransitionDocument
from micah_plan.documents.noise import NoiseDocument
from micah_plan.documents.parts import PartDocument
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml, write_yaml
from micah_plan.errors import InputError, shown
from micah_plan.files import read_bytes, replace_file

MODEL_FORMAT = "micah-plan/model/1"
# A model is square matrices of its coordinates, in each mode and transition: their size is bounded.
MOST_ENTRIES = 10_000_000
_HEADER = """Motion model of an articulated object. Lengths in m, angles in rad, quaternions scalar last, poses in the
base frame. Half-spaces read `door >= 1.2`, `input door < -0.01` or `0.5*x + 2*z - input x > 0.1`; the state `door` is a
configuration, `input door` its commanded change per step. The order of modes and transitions matters."""
_COORDINATES = Mark(
    lambda units, *_: tuple(Coordinate(*item) for item in units.items()),
    lambda coordinates, _: unique((coordinate.name, coordinate.unit) for coordinate in coordinates),
)


class LinkDocument(Document):
    makes = Link

    parent: Name = doc("Part (or base) that the child's pose is relative to; a base or an earlier child.")
    child: Name = doc("Part that moves.")
    coordinate: CoordinateName = doc("Coordinate that its pose follows.")


class InitialDocument(Document):
    mode: ModeName = doc("Mode that the object may be in at first.")
    region: RegionEntries = doc("Half-spaces that the state then lies in.")

    def read(self, at: Located, scope: Scope) -> tuple[str, Region]:
        return self.mode, self.meanings(at, scope)["region"]

    @classmethod
    def written(cls, value: tuple[str, Region], scope: Scope) -> Mapping[str, Any]:
        return dict(zip(cls.model_fields, value, strict=True))


class SinceDocument(Document):
    makes = Since

    time: NonNegative = doc("Since the start of a run [s].")
    run: int | None = doc("Number of the run in which it began; absent: in every run from that time on.", None)
    digest: Digest | None = doc("SHA-256 of the rows of that run; recordings without them were made later.", None)

    def check(self, at: Located) -> None:
        if (self.run is None) != (self.digest is None):
            lacking = "run" if self.run is None else "digest"
            problem = f"expected a run and the digest of its rows, found no {lacking}"
            raise at.error(problem, "leave out both for an effect that starts again in every run")


class EffectDocument(Document):
    makes = Effect

    name: Name = doc("Name of a registered form, e.g. `gain`.")
    coordinate: Annotated[Name, named("coordinate")] = doc("Coordinate that it acts on.")
    parameters: Annotated[dict[Name, float], ITEMS] = doc(
        "All parameters of the form, in its units; neutral options are left out."
    )
    std: dict[Name, NonNegative] = doc("Their standard deviations, if estimated.", dict)
    modes: ModeNames = doc("Modes in which it acts; absent: in all.", tuple)
    note: Line = doc("A remark for people.", "")
    since: SinceDocument | None = doc("From when on it acts in the recording in which it was seen.", None)
    tied: Names = doc("Effects that its recording was as likely with in its place.", tuple)

    def meanings(self, at: Located, scope: Scope) -> dict[str, Any]:
        own = super().meanings(at, scope)
        with at.at("name").locating_errors():
            known = form(self.name)
        names, options = [p.name for p in known.parameters], known.options()
        for k, other in enumerate(self.tied):
            with at.at("tied", k).locating_errors():
                form(other)
        values = at.at("parameters").in_order(options | self.parameters, names, "parameter")
        stds = dict.fromkeys(options, 0.0) | self.std
        std = at.at("std").in_order(stds, names, "parameter") if self.std else ()
        return own | {"parameters": tuple(zip(names, values, strict=True)), "std": std}

    @classmethod
    def written(cls, value: Effect, scope: Scope) -> Mapping[str, Any]:
        kept = form(value.name).stated(value.parameters)
        std = dict(zip([name for name, _ in value.parameters], value.std, strict=True)) if value.std else {}
        given = [pair for pair in value.parameters if pair[0] in kept]
        return {**vars(value), "parameters": given, "std": {name: std[name] for name in kept if std}}


class ModelDocument(Document):
    """The hybrid automaton of an articulated object."""

    # What people look for comes first: how parts move, and when that changes.
    format: Literal["micah-plan/model/1"] = doc("Format and version of this file.")
    coordinates: Annotated[dict[Name, Unit], Field(min_length=1), _COORDINATES] = doc(
        "The continuous states and their units (rad or m), in order."
    )
    inputs: Annotated[dict[Name, Unit], Field(min_length=1), _COORDINATES] = doc(
        "The inputs (displacements per step) and their units, in order."
    )
    links: list[LinkDocument] = doc("Which coordinate moves which part, parents first.")
    modes: Annotated[dict[Name, ModeDocument], Field(min_length=1), BY_NAME] = doc("The discrete states.")
    transitions: list[TransitionDocument] = doc(
        "Edges between modes; of several whose guards hold at once the first listed is taken."
    )
    init: list[InitialDocument] = doc("Initial states; empty: all invariants.", list)
    effects: list[EffectDocument] = doc(
        "What calibration added. Those on guards and joints are already in modes and transitions; the others act in "
        "every step.",
        list,
    )
    noise: NoiseDocument = doc("Process and observation noise.")
    parts: Annotated[dict[PartName, PartDocument], BY_NAME] = doc("Shapes and handles of the parts.", dict)
    provenance: dict[Name, Line] = doc("Where the model came from: recording digest, method, seed, versions.", dict)
    learned: list[LearnedEdgeDocument] = doc("How certain learning was, by edge of the kinematic graph.", list)
    covariances: dict[ModeName, dict[Name, CovarianceDocument]] = doc(
        "Covariances of the joints' parameters, if estimated, by mode and child part.", dict
    )

    def check(self, at: Located) -> None:
        entries = len(self.coordinates) ** 2 * (len(self.modes) + len(self.transitions))
        if entries > MOST_ENTRIES:
            problem = f"its matrices have {entries} entries, more than {MOST_ENTRIES}"
            raise at.error(problem, "use fewer coordinates, modes or transitions")
        _check_tree(self.links, at.at("links"))

    def read(self, at: Located, scope: Scope) -> HybridAutomaton:
        parts = dict.fromkeys([BASE, *(name for link in self.links for name in (link.parent, link.child))])
        scope = {
            "coordinate": tuple(self.coordinates),
            "input": tuple(self.inputs),
            "mode": tuple(self.modes),
            "part": tuple(parts),
            "linked part": tuple(link.child for link in self.links),
        }
        values = self.meanings(at, scope)
        edges = values.pop("transitions")
        values["modes"] = tuple(
            self._with_covariances(mode, values["covariances"], at, scope) for mode in values["modes"]
        )
        del values["covariances"]
        links = [(link.parent, link.child) for link in self.links]
        for i, edge in enumerate(self.learned):
            if (edge.parent, edge.child) not in links:
                names = ", ".join(f"{parent} to {child}" for parent, child in links) or "none"
                problem = f"no link leads from {shown(edge.parent)} to {shown(edge.child)}"
                raise at.at("learned", i).error(problem, f"links: {names}")
        values["effects"] = (*values["effects"], *self._drifts(values["effects"], at, scope))
        return HybridAutomaton(**values, edges=edges)

    def _drifts(self, effects: Sequence[Effect], at: Located, scope: Scope) -> Iterator[Effect]:
        """The constants of steps as `bias` effects."""
        for name, mode in self.modes.items():
            place = at.at("modes", name)
            for coordinate, drift in mode.drifts(place, scope).items():
                for effect in effects:
                    if effect.name == "bias" and effect.coordinate == coordinate and effect.acts_in(name):
                        problem = f"'{coordinate}' has a constant here and a bias under `effects`"
                        raise place.at("step", coordinate).error(problem, "keep one of them")
                yield Effect("bias", coordinate, (("bias", drift),), modes=(name,))

    def _with_covariances(
        self, mode: Mode, covariances: Mapping[str, Mapping[str, ParameterCovariance]], at: Located, scope: Scope
    ) -> Mode:
        """The mode with covariances of its joints, which older files store at the joints."""
        of_mode, joints = covariances.get(mode.name, {}), list(mode.joints)
        for part, covariance in of_mode.items():
            place = at.at("covariances", mode.name, part)
            number = place.number(part, scope["linked part"], "linked part")
            if joints[number].covariance is not None:
                raise place.error("its joint has a covariance already", "keep one of them")
            joints[number] = replace(joints[number], covariance=covariance)
        return replace(mode, joints=tuple(joints)) if of_mode else mode

    @classmethod
    def written(cls, value: HybridAutomaton, scope: Scope) -> Mapping[str, Any]:
        bare, covariances = [], dict[str, dict[str, ParameterCovariance]]()
        for mode in value.modes:
            bare.append(replace(mode, joints=tuple(replace(joint, covariance=None) for joint in mode.joints)))
            named = zip(scope["linked part"], mode.joints, strict=False)
            by_part = {part: joint.covariance for part, joint in named if joint.covariance is not None}
            covariances |= {mode.name: by_part} if by_part else {}
        return {
            **vars(value), "format": MODEL_FORMAT, "transitions": value.edges, "modes": bare,
            "covariances": covariances,
        }  # fmt: skip


def load_model(path: str | Path) -> HybridAutomaton:
    """The automaton that a model file holds.

    Raises:
        InputError: if it cannot be used; one line with file, line, key, expected and found content, and the remedy.
    """
    return usable_model(read_bytes(path, LARGEST_TEXT_BYTES), str(path))


def dump_model(automaton: HybridAutomaton, path: str | Path) -> None:
    """Write a model file, at once or not at all.

    Raises:
        InputError: if the automaton is not one that a file may hold, or the file cannot be written.
    """
    replace_file(path, model_text(automaton).encode())


def usable_model(content: bytes, source: str) -> HybridAutomaton:
    """The automaton of a model file's content, validated for the algorithms.

    Args:
        source: names the file in messages.

    Raises:
        InputError: also for what `automaton.check` refuses, with the place in the file.
    """
    return _usable(read_yaml(content, source))


def model_of(data: Mapping[str, Any]) -> HybridAutomaton:
    """The automaton of data with the keys of a model file, validated for the algorithms.

    Args:
        data: dicts, lists, texts and numbers; `format` may be left out.

    Raises:
        InputError: with the key, the expected and the found content, and the remedy.
    """
    return _usable(Located({"format": MODEL_FORMAT, **data}, "model"))


def _usable(located: Located) -> HybridAutomaton:
    automaton = automaton_of_document(located)
    for place, check in checks(automaton):
        with located.at(*(("transitions", *place[1:]) if place[:1] == ("edges",) else place)).locating_errors():
            check()
    return automaton


def model_text(automaton: HybridAutomaton) -> str:
    """The text of a model file that reads back as exactly this automaton.

    Raises:
        InputError: if the automaton is not one that a file may hold.
    """
    return write_yaml(model_data(automaton), _HEADER, _remarks(automaton))


def automaton_of_document(located: Located) -> HybridAutomaton:
    """The automaton of a model file's data.

    Raises:
        InputError: if the layout is another, or names, sizes or values do not agree with each other.
    """
    automaton: HybridAutomaton = validated(located, ModelDocument).read(located, {})
    return automaton


def model_data(automaton: HybridAutomaton) -> dict[str, Any]:
    """Plain data of a model file that `automaton_of_document` reads back unchanged.

    Raises:
        InputError: if the automaton is not one that a file may hold (a name twice, a number that is not finite, sizes
            that disagree).
    """
    data = plain_data(ModelDocument, automaton, scope_of(automaton))
    if automaton_of_document(Located(data, "automaton")) != automaton:
        problem = "automaton: sizes of its parts do not agree, so it cannot be written"
        raise InputError(problem, remedy="check its values")
    return data


def scope_of(automaton: HybridAutomaton) -> Scope:
    """The names that a model's file and its problems may refer to."""
    children = tuple(link.child for link in automaton.links)
    names = {"coordinate": automaton.coordinate_names, "input": automaton.input_names, "mode": automaton.mode_names}
    return {**names, "part": children, "linked part": children}


def _remarks(automaton: HybridAutomaton) -> dict[KeyPath, str]:
    """Comments by key path: standard deviations of estimates, and certainties of learning."""
    remarks: dict[KeyPath, str] = {}
    for i, edge in enumerate(automaton.learned):
        remarks |= {("learned", i, *path): remark for path, remark in learned_remarks(edge).items()}
    for mode in automaton.modes:
        for link, joint in zip(automaton.links, mode.joints, strict=True):
            remark = joint_remark(joint)
            if remark is not None:
                remarks["covariances", mode.name, link.child, "names"] = remark
    return remarks


def _check_tree(links: Sequence[LinkDocument], at: Located) -> None:
    children = [link.child for link in links]
    for i, link in enumerate(links):
        if link.child == link.parent:
            raise at.at(i, "child").error("a part moves itself", "links form a tree")
        if link.child in children[:i]:
            raise at.at(i, "child").error(f"part '{link.child}' has two parents", "links form a tree")
        if link.parent in children[i:]:
            raise at.at(i, "parent").error(f"parent '{link.parent}' is linked only later", "list parents first")
