"""Pictures and videos of pages: what is refused before work, what a missing part says, what the files hold."""

from __future__ import annotations

import io
import shutil
import sys

import pytest
from extras import requires
from PIL import Image
from view_objects import problem, solved

from micah_plan.errors import InputError, MissingDependencyError
from micah_plan.view import video as filmed
from micah_plan.view.model_page import model_page
from micah_plan.view.page import bare_scene
from micah_plan.view.plan_page import plan_page
from micah_plan.view.video import Filming, picture, video


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"width": 641}, "even numbers of pixels"),
        ({"height": 10}, "64 x 64"),
        ({"rate": 0.0}, "0.5 to 120 frames per second"),
        ({"speed": 1000.0}, "a speed of 0.01 to 100"),
    ],
)
def test_a_size_or_rate_that_cannot_be_is_refused(changes: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Filming(**changes)  # type: ignore[arg-type]


def test_without_a_browser_its_library_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "playwright.sync_api", None)
    with pytest.raises(MissingDependencyError, match=r"a library that drives it: pip install 'playwright>="):
        picture("<html></html>")


def test_without_ffmpeg_an_mp4_is_refused_before_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(MissingDependencyError, match=r"needs ffmpeg, \.gif and \.webp do not; .*imageio-ffmpeg"):
        video("<html></html>", ".mp4")


@pytest.mark.parametrize("kind", [".gif", ".webp"])
def test_an_animation_has_every_frame_at_its_time(kind: str) -> None:
    frames = []
    for shade in (0, 90, 180):
        stream = io.BytesIO()
        Image.new("RGB", (64, 64), (shade, 255 - shade, 40)).save(stream, format="PNG")
        frames.append(stream.getvalue())
    shown = Image.open(io.BytesIO(filmed._animated(kind, frames, Filming(rate=10.0))))
    assert (shown.n_frames, shown.size) == (3, (64, 64))
    shown.seek(2)
    assert shown.convert("RGB").getpixel((30, 30))[0] > 150
    assert shown.info["duration"] in (100, (100,))


def test_the_scene_alone_has_the_commands_and_no_panels() -> None:
    page = plan_page(solved(), problem(), title="a <door> (open)")
    bare = bare_scene(page)
    assert "<title>a &lt;door&gt; (open) (scene)</title>" in bare
    assert '"commands":["' in bare
    assert 'id="panel"' not in bare
    with pytest.raises(InputError, match="no scene"):
        bare_scene("<html></html>")


@pytest.mark.evidence
@requires("browser")
def test_a_plan_is_filmed_and_photographed() -> None:
    if next(filter(None, map(shutil.which, filmed._BROWSERS)), None) is None:
        pytest.skip("no chromium found")
    page, small = plan_page(solved(), problem()), Filming(320, 240, rate=2.0, speed=4.0)
    shown = Image.open(io.BytesIO(video(page, ".gif", small)))
    assert shown.size == (320, 240)
    assert shown.n_frames == 6  # 10.8 s at 4 times the speed, two a second
    first, last = shown.convert("RGB").tobytes(), None
    shown.seek(5)
    last = shown.convert("RGB").tobytes()
    assert sum(a != b for a, b in zip(first, last, strict=True)) > 0.01 * len(first)
    still = Image.open(io.BytesIO(picture(page, 1.0, Filming(320, 240, view="object"))))
    assert still.size == (320, 240)
    with pytest.raises(InputError, match="frames are too many"):
        video(page, ".gif", Filming(rate=100.0, speed=0.01))
    assert picture(model_page(problem().automaton), 0.0, Filming(320, 240)).startswith(b"\x89PNG")
