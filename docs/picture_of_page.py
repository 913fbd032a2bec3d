"""A picture of a page, as in docs/images: `python docs/picture_of_page.py page.html picture.png [milliseconds]`.

Needs Chromium. The page is shown after so many milliseconds of its own clock, in which it plays.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

_WINDOW = "1400,850"


def take_picture(page: Path, picture: Path, milliseconds: int = 14000) -> None:
    """Write a PNG of a page.

    Raises:
        CalledProcessError: if the browser fails.
    """
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(  # noqa: S603
            [  # noqa: S607
                "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
                "--use-gl=angle", "--use-angle=swiftshader", "--no-first-run", "--disable-sync",
                "--disable-background-networking",
                f"--user-data-dir={profile}", f"--window-size={_WINDOW}", f"--virtual-time-budget={milliseconds}",
                f"--screenshot={picture.resolve()}", page.resolve().as_uri(),
            ],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip


if __name__ == "__main__":
    take_picture(Path(sys.argv[1]), Path(sys.argv[2]), *map(int, sys.argv[3:4]))
