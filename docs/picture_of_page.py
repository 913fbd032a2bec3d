"""A picture of a page, as in docs/images: `python docs/picture_of_page.py page.html picture.png [share of the time]`.

Needs Chromium.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

_SETTLED_MS = 3000


def take_picture(page: Path, picture: Path, share: float = 0.5, size: tuple[int, int] = (1400, 850)) -> None:
    """Write a PNG of a page in a window of a size [px], a plan or model standing at a share of its time.

    Raises:
        CalledProcessError: if the browser fails.
    """
    with tempfile.TemporaryDirectory() as profile:
        subprocess.run(  # noqa: S603
            [  # noqa: S607
                "chromium", "--headless", "--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader",
                "--use-gl=angle", "--use-angle=swiftshader", "--no-first-run", "--disable-sync",
                "--disable-background-networking", "--hide-scrollbars",
                f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}",
                f"--virtual-time-budget={_SETTLED_MS}", f"--screenshot={picture.resolve()}",
                f"{page.resolve().as_uri()}#t={share}",
            ],
            check=True, capture_output=True, timeout=120,
        )  # fmt: skip


if __name__ == "__main__":
    take_picture(Path(sys.argv[1]), Path(sys.argv[2]), *map(float, sys.argv[3:4]))
