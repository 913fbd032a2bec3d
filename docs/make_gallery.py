"""The gallery of shipped problems, made anew: `python docs/make_gallery.py [NAME ...]`.

Each problem is solved, its page is photographed, and `docs/gallery.md` says what the problem asks (the first comment of
its file) and what came out. With names only those are solved, and the page keeps what it says of the others. Needs
Chromium, and the extra `browser`.
"""

from __future__ import annotations

import io
import re
import sys
from pathlib import Path

from PIL import Image

from micah_plan import solve
from micah_plan.quantities import percent
from micah_plan.view.video import Filming, picture

ROOT = Path(__file__).resolve().parents[1]
PAGE, IMAGES = ROOT / "docs" / "gallery.md", ROOT / "docs" / "images" / "gallery"
SHARES = {"stapler_on_books": 0.4, "walled_domain": 1.0, "light_dark": 1.0}
"""Shares of the time at which the pages are photographed; others: in the middle."""
LEFT_OUT = ("explore_handle",)
"""Scenes for `explore`, which nobody plans in."""
_SIZE, _QUALITY = (720, 450), 80
_INTRODUCTION = """# Gallery

The problems that come with micah_plan, each with a picture of its page and with what `micah-plan solve` says with
seed 0. `python docs/make_gallery.py` makes this page anew.
"""


def names() -> list[str]:
    """Of all problems of the gallery, in its order."""
    return [path.stem for path in sorted((ROOT / "problems").glob("*.yaml")) if path.stem not in LEFT_OUT]


def task(name: str) -> str:
    """What a problem asks: the first comment of its file."""
    lines = (ROOT / "problems" / f"{name}.yaml").read_text(encoding="utf-8").splitlines()
    comment = []
    for line in lines:
        if not line.startswith("#") or line == "#":
            break
        comment.append(line.removeprefix("#").strip())
    return " ".join(comment)


def entry(name: str) -> str:
    """What the gallery says of a problem, which is solved and photographed."""
    result = solve(ROOT / "problems" / f"{name}.yaml")
    photograph = picture(result.page(), SHARES.get(name, 0.5), Filming(*_SIZE))
    with Image.open(io.BytesIO(photograph)) as image:
        image.save(IMAGES / f"{name}.webp", quality=_QUALITY, method=6)
    said = result.reason
    if result.plan.success_probability is not None and result.success:
        modes = " → ".join(result.plan.mode_sequence)
        trials = f"{result.plan.verification_trials:,} roll-outs"
        said = f"{modes}: {percent(result.plan.success_probability, 1)} of {trials}"
    title = name.replace("_", " ").capitalize()
    return f"## {title}\n\n![The page of the problem {name}](images/gallery/{name}.webp)\n\n{task(name)}\n\n*{said}*\n"


def main(chosen: list[str]) -> None:
    IMAGES.mkdir(exist_ok=True)
    before = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    kept = {
        match[1]: match[0]
        for match in re.finditer(r"## [^\n]+\n\n!\[The page of the problem (\w+)\].*?\*\n", before, re.S)
    }
    entries = [entry(name) if name in chosen or name not in kept else kept[name] for name in names()]
    PAGE.write_text("\n".join([_INTRODUCTION, *entries]), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] or names())
