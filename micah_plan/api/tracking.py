"""`track`: from a video with printed tags to a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from micah_plan.api.result import Result
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.documents.tags import load_tags
from micah_plan.quantities import Progress, Table, plain, quantity
from micah_plan.recording.tag_layout import TagLayout
from micah_plan.recording.value import Recording
from micah_plan.vision.camera import Camera, load_camera
from micah_plan.vision.track_tags import Tracked, track_tags

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class TrackResult(Result):
    """Poses of parts that a video shows.

    Attributes:
        tracked: what was found.
        base: part in whose frame the poses are.
    """

    tracked: Tracked
    base: str

    @property
    def recording(self) -> Recording:
        """The poses, one row for each part and frame; give it to `learn`."""
        return self.tracked.recording

    @property
    def success(self) -> bool:
        return True

    @property
    def outcome(self) -> str:
        return "tracked"

    @property
    def reason(self) -> str:
        return ""

    @property
    def warnings(self) -> tuple[str, ...]:
        return self.tracked.notes

    @property
    def title(self) -> str:
        return "Tracked parts"

    def report(self) -> list[str | Table]:
        found = self.tracked
        camera = "the camera stood still" if found.is_fixed else "the camera moved"
        rows = tuple(
            (part, f"{found.rows_of(part)} of {found.frames}", quantity(place, "m"), quantity(turn, "rad"))
            for part, (place, turn) in found.stds.items()
        )
        return [
            f"{found.frames} frames, {camera}, corners of tags known to {plain(found.noise, 2)} px",
            Table((f"part beside {self.base}", "frames", "position ±", "turn ±"), rows, numeric=(1, 2, 3)),
        ]

    def json(self) -> dict[str, Any]:
        found = self.tracked
        parts = {
            part: {"frames": found.rows_of(part), "position_std": place, "turn_std": turn}
            for part, (place, turn) in found.stds.items()
        }
        return {
            "outcome": self.outcome,
            "base": self.base,
            "frames": found.frames,
            "camera_is_fixed": found.is_fixed,
            "corner_std_px": found.noise,
            "focal_length_px": float(found.camera.matrix[0, 0]),
            "focal_length_std_px": float(found.camera.matrix[0, 0] * found.camera.uncertainty),
            "parts": parts,
            "warnings": list(self.warnings),
        }

    def plot(self) -> Figure:
        """The tracks of the parts over time."""
        from micah_plan.view.learning_figure import learning_figure

        return learning_figure(self.recording, KinematicGraph(()))

    def page(self, title: str = "") -> str:
        """The tracks in 3-D."""
        from micah_plan.view.recording_page import recording_page

        return recording_page(self.recording, title=title or self.title)

    def save(self, path: str | Path) -> None:
        """Write the recording."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


def track(
    video: str | Path,
    tags: str | Path | TagLayout,
    *,
    camera: str | Path | Camera | None = None,
    base: str | None = None,
    rate: float | None = None,
    progress: Progress | None = None,
) -> TrackResult:
    """The poses of parts with printed tags in a video, as a recording.

    Args:
        video: file that OpenCV decodes, or folder of pictures with ``stamps.txt``.
        tags: which tags are on which part, a file (YAML) or value.
        camera: file or value; None: its focal length is found from the tags.
        base: part in whose frame poses are; default: the one called base, else the first.
        rate: frames per second, in place of what the video says.

    Raises:
        InputError: if a file cannot be used, or no part is seen together with the base.
        MissingDependencyError: without OpenCV (extra ``vision``).
    """
    layout = tags if isinstance(tags, TagLayout) else load_tags(tags)
    lens = camera if isinstance(camera, Camera) or camera is None else load_camera(camera)
    found = track_tags(video, layout, lens, base=base, rate=rate, progress=progress)
    return TrackResult(found, base or ("base" if "base" in layout.parts else layout.parts[0]))
