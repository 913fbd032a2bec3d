"""Plants as executions see them: created by `make_plant`, with every answer checked.

An exception in a plant's code becomes one line about that code, so that a mistake in a user's driver does not look like
one of the planner.
"""

from __future__ import annotations

import inspect
import signal
import threading
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from pkgutil import resolve_name
from types import FrameType, TracebackType
from typing import Any

import numpy as np

from micah_plan.arrays import Booleans, Floats
from micah_plan.errors import InputError, MicahError, shown
from micah_plan.execution.plant import Command, Measurement, Plant, PlantError, PlantMaker, Referee, Truth
from micah_plan.quantities import count
from micah_plan.recording.checks import LARGEST, NORM_TOLERANCE
from micah_plan.task.plants import BUILT_IN
from micah_plan.task.problem import Problem

_METHODS = ("reset", "apply", "close")
_PATIENCE = 60.0  # s


def make_plant(problem: Problem, kind: str | PlantMaker) -> Plant:
    """A plant for a problem.

    Args:
        kind: name of a plant of the package, or a class or function that is called with the problem.

    Raises:
        InputError: if there is none of that name, it cannot be made, or the result is not a plant.
        MissingDependencyError: if it needs a library that is not installed.
        PlantError: if the machine does not answer.
    """
    if not isinstance(kind, str):
        return plant_of(kind, problem, "problem")
    if kind in BUILT_IN:
        return plant_of(resolve_name(BUILT_IN[kind].maker), problem, "problem")
    raise InputError(f"unknown plant {shown(kind)}", remedy=f"choose {' or '.join(BUILT_IN)}")


def plant_of(maker: Callable[[Any], Plant], argument: object, what: str) -> Plant:
    """The plant that a class or function returns for a problem or a scene."""
    if isinstance(maker, type):  # before any machine moves
        check_methods(maker, maker.__name__)
    plant: Plant = _call_user_code(maker, f"{getattr(maker, '__name__', 'the plant')}({what})", maker, argument)
    check_methods(plant, type(plant).__name__)
    return plant


class CheckedPlant:
    """A plant with checked answers; as a context manager it closes the plant in any case."""

    def __init__(self, plant: Plant, parts: Sequence[str]) -> None:
        """Args: parts: (l,) names of the parts that each measurement has a row of, in this order."""
        self._plant = plant
        self._parts = parts
        self._time = -np.inf
        self._last: Measurement | None = None

    def reset(self, rng: np.random.Generator) -> Measurement:
        """The first measurement of a trial."""
        self._time = -np.inf
        return self._measured("reset", rng)

    def apply(self, command: Command) -> Measurement:
        """The measurement after a control step; the plant gets copies, so it cannot alter the belief.

        They can be written to, since SciPy's rotations take no arrays that cannot.
        """
        fields: dict[str, Any] = dict(vars(command))
        fields |= {name: value.copy() for name, value in fields.items() if isinstance(value, np.ndarray)}
        return self._measured("apply", Command(**fields))

    def truth(self) -> Truth | None:
        """The true state; None if the plant is no referee."""
        if not isinstance(self._plant, Referee):
            return None
        answer = self.ask("truth")
        if not isinstance(answer, Truth):
            raise InputError(f"the plant's truth() must give a Truth. Got {type(answer).__name__}")
        return answer

    def __enter__(self) -> CheckedPlant:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, _: TracebackType | None) -> None:
        if error is None:
            self.ask("close")
        else:
            with suppress(Exception):  # the first error is the one to report
                self.ask("close")

    def ask(self, method: str, *arguments: object) -> object:
        """The unchecked answer of a method of the plant; its exceptions become one line.

        Raises:
            PlantError: if it does not answer within the plant's `patience` [s], 60 if it has none; None: for ever.
        """
        kind = type(self._plant)
        what, patience = f"{kind.__name__}.{method}", getattr(self._plant, "patience", _PATIENCE)
        if patience is not None and not (isinstance(patience, int | float) and 0.0 < patience < np.inf):
            problem = f"{kind.__name__}.patience must be seconds > 0, or None. Got {shown(patience)}"
            raise InputError(problem, remedy="leave it out: the default is a minute")
        with _aborted_after(what, patience):
            return _call_user_code(kind, what, getattr(self._plant, method), *arguments)

    def _measured(self, method: str, argument: object) -> Measurement:
        answer = self.ask(method, argument)
        if method == "apply" and self._last is not None:
            answer = _with_last_poses(answer, self._last)
        self._last = checked_measurement(answer, self._parts, self._time)
        self._time = self._last.time
        return self._last


def _with_last_poses(answer: object, last: Measurement) -> object:
    """An answer with NaN poses replaced by the last ones and marked `unseen`."""
    if not isinstance(answer, Measurement):
        return answer
    try:
        position, quaternion = np.array(answer.position, dtype=float), np.array(answer.quaternion, dtype=float)
        unseen = np.isnan(position).any(axis=1) | np.isnan(quaternion).any(axis=1)
        position[unseen], quaternion[unseen] = last.position[unseen], last.quaternion[unseen]
    except (TypeError, ValueError, IndexError):
        return answer  # no such numbers: the check reports it
    return replace(answer, position=position, quaternion=quaternion, unseen=unseen) if unseen.any() else answer


@contextmanager
def _aborted_after(what: str, patience: float | None) -> Iterator[None]:
    """Abort calls that take longer than `patience` [s], where possible: in the main thread, on systems with alarms."""
    in_main = threading.current_thread() is threading.main_thread()
    if patience is None or not in_main or not hasattr(signal, "setitimer"):
        yield
        return

    failure = PlantError(f"{what} has not answered for {patience:g} s")
    is_late = False

    def break_off(_signal: int, _frame: FrameType | None) -> None:
        nonlocal is_late
        is_late = True
        raise failure

    before = signal.signal(signal.SIGALRM, break_off)
    # Again and again, should the plant's code catch the first one. What it answers then is late all the same.
    remaining = signal.setitimer(signal.ITIMER_REAL, patience, patience)
    try:
        yield
        if is_late:
            raise failure
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if remaining[0]:
            signal.setitimer(signal.ITIMER_REAL, *remaining)


def checked_measurement(answer: object, parts: Sequence[str], after: float = -np.inf) -> Measurement:
    """A validated measurement with copies of its arrays.

    Args:
        answer: returned by `reset` or `apply`.
        parts: (l,) name of each link's child part, in the automaton's order of links.
        after: time of the measurement before this one [s].

    Raises:
        InputError: if it is no `Measurement`, or a value in it is of the wrong shape, not finite, beyond all sizes that
            can be meant, not a unit quaternion (norm within 1 % of 1), or earlier than the last one.
    """
    if not isinstance(answer, Measurement):
        remedy = "return a micah_plan.execution.plant.Measurement from reset and apply"
        raise InputError(f"a plant must answer with a Measurement. Got {type(answer).__name__}", remedy=remedy)
    rows = len(parts)
    time = float(_array(answer.time, "time", (), "t"))
    if time <= after:
        problem = f"Measurement.time must be later at every step. Got {time:.9g} s after {after:.9g} s"
        raise InputError(problem, remedy="count the seconds since the reset")
    quaternion = _array(answer.quaternion, "quaternion", (rows, 4), "qx")
    norms = np.linalg.norm(quaternion, axis=1)
    off = np.abs(norms - 1.0)
    if off.max(initial=0.0) > NORM_TOLERANCE:
        row = int(np.argmax(off))
        found = f"the norm {norms[row]:.4g} for part {shown(parts[row])}"
        problem = f"Measurement.quaternion must hold unit quaternions. Got {found}"
        raise InputError(problem, remedy="give the measured orientation, scalar last")
    return Measurement(
        time=time,
        position=_array(answer.position, "position", (rows, 3), "x"),
        quaternion=quaternion,
        force=None if answer.force is None else _array(answer.force, "force", (rows, 3), "fx"),
        joints=None if answer.joints is None else _array(answer.joints, "joints", None, "x"),
        unseen=None if answer.unseen is None else _flags(answer.unseen, rows),
    )


def _array(value: object, name: str, shape: tuple[int, ...] | None, column: str) -> Floats:
    """A read-only copy of finite numbers with a shape (None: one row) and the range of a recording's column."""
    expected, largest = "(J,)" if shape is None else str(shape), LARGEST[column]
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"Measurement.{name} must be numbers of shape {expected}. Got {shown(value)}") from None
    if array.ndim != 1 if shape is None else array.shape != shape:
        remedy = "give one row per part, in the order of the automaton's links" if shape else None
        raise InputError(f"Measurement.{name} must have shape {expected}. Got {array.shape}", remedy=remedy)
    wrong = array[~(np.abs(array) <= largest)]  # NaN is not
    if wrong.size:
        remedy = "wait for a measurement, or raise PlantError if there is none"
        problem = f"Measurement.{name} must be finite and at most {largest:g}. Got {float(wrong.flat[0]):g}"
        raise InputError(problem, remedy=remedy)
    array.setflags(write=False)
    return array


def _flags(value: object, rows: int) -> Booleans:
    """(l,) flags, checked for shape and type."""
    flags = np.asarray(value)
    if flags.shape != (rows,) or flags.dtype != bool:
        problem = f"Measurement.unseen must be {count(rows, 'truth value')}. Got {shown(value)}"
        raise InputError(problem, remedy="leave it out, and answer NaN for the pose of a part that was not seen")
    return flags


def error_in_user_code(error: BaseException, file: str | None, what: str) -> InputError:
    """An exception from a user's code as one line: its type and message, with the line in the user's file.

    Args:
        file: theirs; None: unknown.
        what: the name of the called function.
    """
    frames = traceback.extract_tb(error.__traceback__)
    own = [frame for frame in frames if frame.filename == file]
    line = own[-1].lineno if own else None
    if isinstance(error, SyntaxError) and error.filename == file:
        line = error.lineno
    text = f"{type(error).__name__}: {error}" if str(error) else type(error).__name__
    return InputError(f"{what} raised {text}", source=file, where=None if line is None else f"line {line}")


def _call_user_code(culprit: object, what: str, call: Callable[..., Any], *arguments: object) -> Any:
    """The result of a call to user code; exceptions become one line about that code."""
    try:
        return call(*arguments)
    except MicahError:
        raise
    except (Exception, SystemExit) as error:
        if str(getattr(culprit, "__module__", "")).startswith("micah_plan."):
            raise  # a bug of ours
        file = None
        with suppress(TypeError):  # it was not defined in a file
            file = inspect.getsourcefile(culprit)  # type: ignore[arg-type]
        raise error_in_user_code(error, file, what) from error


def check_methods(plant: object, name: str) -> None:
    """Refuse an object that lacks a method of a plant."""
    missing = [method for method in _METHODS if not callable(getattr(plant, method, None))]
    if missing:
        methods = ", ".join(f"{method}()" for method in missing)
        remedy = "a plant has reset(rng), apply(command) and close(), see micah_plan.execution.plant"
        raise InputError(f"{name} is no plant: it has no {methods}", remedy=remedy)
