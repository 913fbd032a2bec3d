"""The sheet of tags that `micah-plan new tags` writes is true to size, and its tags are found as they are numbered."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from extras import module_requires

pytestmark = module_requires("vision")

from make_tag_sheet import NUMBERS, PLACE, SIZE_MM, sheet

from micah_plan.templates.write import write_template
from micah_plan.vision.corners import detector

PX_PER_MM = 8


def drawn(svg: str) -> np.ndarray:
    """The black rectangles of a sheet as a picture."""
    picture = np.full((297 * PX_PER_MM, 210 * PX_PER_MM), 255, np.uint8)
    left = top = 0.0
    for line in svg.splitlines():
        if (moved := re.search(r"translate\(([\d.]+) ([\d.]+)\)", line)) is not None:
            left, top = (float(value) for value in moved.groups())
        if (box := re.fullmatch(r'<rect x="([\d.]+)" y="([\d.]+)" width="([\d.]+)" height="([\d.]+)"/>', line)) is None:
            continue
        x, y, wide, high = (float(value) for value in box.groups())
        rows, columns = ((top + y, top + y + high), (left + x, left + x + wide))
        (first, last), (start, end) = ([round(v * PX_PER_MM) for v in pair] for pair in (rows, columns))
        picture[first:last, start:end] = 0
    return picture


def test_the_stored_sheet_is_what_the_script_makes(tmp_path) -> None:
    assert PLACE.read_text(encoding="utf-8") == sheet()
    written = write_template("tags", tmp_path / "tags")
    assert {Path(file).name for file in written} == {"tags.yaml", "tags.svg", "tags.schema.json"}


def test_its_tags_are_found_upright_and_in_their_stated_size() -> None:
    found = detector("tag36h11")(drawn(sheet()))
    assert sorted(found) == list(NUMBERS)
    for corners in found.values():
        sides = np.roll(corners, -1, axis=0) - corners
        np.testing.assert_allclose(np.linalg.norm(sides, axis=1), SIZE_MM * PX_PER_MM, atol=1.5)
        assert sides[0][0] > 0.0  # from the top left to the top right, as a person reads the sheet
        assert sides[1][1] > 0.0
