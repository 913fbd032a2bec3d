"""Files of parts (`models/parts/*.yaml`): shapes and handles that `learn` adds to a model."""

from __future__ import annotations

from pathlib import Path

from micah_plan.automaton.hybrid import Part
from micah_plan.documents.part_document import PartsDocument
from micah_plan.documents.part_values import parts_of
from micah_plan.documents.validation import validated
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml
from micah_plan.files import read_bytes


def load_parts(path: str | Path) -> tuple[Part, ...]:
    """The parts that a file describes.

    Raises:
        InputError: if it cannot be used; one line names file, line, key, what was expected and found, and the remedy.
    """
    located = read_yaml(read_bytes(path, LARGEST_TEXT_BYTES), str(path))
    return parts_of(validated(located, PartsDocument).parts, located)
