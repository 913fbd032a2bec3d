"""The pages as text: self-contained, deterministic, small, escaped, and true to what they show."""

from __future__ import annotations

import base64
import dataclasses
import hashlib
import json
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umsgpack
from scipy.stats import chi2
from view_objects import OPEN_AT, cabinet, door, measured, problem, solved

from micah_plan.automaton.graph import BASE, KinematicEdge, KinematicGraph
from micah_plan.task.plan import Plan
from micah_plan.view.model_page import model_page
from micah_plan.view.motion import Keyframes, belief_ellipsoids, poses_over_time
from micah_plan.view.plan_page import plan_page
from micah_plan.view.recording_page import recording_page

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&"
NO_PLAN = Plan(
    "no_plan", "the goal lies outside the range; choose a goal up to 1.2 rad", candidates=solved().candidates
)


class Reader(HTMLParser):
    """Elements with their attributes, and the text of each kind of element."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: dict[str, list[str]] = {}
        self._open: list[str] = []
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in ("meta", "link", "input", "img"):
            self._open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        while self._open and self._open.pop() != tag:
            pass

    def handle_data(self, data: str) -> None:
        if self._open:
            self.texts.setdefault(self._open[-1], []).append(data)

    def visible(self) -> str:
        """The text without line breaks that the page forbids."""
        found = " ".join(text for tag, texts in self.texts.items() if tag not in ("script", "style") for text in texts)
        return found.replace("\N{NO-BREAK SPACE}", " ")


def page_data(page: str) -> dict[str, Any]:
    text = re.search(r'<script type="application/json" id="page-data">(.*?)</script>', page, re.DOTALL)
    assert text is not None
    return dict(json.loads(text[1]))


def commands(page: str) -> list[dict[str, Any]]:
    return [umsgpack.unpackb(base64.b64decode(text)) for text in page_data(page)["commands"]]


def pages() -> dict[str, str]:
    recording, graph = measured()
    return {
        "plan": plan_page(solved(), problem()),
        "no plan": plan_page(NO_PLAN, problem()),
        "not verified": plan_page(solved(outcome="not_verified"), problem()),
        "model": model_page(door()),
        "chain": model_page(cabinet()),
        "recording": recording_page(recording, graph),
        "track": recording_page(recording),
    }


@pytest.fixture(scope="module")
def all_pages() -> dict[str, str]:
    return pages()


def test_every_page_is_small_and_fetches_nothing(all_pages: dict[str, str]) -> None:
    for name, page in all_pages.items():
        assert len(page.encode()) < 2_000_000, name
        for tag, attributes in Reader(page).elements:
            for key in ("src", "href", "action", "data", "poster", "srcset"):
                assert (attributes.get(key) or "data:").startswith("data:"), (name, tag, attributes)
        policy = next(
            a["content"] for t, a in Reader(page).elements if a.get("http-equiv") == "Content-Security-Policy"
        )
        assert policy is not None
        assert policy.startswith("default-src 'none'")
        assert "http" not in policy
        own_scripts = page[: page.index("<!-- 3-D viewer")] + page[page.rindex("<script>") :]
        assert not re.search(r"https?://|wss?://|@import|url\(", own_scripts), name


@pytest.mark.slow
def test_the_same_input_gives_the_same_bytes_in_another_process(all_pages: dict[str, str]) -> None:
    script = "import hashlib, test_pages; print(hashlib.sha256(repr(test_pages.pages()).encode()).hexdigest())"
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parent), "PYTHONHASHSEED": "7"}
    other = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    assert other.stdout.strip() == hashlib.sha256(repr(all_pages).encode()).hexdigest()


def test_moving_pages_carry_an_animation_and_a_player(all_pages: dict[str, str]) -> None:
    for name, page in all_pages.items():
        moving = name != "no plan"
        assert ('id="player"' in page) == moving, name
        assert (page_data(page)["duration"] > 0) == moving, name


def pages_named(name: str) -> tuple[str, str, str]:
    """Of a plan, a model and a recording, with a name wherever there is one."""
    named_door = dataclasses.replace(door(name), provenance={name: name})
    recording, graph = measured()
    edges = (dataclasses.replace(graph.edges[0], child=name),)
    named = dataclasses.replace(recording, part=(name,) * len(recording), has_part=True)
    return (
        plan_page(solved(reason=name), problem(named_door), title=name),
        model_page(named_door, title=name),
        recording_page(named, dataclasses.replace(graph, edges=edges), title=name),
    )


def test_names_cannot_inject_html() -> None:
    for page, plain in zip(pages_named(HOSTILE), pages_named("plain"), strict=True):
        reader = Reader(page)
        assert [tag for tag, _ in reader.elements] == [tag for tag, _ in Reader(plain).elements]
        assert not {"img", "iframe", "object"} & {tag for tag, _ in reader.elements}
        assert not any(key.startswith("on") for _, attributes in reader.elements for key in attributes)
        assert "".join(reader.texts["h1"]) == HOSTILE
        assert page_data(page)["commands"]


def test_the_plan_page_shows_outcome_modes_and_numbers(all_pages: dict[str, str]) -> None:
    text = Reader(all_pages["plan"]).visible()
    for expected in ("SOLVED", "all constraints hold", "swinging", "stopped", "98.5 %", "0.005 rad", "95 %", "200"):
        assert expected in text
    assert "NOT VERIFIED" in Reader(all_pages["not verified"]).visible()


def test_a_failed_plan_reports_it_with_the_reason_and_what_was_tried(all_pages: dict[str, str]) -> None:
    text = Reader(all_pages["no plan"]).visible()
    for expected in ("NO PLAN", "choose a goal up to 1.2 rad", "goal mode not reached"):
        assert expected in text
    assert "SOLVED" not in text
    paths = {c["path"] for c in commands(all_pages["no plan"]) if c["type"] == "set_object"}
    assert any("/goal/" in path for path in paths)
    assert not any("/belief/" in path for path in paths)


def test_the_timeline_follows_the_modes(all_pages: dict[str, str]) -> None:
    data = page_data(all_pages["plan"])
    times = [time for time, _ in data["readouts"]]
    assert times == sorted(times)
    assert times[-1] < data["duration"], "the end rests a moment"
    assert data["readouts"][0][1] == ["step 0 of 20 (0 s), mode swinging", "door = 0.10 ± 0.08 rad (1 σ)"]
    assert data["readouts"][-1][1][0] == "step 20 of 20 (10 s), mode stopped"
    widths = [float(width) for width in re.findall(r"%;width:([0-9.]+)%", all_pages["plan"])]
    assert sum(widths) == pytest.approx(100.0, abs=0.01)
    assert min(widths) > 5.0, "the mode that is entered last is seen too"
    assert data["charts"][0][-1][0] == pytest.approx(data["duration"])


def test_the_belief_ellipsoid_has_the_stated_size_and_place(all_pages: dict[str, str]) -> None:
    animation = next(c for c in commands(all_pages["plan"]) if c["type"] == "set_animation")
    clip = next(a["clip"] for a in animation["animations"] if "/belief/" in a["path"])
    scales = next(t for t in clip["tracks"] if t["name"] == ".scale")["keys"]
    # sigma of 0.08 rad on a handle at sqrt(0.3² + 0.03²) m from the axis; one degree of freedom
    expected = np.sqrt(chi2.ppf(0.95, 1)) * 0.08 * np.hypot(0.3, 0.03)
    assert max(scales[0]["value"]) == pytest.approx(expected, rel=1e-6)
    places = next(t for t in clip["tracks"] if t["name"] == ".position")["keys"]
    radius = [np.hypot(*key["value"][:2]) for key in places]
    np.testing.assert_allclose(radius, np.hypot(0.3, 0.03), rtol=1e-6)


def test_ellipsoids_do_not_tumble_between_keyframes() -> None:
    angles = np.linspace(0.0, 1.4, 40)
    factors = np.tile(np.diag([0.05, 0.02]), (40, 1, 1))
    factors[:, 1, 1] = np.linspace(0.001, 0.1, 40)  # the order of the radii changes on the way
    states = np.column_stack([angles, np.full(40, 0.1)])
    keys = Keyframes(np.arange(40.0), ("free",) * 40, states, factors)
    poses, radii = belief_ellipsoids(cabinet(), keys, "drawer", 2.0, 1e-3)
    turns = (poses.rotation[1:] * poses.rotation[:-1].inv()).magnitude()
    assert turns.max() < np.radians(25)
    assert np.abs(np.diff(radii, axis=0)).max() < 0.02


def test_the_object_moves_to_where_the_belief_is(all_pages: dict[str, str]) -> None:
    animation = next(c for c in commands(all_pages["plan"]) if c["type"] == "set_animation")
    clip = next(a["clip"] for a in animation["animations"] if "/object/" in a["path"])
    final = next(t for t in clip["tracks"] if t["name"] == ".position")["keys"][-1]["value"]
    np.testing.assert_allclose(final, [0.3 * np.cos(OPEN_AT), -0.3 * np.sin(OPEN_AT), 0.1], atol=1e-9)


def test_the_model_page_sweeps_every_coordinate_of_a_chain(all_pages: dict[str, str]) -> None:
    lines = [text for _, text in page_data(all_pages["chain"])["readouts"]]
    doors = {line[1] for line in lines}
    drawers = {line[2] for line in lines}
    assert "door = 1.5 rad (85.9°)" in doors
    assert "drawer = 250 mm" in drawers
    moved = {a["path"] for c in commands(all_pages["chain"]) if c["type"] == "set_animation" for a in c["animations"]}
    assert any("/joints/" in path for path in moved)  # the slide's axis travels with the door


def test_segments_and_changepoints_are_reported(all_pages: dict[str, str]) -> None:
    text = Reader(all_pages["recording"]).visible()
    for expected in ("revolute, rows 0 to 39", "rigid, rows 40 to 59", "at row 40", "radius 300 mm"):
        assert expected in text


def test_a_single_row_and_several_runs_are_shown() -> None:
    recording, _ = measured()
    assert page_data(recording_page(recording.rows(slice(0, 1))))["duration"] == 0
    both = dataclasses.replace(recording, run=np.repeat([0, 1], 30), has_run=True)
    readouts = page_data(recording_page(both))["readouts"]
    assert {line for _, lines in readouts for line in lines if line.startswith("run")} == {"run 0", "run 1"}


def test_every_part_has_a_lane_of_segments() -> None:
    recording, graph = measured()
    both = dataclasses.replace(recording.rows(np.repeat(np.arange(60), 2)), part=("a", "b") * 60)
    swing, rest = graph.edges[0].segments
    a = KinematicEdge(BASE, "a", (dataclasses.replace(swing, end=79), dataclasses.replace(rest, start=80, end=118)))
    b = KinematicEdge(BASE, "b", (dataclasses.replace(swing, start=1, end=119),))
    page = recording_page(both, KinematicGraph((a, b)))
    lanes = [re.findall(r"<span>([^<]*)</span>", lane) for lane in page.split('<div class="lane">')[1:]]
    assert lanes[0] == ["a: revolute", "a: rigid"]
    assert lanes[1][0] == "b: revolute"
    assert page_data(page)["readouts"][0][1] == ["row 0, t = 0.00 s", "a: revolute", "b: revolute"]


def test_poses_over_time_adds_the_offset() -> None:
    keys = Keyframes(np.arange(2.0), ("swinging",) * 2, np.array([[0.2], [0.4]]))
    ahead = poses_over_time(door(), keys, np.full((2, 1), 0.1))["door"]
    np.testing.assert_allclose(np.hypot(*ahead.translation[:, :2].T), 0.3)
    np.testing.assert_allclose(np.arctan2(*(-ahead.translation[:, [1, 0]] * [1, -1]).T), [0.3, 0.5])
