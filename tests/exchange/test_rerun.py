"""A recording as .rrd: the library's own reader finds its poses, actions and times."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from extras import requires

from micah_plan.exchange.convert import convert
from micah_plan.recording.read import read_recording

ROOT = Path(__file__).resolve().parents[2]
MICROWAVE = ROOT / "examples" / "demonstrations" / "microwave.csv"


@requires("rerun")
def test_rerun_finds_poses_and_actions(tmp_path: Path) -> None:
    import rerun

    assert rerun.RecordingStream
    kind, notes = convert(MICROWAVE, tmp_path / "door.rrd")
    assert (kind, notes) == ("recording", ())
    # `rerun rrd` is what comes with the viewer.
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-vv", str(tmp_path / "door.rrd")]
    printed = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    rows = len(read_recording(MICROWAVE))
    chunks = {
        words[-2]: int(words[2])
        for words in map(str.split, printed.splitlines())
        if words[0:1] and "Chunk(" in words[0]
    }
    assert {chunks[f"/run_0/door{name}"] for name in ("", "/action/x", "/action/z", "/force/y")} == {rows}
    # The viewer shows no poses, but what has a shape: axes that move with the part, and its track.
    assert (chunks["/run_0/door/axes"], chunks["/run_0/tracks/door"]) == (1, 1)


@requires("rerun")
def test_text_is_reported_to_be_left_out(tmp_path: Path) -> None:
    text = MICROWAVE.read_text().splitlines()
    lines = [f"{text[0]},mood", *(f"{line},good" for line in text[1:])]
    (tmp_path / "with.csv").write_text("\n".join(lines) + "\n")
    assert convert(tmp_path / "with.csv", tmp_path / "with.rrd")[1] == ("left out: mood, no numbers",)
