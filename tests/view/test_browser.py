"""The pages in a real browser: they draw something, move it, and report no error."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from learned_objects import assessed_door
from matplotlib.image import imread
from view_objects import door, measured, problem, solved

from micah_plan.planning.plan import Plan
from micah_plan.view.page import model_page, plan_page, recording_page

BROWSER = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = [
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--hide-scrollbars",
    "--window-size=900,600",
    "--virtual-time-budget=1500",
    "--enable-logging=stderr",
]
PANEL_WIDTH, PLAYER_HEIGHT = 350, 96

pytestmark = pytest.mark.skipif(BROWSER is None, reason="no chromium found: install Debian's package 'chromium'")


def screenshot(folder: Path, page: str, fragment: str = "", flags: Sequence[str] = ()) -> np.ndarray:
    """The 3-D part of a page as the browser shows it, (h, w, 3) in 0..1; fails on any message in the console."""
    file, picture = folder / "page.html", folder / "shot.png"
    file.write_text(page, encoding="utf-8")
    command = [str(BROWSER), *FLAGS, *flags, f"--user-data-dir={folder / 'profile'}", f"--screenshot={picture}"]
    done = subprocess.run([*command, file.as_uri() + fragment], capture_output=True, text=True, timeout=120, check=True)
    messages = [line for line in done.stderr.splitlines() if "CONSOLE" in line and "GL Driver Message" not in line]
    assert not messages, "\n".join(messages)
    pixels = imread(picture)[..., :3]
    return np.asarray(pixels[: -PLAYER_HEIGHT - 4, PANEL_WIDTH + 4 :])


def share_of_object(pixels: np.ndarray) -> float:
    """Share of the pixels that differ clearly from the pale background gradient and grid."""
    return float((pixels.min(axis=-1) < 0.62).mean())


def test_the_plan_moves_under_the_slider_without_errors(tmp_path: Path) -> None:
    page = plan_page(solved(), problem())
    start, end = screenshot(tmp_path, page, "#t=0"), screenshot(tmp_path, page, "#t=1")
    assert 0.02 < share_of_object(start) < 0.6
    assert (np.abs(start - end).max(axis=-1) > 0.1).mean() > 0.01


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["no plan", "model", "recording"])
def test_the_other_pages_draw_without_errors(kind: str, tmp_path: Path) -> None:
    page = {
        "no plan": lambda: plan_page(Plan("no_plan", "no mode reaches the goal"), problem()),
        "model": lambda: model_page(door(shapes=False)),
        "recording": lambda: recording_page(*measured()),
    }[kind]()
    assert 0.003 < share_of_object(screenshot(tmp_path, page, "#t=0.5")) < 0.6


@pytest.mark.slow
def test_a_dark_page_is_dark_all_over(tmp_path: Path) -> None:
    page = recording_page(*assessed_door())
    light = screenshot(tmp_path, page, "#t=0.5")
    dark = screenshot(tmp_path, page, "#t=0.5", ["--blink-settings=preferredColorScheme=0"])
    assert np.median(light) > 0.8
    assert np.median(dark) < 0.25
    assert 0.003 < (dark.max(axis=-1) > 0.6).mean() < 0.3, "joints and track are light"


@pytest.mark.slow
def test_an_error_would_be_seen(tmp_path: Path) -> None:
    broken = re.sub(r'"use strict";', '"use strict"; throw new Error("made up");', plan_page(solved(), problem()))
    with pytest.raises(AssertionError, match="made up"):
        screenshot(tmp_path, broken)


@pytest.mark.slow
def test_the_page_may_not_connect_anywhere(tmp_path: Path) -> None:
    asking = plan_page(solved(), problem()).replace('"use strict";', '"use strict"; fetch("http://127.0.0.1:9/");')
    with pytest.raises(AssertionError, match="Content Security Policy"):
        screenshot(tmp_path, asking)
