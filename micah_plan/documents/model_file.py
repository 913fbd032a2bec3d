"""Model files (`models/*.yaml`): `load_model` and `dump_model`, each the exact inverse of the other."""

from __future__ import annotations

from pathlib import Path

from micah_plan.automaton.check import checks
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.documents.model_data import model_data, std_comments
from micah_plan.documents.model_document import ModelDocument
from micah_plan.documents.model_values import automaton_of
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml, write_yaml
from micah_plan.errors import InputError
from micah_plan.files import read_bytes, replace_file

_HEADER = """Motion model of an articulated object. Lengths in m, angles in rad, quaternions scalar last, poses in the
base frame. Half-spaces read `door >= 1.2`, `input door < -0.01` or `0.5*x + 2*z - input x > 0.1`; the state `door` is a
configuration, `input door` its commanded change per step. The order of modes and transitions matters."""


def load_model(path: str | Path) -> HybridAutomaton:
    """The automaton that a model file holds.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    return usable_model(read_bytes(path, LARGEST_TEXT_BYTES), str(path))


def usable_model(content: bytes, source: str) -> HybridAutomaton:
    """As `parse_model`, and what the file describes is also an automaton that the algorithms can use.

    Raises:
        InputError: also for what `automaton.check` refuses, with the place in the file.
    """
    located = read_yaml(content, source)
    automaton = automaton_of(validated(located, ModelDocument), located)
    for place, check in checks(automaton):
        try:
            check()
        except InputError as error:
            path = ("transitions", *place[1:]) if place[:1] == ("edges",) else place
            raise located.error(path, error.problem, error.remedy) from None
    return automaton


def parse_model(content: bytes, source: str) -> HybridAutomaton:
    """The automaton that the content of a model file describes, usable or not; `source` names the file in messages."""
    located = read_yaml(content, source)
    return automaton_of(validated(located, ModelDocument), located)


def model_text(automaton: HybridAutomaton) -> str:
    """The text of a model file that reads back as exactly this automaton.

    Raises:
        InputError: if the automaton is not one that a file may hold.
    """
    return write_yaml(model_data(automaton), _HEADER, std_comments(automaton))


def dump_model(automaton: HybridAutomaton, path: str | Path) -> None:
    """Write a model file, at once or not at all.

    Raises:
        InputError: if the automaton is not one that a file may hold, or the file cannot be written.
    """
    replace_file(path, model_text(automaton).encode())
