"""The pages in a real browser: they draw something, the player moves it, and nothing is reported as an error."""

from __future__ import annotations

import io
import json
import re
import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from extras import requires
from learned_objects import assessed_door
from matplotlib.image import imread
from view_objects import OPEN_AT, cabinet, door, measured, problem, solved

from micah_plan import execute, solve
from micah_plan.documents.problem import load_problem
from micah_plan.residual.calibrate import calibrate
from micah_plan.task.plan import Plan
from micah_plan.view.calibration_page import calibration_page
from micah_plan.view.live import PageServer
from micah_plan.view.model_page import model_page
from micah_plan.view.plan_page import plan_page
from micah_plan.view.recording_page import recording_page

if TYPE_CHECKING:
    from playwright.sync_api import Browser, Page

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
FLAGS = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-quic"]
WINDOW = {"width": 900, "height": 600}
EXPECTED = "GL Driver Message"  # the software renderer's remark on screenshots

NO_BROWSER = "no chromium found: install Debian's package 'chromium'"
pytestmark = [requires("browser"), pytest.mark.skipif(CHROMIUM is None, reason=NO_BROWSER)]


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    from playwright.sync_api import sync_playwright

    with sync_playwright() as started:
        chromium = started.chromium.launch(executable_path=CHROMIUM, chromium_sandbox=False, args=FLAGS)
        yield chromium
        chromium.close()


class Shown:
    """A page in the browser, and what its console said."""

    def __init__(self, page: Page, messages: list[str]) -> None:
        self.page, self.messages = page, messages

    def pixels(self, part: str = "#view") -> np.ndarray:
        """The 3-D part as it looks, or another, (h, w, 3) in 0..1."""
        return np.asarray(imread(io.BytesIO(self.page.locator(part).first.screenshot()))[..., :3])

    def time(self) -> float:
        """Where the slider stands, as a share of the whole."""
        return float(self.page.evaluate("(s => s.value / s.max)(document.getElementById('time'))"))

    def drag_to(self, share: float) -> None:
        """Put the slider somewhere as a hand does."""
        box = self.page.locator("#time").bounding_box()
        assert box is not None
        self.page.mouse.click(box["x"] + 8 + share * (box["width"] - 16), box["y"] + box["height"] / 2)

    def node(self, *path: str) -> Any:
        """Place, scale and visibility of the node at a path of the scene; a path entry may be its beginning."""
        return self.page.evaluate(
            """path => {
              let node = viewer.scene_tree.find(["meshcat"]);
              for (const start of path) {
                const name = Object.keys(node.children).find(child => child.startsWith(start));
                if (name === undefined) return null;
                node = node.children[name];
              }
              const o = node.object;
              return { place: o.position.toArray(), scale: o.scale.toArray(), visible: o.visible };
            }""",
            list(path),
        )


@pytest.fixture
def show(browser: Browser, tmp_path: Path) -> Iterator[Any]:
    """Opens the text of a page; all messages of its console are errors at the end, unless the test clears them."""
    opened: list[Shown] = []

    def open_page(text: str, fragment: str = "#t=0", *, scheme: Any = "light", size: Any = None) -> Shown:
        file = tmp_path / f"page{len(opened)}.html"
        file.write_text(text, encoding="utf-8")
        page = browser.new_page(viewport=size or WINDOW, color_scheme=scheme)
        messages: list[str] = []
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(file.as_uri() + fragment)
        opened.append(Shown(page, messages))
        if '"page-data"' in text and "made up" not in text:
            page.wait_for_selector("body.ready")
        return opened[-1]

    yield open_page
    for shown in opened:
        shown.page.close()
        assert [message for message in shown.messages if EXPECTED not in message] == []


def share_of_object(pixels: np.ndarray) -> float:
    """Share of the pixels that differ clearly from the pale background gradient and grid."""
    return float((pixels.min(axis=-1) < 0.62).mean())


def test_the_slider_moves_the_object_to_where_the_plan_says(show: Any) -> None:
    shown = show(plan_page(solved(), problem()))
    start = shown.pixels()
    assert 0.02 < share_of_object(start) < 0.6
    for share, configuration in ((0.0, 0.1), (0.99, OPEN_AT)):
        shown.drag_to(share)
        assert shown.time() == pytest.approx(share, abs=0.02)
        place = shown.node("object", "0_door")["place"]
        at = [0.3 * np.cos(configuration), -0.3 * np.sin(configuration), 0.1]
        np.testing.assert_allclose(place, at, atol=0.01)
    assert (np.abs(start - shown.pixels()).max(axis=-1) > 0.1).mean() > 0.01


@pytest.mark.slow
def test_what_plays_is_filled(show: Any) -> None:
    """The chip of a plan's mode, and the box of a model's, one at a time."""
    shown, filled = show(plan_page(solved(), problem())), ".chips .now"
    chips = shown.page.locator(".chips li").all_inner_texts()
    assert len(chips) > 1
    colors = []
    for share, chip in ((0.0, chips[0]), (0.99, chips[-1]), (0.0, chips[0])):
        shown.drag_to(share)
        assert shown.page.locator(filled).all_inner_texts() == [chip]
        colors.append(
            shown.page.evaluate(
                """() => {
                  let color = null;
                  viewer.scene_tree.find(["meshcat", "object"]).children["0_door"].object.traverse((o) => {
                    if (o.material) color = o.material.color.getHexString();
                  });
                  return color;
                }"""
            )
        )
    assert colors[0] == colors[2] != colors[1]  # a share of the mode's colour
    model = show(model_page(door()))
    names = list(door().mode_names)
    for share, name in ((0.01, names[0]), (0.99, names[-1])):
        model.drag_to(share)
        boxes = model.page.locator(".diagram .now")
        assert [box.get_attribute("data-mode") for box in boxes.all()] == [name]


@pytest.mark.slow
def test_keys_and_the_button_play_and_step(show: Any) -> None:
    shown = show(plan_page(solved(), problem()), "#t=0.5")
    page = shown.page
    page.keyboard.press("ArrowRight")
    assert shown.time() == pytest.approx(0.5 + 1 / 60)
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("ArrowLeft")
    assert shown.time() == pytest.approx(0.5 - 1 / 60)
    page.keyboard.press("End")
    assert shown.time() == 1.0
    assert "mode stopped" in page.inner_text("#readout")
    page.keyboard.press("Home")
    assert shown.time() == 0.0
    for toggle in (lambda: page.keyboard.press("Space"), lambda: page.click("#play")):
        before = shown.time()
        toggle()
        page.wait_for_function("from => document.getElementById('time').value > from + 0.2", arg=before * 10.82)
        toggle()
        paused = shown.time()
        page.wait_for_timeout(300)
        assert before < shown.time() == paused
    assert page.locator("#keys").bounding_box()["y"] < WINDOW["height"] - 10, "the keys are told on the page"


@pytest.mark.slow
def test_slider_and_charts_follow_each_other(show: Any) -> None:
    shown = show(plan_page(solved(), problem()), size={"width": 1400, "height": 850})
    places = []
    for share in (0.1, 0.5):
        shown.drag_to(share)
        places.append(shown.page.locator("#charts .at").first.bounding_box()["x"])
    assert places[1] - places[0] > 100
    box = shown.page.locator("#charts .u-over").first.bounding_box()
    shown.page.mouse.click(box["x"] + 0.75 * box["width"], box["y"] + 40)
    assert shown.time() == pytest.approx(0.75 * 10.02 / 10.82, abs=0.01)
    shown.page.mouse.click(box["x"] + 1, box["y"] + 40)
    assert shown.time() < 0.01


@pytest.mark.slow
def test_a_chart_is_zoomed_by_dragging_and_whole_again_by_pressing_twice(show: Any) -> None:
    shown = show(plan_page(solved(), problem()), "#t=0.1", size={"width": 1400, "height": 850})
    page = shown.page
    ends = "() => charts[0].panels.map(({ u }) => [u.scales.x.min, u.scales.x.max])"
    whole, before = page.evaluate(ends), shown.time()
    assert whole == [[0, 20], [0, 20]]
    box = page.locator("#charts .u-over").first.bounding_box()
    page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 40)
    page.mouse.down()
    page.mouse.move(box["x"] + 0.625 * box["width"], box["y"] + 50, steps=5)
    page.mouse.up()
    for low, high in page.evaluate(ends):
        assert (low, high) == pytest.approx((10.0, 12.5), abs=0.3), "all panels go along"
    assert shown.time() == before, "the player stays"
    ticks = page.evaluate("() => charts[0].panels.at(-1).u.axes[0]._splits")
    assert len(ticks) >= 2
    assert all(float(tick).is_integer() for tick in ticks), "there are no half steps"
    assert not page.locator("#charts .at").first.is_visible(), "and its line is out of sight"
    page.locator("#charts .u-over").first.dblclick()
    assert page.evaluate(ends) == whole


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["light", pytest.param("dark", marks=pytest.mark.evidence)])
def test_marks_are_drawn_in_their_colours_on_light_and_dark_pages(show: Any, scheme: str) -> None:
    shown = show(plan_page(solved(), problem()), size={"width": 1400, "height": 850}, scheme=scheme)
    (low, high) = (np.array(color) / 255 for color in ((0, 80, 140), (60, 160, 230)))
    for now in (scheme, "dark" if scheme == "light" else "light"):  # as the page was opened, and changed while it is
        shown.page.emulate_media(color_scheme=now)
        shown.page.wait_for_timeout(100)
        taken = shown.pixels("#charts canvas")
        assert (((taken > low) & (taken < high)).all(axis=-1)).sum() > 100, "the mean in blue"
        assert (taken.mean() > 0.6) == (now == "light")
        ink = (taken.mean(axis=-1) < 0.3) if now == "light" else (taken.mean(axis=-1) > 0.8)
        assert ink.sum() > 20, "words and guards in ink"


@pytest.mark.evidence
def test_views_follow_the_object_and_panels_fold(show: Any) -> None:
    shown = show(plan_page(solved(), problem()), size={"width": 1400, "height": 850})
    page = shown.page
    target = "() => viewer.controls.target.toArray()"
    whole, width = page.evaluate(target), page.locator("#view").bounding_box()["width"]
    page.keyboard.press("o")
    close = page.evaluate(target)
    shown.drag_to(0.9)
    assert np.linalg.norm(np.subtract(page.evaluate(target), close)) > 0.1, "the camera goes along"
    for name in ("front", "side", "top", "motion"):
        page.click(f"#tools [data-view={name}]")
        assert page.get_attribute(f"#tools [data-view={name}]", "aria-pressed") == "true"
        assert 0.005 < share_of_object(shown.pixels()) < 0.9, name
    page.keyboard.press("w")
    assert page.evaluate(target) == pytest.approx(whole)
    page.keyboard.press("p")
    assert not page.locator("#panel").is_visible()
    assert page.locator("#view").bounding_box()["width"] > 1.5 * width
    page.keyboard.press("p")
    assert page.locator("#panel").is_visible()


@pytest.mark.evidence
def test_the_player_can_be_slow(show: Any) -> None:
    shown = show(plan_page(solved(), problem()))
    shown.page.select_option("#speed", "0.25")
    shown.page.click("#play")
    shown.page.wait_for_timeout(1200)
    shown.page.click("#play")
    assert 0.0 < shown.time() < 0.6 * 1.2 / 10.8 + 0.02
    assert shown.page.inner_text("#clock").endswith("of 10.8 s")


@pytest.mark.slow
def test_runs_are_chosen_one_by_one_or_together(show: Any, repository: Path) -> None:
    planned = solve(repository / "problems" / "microwave_close.yaml")
    shown = show(execute(planned, trials=3).page(), "#t=0.5", size={"width": 1400, "height": 850})
    page = shown.page

    def visible() -> list[bool]:
        return [shown.node("runs", f"{order}_run")["visible"] for order in range(3)]

    assert visible() == [True, False, False]
    assert page.inner_text("#run-words").strip()
    assert "run 0 after" in page.inner_text("#readout") or "run" in page.inner_text("#readout")
    page.keyboard.press("r")
    assert visible() == [False, True, False]
    drawn = [run["drawn"] for run in json.loads(page.inner_text("#page-data"))["runs"]]
    assert page.evaluate("() => charts.map((chart) => chart.chosen)") == [drawn[1]]
    page.select_option("#run", "all")
    assert visible() == [True, True, True]
    assert page.evaluate("() => charts.map((chart) => chart.chosen)") == [None]


@pytest.mark.slow
def test_the_ellipsoid_can_be_hidden_by_its_box_and_by_its_key(show: Any) -> None:
    shown = show(plan_page(solved(), problem()))
    seen = shown.pixels()
    assert max(shown.node("belief", "0_door")["scale"]) == pytest.approx(1.96 * 0.08 * np.hypot(0.3, 0.03), rel=1e-3)
    assert "95\N{NO-BREAK SPACE}% ellipsoid" in shown.page.inner_text(".legend")
    shown.page.keyboard.press("b")
    assert not shown.node("belief")["visible"]
    assert not shown.page.is_checked("input[data-layer=belief]")
    assert (np.abs(seen - shown.pixels()).max(axis=-1) > 0.05).mean() > 0.001
    shown.page.check("input[data-layer=belief]")
    assert shown.node("belief")["visible"]
    assert (np.abs(seen - shown.pixels()).max(axis=-1) > 0.05).mean() < 0.001


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["no plan", "model", "chain", "track", "recording", "learned"])
def test_the_other_pages_draw_without_errors(kind: str, show: Any) -> None:
    page = {
        "no plan": lambda: plan_page(Plan("no_plan", "no mode reaches the goal"), problem()),
        "model": lambda: model_page(door(shapes=False)),
        "chain": lambda: model_page(cabinet()),
        "track": lambda: recording_page(measured()[0]),
        "recording": lambda: recording_page(*measured()),
        "learned": lambda: recording_page(*assessed_door()),
    }[kind]()
    assert len(page.encode()) < 2_000_000
    assert 0.003 < share_of_object(show(page, "#t=0.5").pixels()) < 0.6


@pytest.mark.slow
def test_pages_of_an_arm_and_of_a_calibration_open_without_errors(show: Any, repository: Path) -> None:
    by_arm = load_problem(repository / "problems" / "microwave_close_by_arm.yaml")
    page = plan_page(solve(by_arm).plan, by_arm)
    assert len(page.encode()) < 2_000_000
    assert 0.01 < share_of_object(show(page, "#t=0.5").pixels()) < 0.6
    drawer = load_problem(repository / "problems" / "drawer_open.yaml")
    runs = execute(solve(drawer), trials=4).recording
    shown = show(calibration_page(calibrate(drawer.automaton, runs), "drawer"), "")
    scene = shown.page.frame_locator("iframe.scene")
    scene.locator("body.ready").wait_for()
    assert np.ptp(shown.pixels("iframe.scene")) > 0.3
    assert scene.locator("#run").is_visible()
    assert scene.locator("#fade").count() == 0  # nothing was added, so there is one model
    assert shown.page.inner_text("h1") == "drawer: measured motion against the model"
    assert shown.page.locator(".chart canvas").count() > 10


@pytest.mark.slow
def test_a_slider_goes_from_before_to_after_a_calibration(show: Any, repository: Path) -> None:
    drawer = load_problem(repository / "problems" / "drawer_open.yaml")
    runs = execute(solve(drawer), trials=4).recording
    assert runs.action is not None
    halved = calibrate(drawer.automaton, replace(runs, action=2.0 * runs.action))
    assert any(effect.is_added for effect in halved.effects)
    shown = show(calibration_page(halved, "drawer"), "")
    scene = shown.page.frame_locator("iframe.scene")
    scene.locator("body.ready").wait_for()
    for place, seen in ((0.0, (0.45, 0.0)), (0.5, (0.45, 0.45)), (1.0, (0.0, 0.45))):
        scene.locator("#fade").fill(str(place))
        opacity = scene.locator("body").evaluate(
            """() => ["before", "after"].map((name) => {
              const runs = viewer.scene_tree.find(["meshcat", "runs"]);
              const drawn = Object.values(runs.children)[0].children[name].object;
              let least = 1;
              drawn.traverse((o) => { if (o.material) least = Math.min(least, o.material.opacity); });
              return drawn.visible ? least : 0;
            })"""
        )
        assert opacity == pytest.approx(list(seen))


@pytest.mark.slow
def test_the_served_page_is_the_page(show: Any, browser: Browser) -> None:
    text = model_page(door())
    with PageServer(lambda: text) as server:
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        page, messages = browser.new_page(viewport=WINDOW), []
        page.on("console", lambda message: messages.append(message.text))
        page.goto(f"{server.url}#t=0.25")
        page.wait_for_selector("body.ready")
        served = Shown(page, messages)
        assert np.abs(served.pixels() - show(text, "#t=0.25").pixels()).max() < 0.1
        page.close()
        server.shutdown()
    assert [message for message in messages if EXPECTED not in message] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "height", "smallest"), [(1280, 720, 12.5), pytest.param(1920, 1080, 15.0, marks=pytest.mark.evidence)]
)
def test_letters_grow_with_the_window_and_nothing_is_cut(width: int, height: int, smallest: float, show: Any) -> None:
    shown = show(plan_page(solved(), problem()), size={"width": width, "height": height})
    sizes = shown.page.evaluate(
        """() => [...document.querySelectorAll("#panel *, #player *")].filter(e => e.innerText && e.offsetParent)
                 .map(e => parseFloat(getComputedStyle(e).fontSize))"""
    )
    assert min(sizes) >= smallest
    for name in ("#keys", "#bands", "#readout"):
        box = shown.page.locator(name).bounding_box()
        assert box["y"] >= 0
        assert box["y"] + box["height"] <= height
    assert shown.page.evaluate("document.body.scrollWidth") <= width


@pytest.mark.slow
def test_a_dark_page_is_dark_all_over(show: Any) -> None:
    text = recording_page(*assessed_door())
    light, dark = (show(text, "#t=0.5", scheme=scheme).pixels() for scheme in ("light", "dark"))
    assert np.median(light) > 0.8
    assert np.median(dark) < 0.25
    assert 0.003 < (dark.max(axis=-1) > 0.6).mean() < 0.3, "joints and track are light"


@pytest.mark.slow
def test_an_error_would_be_seen(show: Any) -> None:
    shown = show(re.sub(r'"use strict";', '"use strict"; throw new Error("made up");', plan_page(solved(), problem())))
    assert any("made up" in message for message in shown.messages)
    shown.messages.clear()


@pytest.mark.slow
def test_the_page_may_not_connect_anywhere(show: Any) -> None:
    asking = plan_page(solved(), problem()).replace('"use strict";', '"use strict"; fetch("http://127.0.0.1:9/");')
    shown = show(asking)
    assert any("Content Security Policy" in message for message in shown.messages)
    shown.messages.clear()
