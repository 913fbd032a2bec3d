"""What a model against measured motion returns: predictions with what their errors are worth, and calibrations."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.front import words
from micah_plan.front.result import Result, save_model
from micah_plan.recording.value import Recording

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.residual.calibrate import Calibration, FoundEffect
    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.prediction import RunPrediction


@dataclass(frozen=True, eq=False, repr=False)
class PredictionResult(Result):
    """What `predict` returns: the predictions of every run, and what their errors are worth."""

    automaton: HybridAutomaton
    recording: Recording
    runs: tuple[RunPrediction, ...]

    @cached_property
    def judgement(self) -> Judgement:
        """Noise floors, what errors follow, and when modes changed."""
        from micah_plan.residual.judgement import judge

        return judge(self.automaton, self.recording, self.runs)

    @property
    def success(self) -> bool:
        """Whether errors look like noise alone."""
        return self.judgement.is_noise is True

    @property
    def outcome(self) -> str:
        """``"noise"``, ``"lacking"`` (the model lacks something) or ``"unknown"``."""
        return {True: "noise", False: "lacking", None: "unknown"}[self.judgement.is_noise]

    @property
    def reason(self) -> str:
        """What errors follow, in words."""
        return self.judgement.sentence

    def summary(self) -> str:
        """Errors one step ahead and from the first row on, beside what noise alone would leave."""
        return "\n".join(words.predicted_lines(self.automaton, self.runs, self.judgement))

    def plot(self) -> Figure:
        """Measured and predicted configurations over time."""
        from micah_plan.view.prediction_figure import prediction_figure

        return prediction_figure(self.automaton, self.runs)

    def page(self) -> str:
        """Measured and predicted objects in 3-D, run by run."""
        from micah_plan.view.prediction_page import prediction_page

        return prediction_page(self.automaton, self.recording, self.runs, self.judgement, title=self.title)

    def save(self, path: str | Path) -> None:
        """Write the measured recording."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


@dataclass(frozen=True, eq=False, repr=False)
class CalibrationResult(Result):
    """What `calibrate` returns: the verdict, the effects found, and the model with them."""

    found: Calibration
    before: HybridAutomaton
    recording: Recording

    @property
    def success(self) -> bool:
        """Whether what the model lacks has a name, if it lacks anything."""
        return self.outcome != "unexplained"

    @property
    def outcome(self) -> str:
        """``"none"``, ``"explained"``, ``"partly"`` or ``"unexplained"``."""
        return self.found.verdict

    @property
    def reason(self) -> str:
        """The outcome as a sentence."""
        from micah_plan.residual.verdict import SENTENCES

        return SENTENCES[self.found.verdict]

    @property
    def automaton(self) -> HybridAutomaton:
        """The model with the effects."""
        return self.found.automaton

    @property
    def effects(self) -> tuple[FoundEffect, ...]:
        """What was found, strongest first."""
        return self.found.effects

    def summary(self) -> str:
        """Verdict, effects with their parameters, errors before and after, and what to try next."""
        return "\n".join(words.calibrated_lines(self.found))

    def plot(self) -> Figure:
        """Measured configurations, and those that the model predicts before and after."""
        from micah_plan.residual.prediction import predict_recording
        from micah_plan.view.prediction_figure import prediction_figure

        models = {"before": self.before, "calibrated": self.automaton}
        runs = {name: predict_recording(model, self.recording) for name, model in models.items()}
        return prediction_figure(self.automaton, runs["before"], runs["calibrated"])

    def page(self) -> str:
        """What was compared, what the model lacks, and how sure that is."""
        from micah_plan.view.calibration_page import calibration_page

        return calibration_page(self.found, self.title)

    def save(self, path: str | Path) -> None:
        """Write the calibrated model (YAML)."""
        save_model(self.automaton, "", path)
