"""The demonstrations, models and problems that the project ships: in the installed package, or in the checkout."""

from __future__ import annotations

from pathlib import Path

from micah_plan.errors import InputError

FOLDERS = ("examples/demonstrations", "examples/logs", "models", "problems")
_PACKAGE = Path(__file__).resolve().parents[1]


def shipped_folder() -> Path:
    """The folder that has `FOLDERS`.

    Raises:
        InputError: if they are not where an installation or a checkout has them.
    """
    for place in (_PACKAGE / "shipped", _PACKAGE.parent):
        if all((place / name).is_dir() for name in FOLDERS):
            return place
    raise InputError("the demonstrations are not installed", remedy="install micah-plan from its wheel or its checkout")


def copy_shipped(folder: Path) -> tuple[Path, ...]:
    """Copy the shipped files into a folder that is new or empty, so that pages of the docs can be followed there.

    Raises:
        InputError: if something is in it already, or it cannot be made.
    """
    source = shipped_folder()
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise InputError("is there already", source=folder, remedy="name another folder")
    written = []
    try:
        for name in FOLDERS:
            for file in sorted((source / name).rglob("*")):
                if file.is_file() and "__pycache__" not in file.parts:
                    target = folder / file.relative_to(source)
                    target.parent.mkdir(parents=True, exist_ok=True)
                    target.write_bytes(file.read_bytes())
                    written.append(target)
    except OSError as error:
        problem = f"cannot be made ({error.strerror})"
        raise InputError(problem, source=folder, remedy="name a folder in one that exists") from None
    return tuple(written)
