"""What learning, planning and execution return: values that say what came out, and draw, show and save themselves.

A model against measured motion returns predictions with what their errors are worth, and calibrations. Pages open in
the browser, or within a notebook.
"""

from __future__ import annotations

import sys
import tempfile
from abc import abstractmethod
from dataclasses import dataclass
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from micah_plan.api import formatting as words
from micah_plan.automaton.graph import KinematicGraph
from micah_plan.automaton.hybrid import HybridAutomaton
from micah_plan.errors import InputError
from micah_plan.files import replace_file
from micah_plan.quantities import Summarised
from micah_plan.recording.value import Recording
from micah_plan.task.plan import Plan
from micah_plan.task.problem import Problem

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from micah_plan.api.stages import Learned
    from micah_plan.execution.trials import ErrorSummary, TrialStatistics
    from micah_plan.explore.run import Exploration
    from micah_plan.residual.calibrate import Calibration, FoundEffect
    from micah_plan.residual.judgement import Judgement
    from micah_plan.residual.prediction import RunPrediction


class Result(Summarised):
    """What a stage returns. The texts of `print` and of a notebook are its `summary`."""

    @property
    @abstractmethod
    def success(self) -> bool:
        """Whether there is what was asked for."""

    @property
    @abstractmethod
    def outcome(self) -> str:
        """How it ended, in one word that programs can compare."""

    @property
    @abstractmethod
    def reason(self) -> str:
        """Why it ended so, in one sentence with the remedy if there is one; may be empty where it succeeded."""

    @property
    def title(self) -> str:
        """The title of its page."""
        return type(self).__name__.removesuffix("Result")

    @abstractmethod
    def plot(self) -> Figure:
        """A Matplotlib figure."""

    @abstractmethod
    def page(self) -> str:
        """The text of a page that needs no network."""

    @abstractmethod
    def save(self, path: str | Path) -> None:
        """Write it as the file that commands read: a model, a plan, a recording."""

    def show(self, path: str | Path | None = None) -> Page:
        """The page: opened in the browser, or within a notebook.

        Args:
            path: where to write it, and nothing is opened; None: a temporary file.
        """
        return Page(self.page()).opened(path)


def save_model(automaton: HybridAutomaton | None, reason: str, path: str | Path) -> None:
    """Write a model in the format that the ending names; refused with the reason where there is no model."""
    if automaton is None:
        raise InputError(f"there is no model to write: {reason}")
    from micah_plan.exchange.convert import write_model

    write_model(automaton, path, name=Path(path).stem)


@dataclass(frozen=True, eq=False, repr=False)
class LearningResult(Result):
    """What `learn` returns; `learned` has all of it."""

    learned: Learned

    @property
    def success(self) -> bool:
        """Whether there is an automaton."""
        return self.automaton is not None

    @property
    def outcome(self) -> str:
        """``"learned"`` or ``"no_model"``."""
        return "learned" if self.success else "no_model"

    @property
    def reason(self) -> str:
        """Why there is no automaton and what to do; empty if there is one."""
        return self.learned.reason

    @property
    def automaton(self) -> HybridAutomaton | None:
        """The model; None if some rows follow no single joint."""
        return self.learned.automaton

    @property
    def graph(self) -> KinematicGraph:
        """The segments of every part, with their joints."""
        return self.learned.graph

    @property
    def recording(self) -> Recording:
        """What it was learned from."""
        return self.learned.recording

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looks like a mistake in the recording, one line each."""
        return self.learned.warnings

    def summary(self) -> str:
        """Parts, joints with their rows and how sure they are, and modes."""
        return "\n".join(words.learned_lines(self.learned))

    def plot(self) -> Figure:
        """The segmented track, its axes and the evidence over time."""
        from micah_plan.view.learning_figure import learning_figure

        return learning_figure(self.recording, self.graph)

    def page(self) -> str:
        """The segmented track in 3-D."""
        from micah_plan.view.recording_page import recording_page

        return recording_page(self.recording, self.graph, title=self.title)

    def save(self, path: str | Path) -> None:
        """Write the model (YAML)."""
        save_model(self.automaton, self.reason, path)


@dataclass(frozen=True, eq=False, repr=False)
class ExplorationResult(Result):
    """What `explore` returns: what was found by moving, and the model of it if it moved."""

    found: Exploration

    @property
    def success(self) -> bool:
        """Whether the object was opened, or is surely held."""
        return self.outcome != "gave_up"

    @property
    def outcome(self) -> str:
        """``"opened"``, ``"held"`` or ``"gave_up"``."""
        return self.found.outcome

    @property
    def reason(self) -> str:
        """One sentence."""
        return self.found.reason

    @property
    def automaton(self) -> HybridAutomaton | None:
        """The model; None where nothing moved."""
        return self.found.model

    def summary(self) -> str:
        """Outcome, joints with how sure they are, steps, way and the largest force."""
        return "\n".join(words.explored_lines(self.found))

    def plot(self) -> Figure:
        """Forces against their limit, and the probabilities of what holds the handle, over the steps."""
        from micah_plan.view.exploration_page import exploration_charts
        from micah_plan.view.figures import chart_figure

        return chart_figure(exploration_charts(self.found))

    def page(self) -> str:
        """The path of the hand, hypotheses, forces and probabilities."""
        from micah_plan.view.exploration_page import exploration_page

        return exploration_page(self.found, self.title)

    def save(self, path: str | Path) -> None:
        """Write the model (YAML)."""
        save_model(self.automaton, self.reason, path)


@dataclass(frozen=True, eq=False, repr=False)
class PlanningResult(Result):
    """What `solve` returns: the plan and the problem that it is for."""

    plan: Plan
    problem: Problem

    @property
    def success(self) -> bool:
        """Whether the plan solves the problem."""
        return self.plan.outcome == "solved"

    @property
    def outcome(self) -> str:
        """``"solved"``, ``"no_plan"`` or ``"not_verified"``."""
        return self.plan.outcome

    @property
    def reason(self) -> str:
        """One sentence, with the remedy if it failed."""
        return self.plan.reason

    @property
    def title(self) -> str:
        """The name of the problem's file."""
        return Path(self.problem.source).stem or "Plan"

    @property
    def mode_sequence(self) -> tuple[str, ...]:
        """The modes that the plan visits, in order."""
        return self.plan.mode_sequence

    @property
    def success_probability(self) -> float | None:
        """Share of roll-outs that end in the goal; None where nothing was verified."""
        return self.plan.success_probability

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the plan does not take into account, one line each."""
        return self.plan.warnings

    def summary(self) -> str:
        """Outcome, modes, distance from the goal and probability of success; of no plan what is in the way."""
        return "\n".join(words.solved_lines(self.plan, self.problem))

    def plot(self) -> Figure:
        """The planned belief over the steps.

        Raises:
            InputError: if there is no trajectory to draw.
        """
        from micah_plan.view.figures import belief_figure

        return belief_figure(self.problem, self.plan)

    def page(self) -> str:
        """The plan in 3-D; without one, start and goal."""
        from micah_plan.view.plan_page import plan_page

        return plan_page(self.plan, self.problem, title=self.title)

    def save(self, path: str | Path) -> None:
        """Write the plan with its problem (JSON)."""
        from micah_plan.documents.plan import write_plan

        write_plan(self.plan, self.problem, path)


@dataclass(frozen=True, eq=False, repr=False)
class RunsResult(Result):
    """What `execute` returns: statistics over the trials, with their recording, and the plan that was executed."""

    statistics: TrialStatistics
    planned: PlanningResult

    @property
    def success(self) -> bool:
        """Whether every trial reached the goal."""
        return self.successes == self.trials

    @property
    def outcome(self) -> str:
        """``"reached"``, ``"partly"`` or ``"missed"``."""
        return "reached" if self.success else "partly" if self.successes else "missed"

    @property
    def reason(self) -> str:
        """Why trials failed, the first of them."""
        return f"trial {self.failures[0][0]}: {self.failures[0][1]}" if self.failures else ""

    @property
    def title(self) -> str:
        """The name of the problem's file."""
        return self.planned.title

    @property
    def trials(self) -> int:
        """How many there were."""
        return self.statistics.trials

    @property
    def successes(self) -> int:
        """How many reached the goal."""
        return self.statistics.successes

    @property
    def failures(self) -> tuple[tuple[int, str], ...]:
        """(trial, reason) of the others."""
        return self.statistics.failures

    @property
    def final_error(self) -> ErrorSummary:
        """Mean, std and maximum of the error at the end [rad or m]."""
        return self.statistics.final_error

    @property
    def recording(self) -> Recording:
        """All runs, as a recording that `learn`, `predict` and `calibrate` take."""
        return self.statistics.recording

    def summary(self) -> str:
        """Successes, final errors, and why trials failed."""
        return "\n".join(words.runs_lines(self.statistics, self.planned.problem.goal_unit))

    def plot(self) -> Figure:
        """The planned belief and the runs on top."""
        from micah_plan.view.figures import belief_figure

        return belief_figure(self.planned.problem, self.planned.plan, self.recording)

    def page(self) -> str:
        """The runs beside the plan in 3-D, where they left it and why they failed."""
        from micah_plan.view.plan_page import plan_page

        plan, problem, failures = self.planned.plan, self.planned.problem, dict(self.failures)
        return plan_page(plan, problem, title=self.title, executed=self.recording, failures=failures)

    def save(self, path: str | Path) -> None:
        """Write the runs as a recording (CSV, NPZ, TUM or MCAP)."""
        from micah_plan.recording.read import write_recording

        write_recording(self.recording, path)


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
        from micah_plan.view.figures import chart_figure
        from micah_plan.view.prediction_page import prediction_charts

        return chart_figure(prediction_charts(self.automaton, self.runs), across=True)

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
        from micah_plan.view.calibration_page import motion_charts
        from micah_plan.view.figures import chart_figure

        return chart_figure(motion_charts(self.found), across=True)

    def page(self) -> str:
        """What was compared, what the model lacks, and how sure that is."""
        from micah_plan.view.calibration_page import calibration_page

        return calibration_page(self.found, self.title)

    def save(self, path: str | Path) -> None:
        """Write the calibrated model (YAML)."""
        save_model(self.automaton, "", path)


@dataclass(frozen=True, repr=False)
class Page:
    """A page that needs no network.

    Attributes:
        text: its HTML.
        height: in a notebook [px].
    """

    text: str
    height: int = 620

    def __repr__(self) -> str:
        return f"a page of {len(self.text) // 1024} kB"

    def _repr_html_(self) -> str:
        frame = f'<iframe width="100%" height="{self.height}" style="border:0" srcdoc="'
        return f'{frame}{escape(self.text)}"></iframe>'

    def save(self, path: str | Path) -> None:
        """Write it, at once or not at all."""
        replace_file(path, self.text.encode())

    def opened(self, path: str | Path | None = None) -> Page:
        """The page, written to `path` if one is given, else opened in a browser; a notebook shows it by itself."""
        if path is not None:
            self.save(path)
        elif not _in_notebook():
            import webbrowser

            file = Path(tempfile.mkdtemp(prefix="micah_plan_")) / "page.html"
            self.save(file)
            webbrowser.open(file.as_uri())
        return self


def _in_notebook() -> bool:
    """Whether an IPython kernel runs this, whose front end draws what cells end with."""
    shell = getattr(sys.modules.get("IPython"), "get_ipython", lambda: None)()
    return hasattr(shell, "kernel")
