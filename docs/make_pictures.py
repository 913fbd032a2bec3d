"""Pictures of the docs that show commands and pages, made anew: `python docs/make_pictures.py [site]`.

With the folder of the built docs (`mkdocs build --site-dir site`) their start page is pictured too. Needs Chromium, and
the extra `browser` for the moving one.
"""

from __future__ import annotations

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from picture_of_page import take_picture
from picture_of_terminal import picture, run_session

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "docs" / "images"
COMMANDS = (
    "learn examples/demonstrations/microwave.csv -o {out}/microwave.yaml --figure {images}/microwave_segments.png",
    "solve problems/microwave_close.yaml -o {out}/microwave_close.json --html {out}/microwave_close.html",
    "solve problems/stapler_on_books.yaml -o {out}/stapler_on_books.json --html {out}/stapler_on_books.html",
    "show {out}/stapler_on_books.json --video {images}/stapler_on_books.webp --size 560x350 --fps 6 --speed 1.2",
    "learn examples/demonstrations/drawer.csv --parts models/parts/drawer.yaml -o {out}/drawer.yaml",
    "solve problems/drawer_open.yaml --model {out}/drawer.yaml -o {out}/plan.json",
    "execute {out}/plan.json --plant examples/worn_drawer.py:WornDrawer --trials 8 -o {out}/runs.csv",
    "calibrate {out}/drawer.yaml {out}/runs.csv -o {out}/first.yaml --experiment {out}/asked.yaml",
    "execute {out}/asked.yaml --plant examples/worn_drawer.py:WornDrawer -o {out}/reversed.csv",
    "calibrate {out}/drawer.yaml {out}/runs.csv {out}/reversed.csv -o {out}/better.yaml --html {out}/calibrated.html",
    "track examples/video/door.mp4 --tags examples/video/tags.yaml -o {out}/door.csv --html {out}/video.html",
)
PAGES = {"microwave_close": 0.6, "calibrated": 0.0, "stapler_on_books": 0.3, "video": 0.4}
"""Shares of the time at which the pages are pictured."""


def main(site: str | None = None) -> None:
    with tempfile.TemporaryDirectory() as place:
        out = Path(place)
        for command in COMMANDS:
            arguments = shlex.split(command.format(out=out, images=IMAGES))
            subprocess.run([sys.executable, "-m", "micah_plan", *arguments], cwd=ROOT, check=True)  # noqa: S603
        for name, share in PAGES.items():
            take_picture(out / f"{name}.html", IMAGES / f"{name}.png", share)
    with tempfile.TemporaryDirectory() as place:
        drawn = picture(run_session(Path(place)), "micah-plan")
        (IMAGES / "terminal.svg").write_text(drawn + "\n", encoding="utf-8")
    if site is not None:
        take_picture(Path(site) / "index.html", IMAGES / "docs.png", size=(1400, 900))


if __name__ == "__main__":
    main(*sys.argv[1:2])
