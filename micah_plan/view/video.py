"""Pictures and videos of a page, captured frame by frame in a headless browser.

The browser is Chromium, driven by Playwright (extra `browser`). GIF, WebP and PNG need nothing else; MP4 needs the
program ffmpeg, of the system or of the package imageio-ffmpeg (extra `video`).
"""

from __future__ import annotations

import io
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.errors import InputError, MicahError, MissingDependencyError
from micah_plan.summaries import Progress

if TYPE_CHECKING:
    from playwright.sync_api import Page


VIDEO = (".mp4", ".gif", ".webp")
PICTURE = (".png",)
_BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
_FLAGS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic", "--hide-scrollbars")
_TIMEOUT_MS = 60_000
_MOST_FRAMES = 3000
_COLORS = 128


@dataclass(frozen=True)
class Filming:
    """How a page is filmed.

    Attributes:
        width, height: of the picture [px], even numbers.
        rate: frames per second.
        speed: of the player; 2 is twice as fast.
        view: of the page's views (whole, motion, object, front, side, top); empty: as the page opens.
    """

    width: int = 1280
    height: int = 720
    rate: float = 15.0
    speed: float = 1.0
    view: str = ""

    def __post_init__(self) -> None:
        if not (64 <= self.width <= 7680 and 64 <= self.height <= 4320) or self.width % 2 or self.height % 2:
            raise InputError(
                f"the size must be even numbers of pixels from 64 x 64 to 7680 x 4320. Got {self.width} x {self.height}"
            )
        if not (0.5 <= self.rate <= 120 and 0.01 <= self.speed <= 100):
            raise InputError(
                f"expected 0.5 to 120 frames per second, a speed of 0.01 to 100. Got {self.rate:g} and {self.speed:g}"
            )

    @property
    def fragment(self) -> str:
        """Of the page's address: still at the start, without panels."""
        return "#t=0&stage" + (f"&view={self.view}" if self.view else "")


def picture(page: str, share: float = 0.5, filming: Filming | None = None) -> bytes:
    """A PNG of the page's scene at a share of its time.

    Raises:
        MissingDependencyError: without a browser.
        MicahError: if the browser fails.
    """
    with _opened(page, filming or Filming()) as browser:
        browser.evaluate("share => window.player && player.show(share * player.duration)", share)
        return browser.screenshot()


def video(page: str, kind: str, filming: Filming | None = None, progress: Progress | None = None) -> bytes:
    """The page's animation from its beginning to its end.

    Args:
        page: HTML text of a page with a player.
        kind: ``".mp4"``, ``".gif"`` or ``".webp"``.
        filming: size, rate and speed.
        progress: called with a message and the fraction done.

    Raises:
        InputError: if nothing moves on the page, or it is too long.
        MissingDependencyError: without a browser, or for MP4 without ffmpeg.
        MicahError: if the browser or ffmpeg fails.
    """
    chosen = filming or Filming()
    encode = _mp4 if kind == ".mp4" else _animated
    if kind == ".mp4":
        _ffmpeg()  # before the work
    return encode(kind, list(_frames(page, chosen, progress or (lambda *_: None))), chosen)


def _frames(page: str, filming: Filming, progress: Progress) -> Iterator[bytes]:
    """PNGs of every frame."""
    with _opened(page, filming) as browser:
        duration = float(browser.evaluate("() => window.player ? player.duration : 0"))
        if duration <= 0:
            raise InputError("nothing moves on this page", remedy="take a picture instead")
        count = round(duration / filming.speed * filming.rate) + 1
        if count > _MOST_FRAMES:
            raise InputError(f"{count} frames are too many", remedy="choose fewer per second, or a higher speed")
        for k in range(count):
            browser.evaluate("time => player.show(time)", min(k * filming.speed / filming.rate, duration))
            progress(f"frame {k + 1} of {count}", k / count)
            yield browser.screenshot()


@contextmanager
def _opened(page: str, filming: Filming) -> Iterator[Page]:
    """The page in a browser, drawn."""
    try:
        from playwright.sync_api import Error, sync_playwright
    except ImportError:
        problem = "pictures and videos of pages need chromium, and a library that drives it"
        raise MissingDependencyError.of("browser", problem) from None
    program = next(filter(None, map(shutil.which, _BROWSERS)), None)
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as started:
        file = Path(folder) / "page.html"
        file.write_text(page, encoding="utf-8")
        try:
            chromium = started.chromium.launch(executable_path=program, chromium_sandbox=False, args=list(_FLAGS))
        except Error:
            raise MissingDependencyError(
                "no browser was found: install Debian's package chromium, or run 'playwright install chromium'"
            ) from None
        try:
            tab = chromium.new_page(viewport={"width": filming.width, "height": filming.height})
            tab.goto(file.as_uri() + filming.fragment)
            tab.wait_for_selector("body.ready", timeout=_TIMEOUT_MS)
            yield tab
        except Error as error:
            message = " ".join(str(error).split())[:200]
            raise MicahError(f"the browser could not draw the page: {message}") from None
        finally:
            chromium.close()


def _animated(kind: str, frames: list[bytes], filming: Filming) -> bytes:
    """A GIF or WebP that repeats; its frames share one palette, so that still parts do not flicker."""
    from PIL import Image

    images = [Image.open(io.BytesIO(frame)).convert("RGB") for frame in frames]
    if kind == ".gif":
        images_used = [images[0], images[len(images) // 2], images[-1]]
        side_by_side = Image.new("RGB", (3 * images_used[0].width, images_used[0].height))
        for number, image in enumerate(images_used):
            side_by_side.paste(image, (number * image.width, 0))
        palette = side_by_side.quantize(_COLORS)
        images = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    stream, rest = io.BytesIO(), images[1:]
    options = {"save_all": True, "append_images": rest, "duration": round(1000 / filming.rate), "loop": 0}
    images[0].save(stream, format=kind[1:].upper(), **options)
    return stream.getvalue()


def _mp4(_: str, frames: list[bytes], filming: Filming) -> bytes:
    """H.264 in MP4, which every player and slide program shows."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "video.mp4"
        command = [_ffmpeg(), "-loglevel", "error", "-f", "image2pipe", "-framerate", f"{filming.rate:g}", "-i", "-"]
        command += ["-c:v", "libx264", "-pix_fmt", "yuv420p", "-movflags", "+faststart", str(target)]
        done = subprocess.run(command, input=b"".join(frames), capture_output=True, check=False)  # noqa: S603
        if done.returncode:
            message = " ".join(done.stderr.decode(errors="replace").split())[:200]
            raise MicahError(f"ffmpeg could not write the video: {message}")
        return target.read_bytes()


def _ffmpeg() -> str:
    program = shutil.which("ffmpeg")
    if program is not None:
        return program
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError:
        problem = "MP4 needs ffmpeg, .gif and .webp do not; install it, or a library that brings it"
        raise MissingDependencyError.of("video", problem) from None
    return str(get_ffmpeg_exe())
