"""The pages: a recording, a model and a plan, each as one self-contained HTML file with an animated 3-D scene."""

from __future__ import annotations

from micah_plan.view.model_page import model_page
from micah_plan.view.plan_page import plan_page
from micah_plan.view.recording_page import recording_page

__all__ = ["model_page", "plan_page", "recording_page"]
