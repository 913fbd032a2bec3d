"""Writes the sheet of tags that `micah-plan new tags` copies: six AprilTags of 60 mm on A4, true to size.

    python docs/make_tag_sheet.py

Needs the extra `vision`; `tests/vision/test_tag_sheet.py` compares the file with what this makes.
"""

from __future__ import annotations

from pathlib import Path

from micah_plan.vision.corners import dictionary
from micah_plan.vision.opencv import opencv

PLACE = Path(__file__).resolve().parents[1] / "micah_plan" / "templates" / "tags.svg"
NUMBERS, SIZE_MM, CELLS = range(6), 60.0, 8
_LEFT, _TOP, _ACROSS, _DOWN = 25.0, 22.0, 100.0, 86.0


def sheet() -> str:
    """The SVG: black cells as rectangles, a dashed line to cut along, numbers, and 100 mm to check the print with."""
    cell, markers, lines = SIZE_MM / CELLS, dictionary("tag36h11"), []
    for number in NUMBERS:
        left, top = _LEFT + _ACROSS * (number % 2), _TOP + _DOWN * (number // 2)
        picture = opencv().aruco.generateImageMarker(markers, number, CELLS)
        lines.append(f'<g id="tag-{number}" transform="translate({left:g} {top:g})">')
        for row in range(CELLS):
            for start, end in _runs([int(value) < 128 for value in picture[row]]):
                at = f'x="{start * cell:g}" y="{row * cell:g}" width="{(end - start) * cell:g}" height="{cell:g}"'
                lines.append(f"<rect {at}/>")
        edge, side = -cell, SIZE_MM + 2 * cell
        lines.append(f'<rect class="cut" x="{edge:g}" y="{edge:g}" width="{side:g}" height="{side:g}"/>')
        lines.append(f'<text x="0" y="{SIZE_MM + 5:g}">tag36h11 {number} - {SIZE_MM:g} mm - this side down</text></g>')
    style = ".cut{fill:none;stroke:#999;stroke-width:0.2;stroke-dasharray:2 2}text{font:3.2px sans-serif;fill:#555}"
    ruler = '<path d="M55 283v3h100v-3" fill="none" stroke="#000" stroke-width="0.3"/>'
    words = '<text x="55" y="291">100 mm if printed true to size (scale 100 %)</text>'
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="210mm" height="297mm" viewBox="0 0 210 297">'
    return "\n".join([head, f"<style>{style}</style>", *lines, ruler, words, "</svg>"]) + "\n"


def _runs(is_black: list[bool]) -> list[tuple[int, int]]:
    """First and end of each stretch of black cells of a row."""
    edges = [k for k in range(len(is_black) + 1) if [False, *is_black][k] != [*is_black, False][k]]
    return list(zip(edges[::2], edges[1::2], strict=True))


if __name__ == "__main__":
    PLACE.write_text(sheet(), encoding="utf-8")
