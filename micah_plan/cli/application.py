"""All commands, and the mapping of errors to one line and an exit code."""

from __future__ import annotations

import errno
import json
import signal
import sys
import threading
import traceback
from typing import Annotated, Any, NoReturn

import typer
from typer.exceptions import TyperException

from micah_plan import __version__
from micah_plan.cli.calibration import calibrate, predict
from micah_plan.cli.checking import check, diff, doctor, error_keys
from micah_plan.cli.console import BAD_INPUT, NO_RESULT, OUR_BUG, Interrupted, err, out
from micah_plan.cli.demo import demo
from micah_plan.cli.files import convert, new, schema
from micah_plan.cli.interrupted import INTERRUPTED, SENTENCE, asks_for_json, is_of_an_interruption
from micah_plan.cli.learning import explore, learn
from micah_plan.cli.pages import show
from micah_plan.cli.planning import execute, explain, solve
from micah_plan.cli.sweeping import sweep
from micah_plan.cli.tracking import track
from micah_plan.errors import InputError, MicahError, MissingDependencyError

COMMANDS = (
    demo,
    new,
    track,
    learn,
    solve,
    explain,
    execute,
    predict,
    calibrate,
    explore,
    diff,
    sweep,
    show,
    convert,
    check,
    schema,
    doctor,
)

# What the system refuses is neither a bug nor always foreseen where a path is used.
_OF_THE_SYSTEM = {
    errno.ENAMETOOLONG: "give a shorter path",
    errno.ENOSPC: "make room on the disk",
    errno.EDQUOT: "make room on the disk",
    errno.EROFS: "name a file in a directory that may be written",
    errno.EACCES: "check the permissions",
    errno.EPERM: "check the permissions",
    errno.ELOOP: "check the links on the path",
    errno.EMFILE: "close files, or raise the limit of open ones",
    errno.EIO: "check the disk",
}

app = typer.Typer(
    help="From a recorded demonstration of an articulated object to a plan that holds under uncertainty.",
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)
for _command in COMMANDS:
    app.command()(_command)


def main() -> None:
    """Entry point of `micah-plan`: runs a command and turns errors into one line and an exit code."""
    _end_as_interrupted()
    try:
        code = app(prog_name="micah-plan", standalone_mode=False) or 0
    except TyperException as error:
        _fail(_usage_line(error), BAD_INPUT)
    except (InputError, MissingDependencyError) as error:
        _fail(error, BAD_INPUT)
    except Interrupted as error:
        _fail(error, INTERRUPTED)
    except MicahError as error:
        _fail(error, NO_RESULT)
    except (KeyboardInterrupt, typer.Abort):
        code = INTERRUPTED
    except OSError as error:
        if error.errno not in _OF_THE_SYSTEM:
            code = _report_bug(error)
        else:
            problem = (error.strerror or str(error)).lower()
            _fail(InputError(problem, source=str(error.filename)[:80], remedy=_OF_THE_SYSTEM[error.errno]), BAD_INPUT)
    except Exception as error:
        code = INTERRUPTED if is_of_an_interruption(error) else _report_bug(error)
    if code == INTERRUPTED:  # what typer makes of a KeyboardInterrupt within a command
        _fail(SENTENCE, INTERRUPTED)
    sys.exit(code)


def _report_bug(error: Exception) -> int:
    """Print a request to report an internal error."""
    _print_error(f"{type(error).__name__}: {error}; this is a bug in micah-plan, please report it with the lines below")
    traceback.print_exception(error)
    return OUR_BUG


def _end_as_interrupted() -> None:
    """Treat termination signals like Ctrl-C: plants are closed, logs are written, no file is half-written.

    A signal that is ignored stays so: `nohup` asks for a command that outlives its terminal.
    """
    if threading.current_thread() is not threading.main_thread():
        return  # only there may signals be handled
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, signal.default_int_handler)


def _usage_line(error: Any) -> InputError:
    """Typer's message on wrong usage in the form of other errors."""
    text = " ".join(error.format_message().replace("Value error, ", "").split()).rstrip(".")
    context = getattr(error, "ctx", None)
    command = "micah-plan" if context is None else context.command_path
    return InputError(text[:1].lower() + text[1:], remedy=f"see {command} --help")


def _fail(error: MicahError | str, code: int) -> NoReturn:
    _print_error(error)
    sys.exit(code)


def _print_error(error: MicahError | str) -> None:
    text = " ".join(str(error).split())
    if asks_for_json():
        faults = (
            [error_keys(problem) for problem in error.each()] if isinstance(error, InputError) else [{"message": text}]
        )
        print(json.dumps({"error": text, "errors": faults}))
    err.print(f"error: {text}", style="red")


@app.callback(invoke_without_command=True)
def _version(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
) -> None:
    if version:
        out.print(__version__)
        raise typer.Exit
    if context.invoked_subcommand is None:
        typer.echo(context.get_help(), err=True)
        raise typer.Exit(BAD_INPUT)
