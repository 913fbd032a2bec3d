"""Files of parts: shapes and handles for a learned model."""

from __future__ import annotations

from pathlib import Path

import pytest
from attempts import told

from micah_plan.automaton.hybrid import Part, Primitive
from micah_plan.documents.parts import load_parts

TEXT = """\
format: micah-plan/parts/1
parts:
  base:
    shapes:
      - {kind: cylinder, size: [0.02, 0.3], color: '#102030'}
  door:
    handle: [0.0, 0.05, 0.0]
"""


def test_parts_are_what_the_file_says(tmp_path: Path) -> None:
    (tmp_path / "parts.yaml").write_text(TEXT)
    base = Part("base", (Primitive("cylinder", (0.02, 0.3), color="#102030"),))
    assert load_parts(tmp_path / "parts.yaml") == (base, Part("door", (), (0.0, 0.05, 0.0)))


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (
            "size: [0.02, 0.3]",
            "size: [0.02]",
            "line 5, column 26, key 'parts.base.shapes.0.size': expected 2 sizes of a cylinder",
        ),
        ("color", "quaternion: [0, 0, 0, 2], color", "expected unit length, found length 2; normalise it"),
        ("handle", "handel", "line 7, column 5, key 'parts.door.handel': unknown key 'handel'; did you mean 'handle'?"),
        ("parts/1", "model/1", "expected a parts file, found a model file; give a parts file"),
    ],
)
def test_a_mistake_is_one_line(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert old in TEXT
    (tmp_path / "parts.yaml").write_text(TEXT.replace(old, new, 1))
    assert expected in told(load_parts, tmp_path / "parts.yaml")
