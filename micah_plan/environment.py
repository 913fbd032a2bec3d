"""Capabilities of this installation: libraries with versions, solvers, a browser; and advice on what to install.

Everything is tried in a process of its own, so that a library that crashes does not end the check.
"""

from __future__ import annotations

import platform
import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Literal

from micah_plan import __version__

State = Literal["works", "missing", "broken"]
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
# The linear solvers of IPOPT; `planning.nlp` tries one. To name them, CasADi need not be there.
LINEAR_SOLVERS = ("mumps", "ma27", "ma57", "ma86", "ma97", "spral", "pardisomkl")
_TIMEOUT_S = 60.0
_PROBE = "import sys; from micah_plan.planning.nlp import can_solve; sys.exit(not can_solve(sys.argv[1]))"


@dataclass(frozen=True)
class Library:
    """A library that micah_plan uses.

    Attributes:
        name: of the distribution, as pip knows it.
        module: to import; empty if it holds data only.
        purpose: what micah_plan does with it.
        extra: that installs it; empty if every installation has it.
    """

    name: str
    module: str
    purpose: str
    extra: str = ""


LIBRARIES = (
    Library("casadi", "casadi", "optimise plans"),
    Library("jinja2", "jinja2", "pages"),
    Library("matplotlib", "matplotlib.figure", "figures"),
    Library("meshcat", "meshcat", "pages"),
    Library("numba", "numba", "calibrate"),
    Library("numpy", "numpy", "numbers"),
    Library("ompl", "ompl.base", "search modes"),
    Library("pin", "pinocchio", "plan with arms"),
    Library("pydantic", "pydantic", "YAML and plan files"),
    Library("pyyaml", "yaml", "read YAML files"),
    Library("rich", "rich", "this output"),
    Library("ruamel.yaml", "ruamel.yaml", "write YAML files"),
    Library("scipy", "scipy.optimize", "learn and filter"),
    Library("typer", "typer", "the command line"),
    Library("u-msgpack-python", "umsgpack", "pages"),
    Library("mujoco", "mujoco", "execute in MuJoCo", "sim"),
    Library("mcap", "mcap.reader", "read and write MCAP", "ros"),
    Library("rosbags", "rosbags.typesys", "read and write ROS messages", "ros"),
    Library("rerun-sdk", "rerun", "write .rrd for Rerun", "rerun"),
    Library("distributed", "distributed", "sweep on a Dask cluster", "cluster"),
    Library("pyarrow", "pyarrow.parquet", "read recordings and write tables as Parquet", "parquet"),
    Library("opencv-python-headless", "cv2", "track printed tags in a video", "vision"),
    Library("example-robot-data", "", "arms with meshes", "robots"),
    Library("pytest", "pytest", "run the tests", "test"),
    Library("pytest-xdist", "xdist", "run the tests", "test"),
    Library("hypothesis", "hypothesis", "run the tests", "test"),
    Library("jsonschema", "jsonschema", "run the tests", "test"),
    Library("mcap-ros2-support", "mcap_ros2.decoder", "run the tests", "test"),
    Library("pandas", "pandas", "take data frames", "test"),
    Library("evo", "evo", "judge trajectories", "evo"),
    Library("playwright", "playwright.sync_api", "test pages in a browser", "browser"),
    Library("imageio-ffmpeg", "imageio_ffmpeg", "write videos", "video"),
    Library("pillow", "PIL", "write videos", "video"),
    Library("jupyterlab", "", "open the notebooks", "notebooks"),
    Library("ipykernel", "", "run the notebooks", "notebooks"),
    Library("nbclient", "", "run the notebooks", "notebooks"),
    Library("mkdocs-jupyter", "", "build the docs", "docs"),
    Library("mkdocs-material", "material", "build the docs", "docs"),
    Library("mkdocstrings", "mkdocstrings", "build the docs", "docs"),
)


@dataclass(frozen=True)
class Found:
    """An installed library.

    Attributes:
        version: None if it is not installed.
        message: the last line of the error when its import failed.
    """

    library: Library
    state: State
    version: str | None
    message: str = ""


@dataclass(frozen=True)
class Environment:
    """Result of the examination.

    Attributes:
        linear_solvers: those that IPOPT can use; it uses MUMPS unless it is told otherwise.
        browser: path of a browser that can render pages without a screen; None if there is none.
        advice: which package to install for which purpose, one line each; empty if nothing is missing.
    """

    micah_plan: str
    python: str
    system: str
    libraries: tuple[Found, ...]
    linear_solvers: tuple[str, ...]
    browser: str | None
    advice: tuple[str, ...]

    @property
    def complete(self) -> bool:
        """Whether everything works that needs no extra."""
        return "mumps" in self.linear_solvers and all(
            library.state == "works" for library in self.libraries if not library.library.extra
        )


def examine(progress: Callable[[str, float], None]) -> Environment:
    """Test all capabilities; takes some seconds.

    Args:
        progress: called with a message and the fraction done.
    """
    steps = len(LIBRARIES) + len(LINEAR_SOLVERS)
    libraries = []
    for i, library in enumerate(LIBRARIES):
        progress(f"importing {library.name}", i / steps)
        libraries.append(_library(library))
    solvers = []
    for i, name in enumerate(LINEAR_SOLVERS, start=len(LIBRARIES)):
        progress(f"solving with {name}", i / steps)
        if _runs(_PROBE, name)[0]:
            solvers.append(name)
    browser = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    advice = _advice(libraries, solvers, browser)
    system = f"{platform.system()} {platform.machine()}"
    return Environment(
        __version__, platform.python_version(), system, tuple(libraries), tuple(solvers), browser, advice
    )


def _library(library: Library) -> Found:
    try:
        installed = version(library.name)
    except PackageNotFoundError:
        return Found(library, "missing", None)
    if not library.module:
        return Found(library, "works", installed)
    works, message = _runs(f"import {library.module}")
    return Found(library, "works" if works else "broken", installed, message)


def _runs(code: str, *arguments: str) -> tuple[bool, str]:
    """(whether Python runs the code without error, the last line of its output if not)."""
    try:
        done = subprocess.run(  # noqa: S603 - the code is a constant of this module
            [sys.executable, "-c", code, *arguments],
            capture_output=True,
            encoding="utf-8",
            errors="replace",
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False, f"no answer in {_TIMEOUT_S:g} s"
    message = done.stderr.strip().splitlines() or [f"ended with code {done.returncode}"]
    return done.returncode == 0, "" if done.returncode == 0 else message[-1]


def _advice(libraries: list[Found], solvers: list[str], browser: str | None) -> tuple[str, ...]:
    lines = []
    for found in libraries:
        library = found.library
        if found.state == "broken":
            lines.append(
                f"{library.name} does not load ({found.message}): pip install --force-reinstall {library.name}"
            )
        elif found.state == "missing" and not library.extra:
            lines.append(f"to {library.purpose}: pip install {library.name}")
    for extra in dict.fromkeys(library.library.extra for library in libraries if library.library.extra):
        missing = [
            library.library for library in libraries if library.library.extra == extra and library.state == "missing"
        ]
        if missing:
            purposes = " and ".join(dict.fromkeys(library.purpose for library in missing))
            names = " ".join(library.name for library in missing)
            lines.append(f"to use {extra} ({purposes}): pip install {names}")
    if "mumps" not in solvers:
        lines.append("IPOPT cannot solve with MUMPS, so planning is impossible: pip install --force-reinstall casadi")
    if browser is None:
        lines.append("to test pages in a browser: install Chromium, for instance apt-get install chromium")
    return tuple(lines)
