"""The pages: a recording, a model, a plan and a calibration, each as one self-contained HTML file."""

from __future__ import annotations

from micah_plan.view.calibration_page import calibration_page
from micah_plan.view.model_page import model_page
from micah_plan.view.plan_page import plan_page
from micah_plan.view.recording_page import recording_page

__all__ = ["calibration_page", "model_page", "plan_page", "recording_page"]
