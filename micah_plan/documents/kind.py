"""What kind of file a path names: YAML files say it in their key `format`, the others by their ending."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, get_args

from micah_plan.documents.located import choices
from micah_plan.documents.yaml_lines import LARGEST_TEXT_BYTES, read_yaml
from micah_plan.files import read_bytes

YamlKind = Literal["model", "parts", "problem", "sweep"]
FileKind = Literal["model", "parts", "problem", "sweep", "plan", "recording"]


def kind_of(path: str | Path) -> FileKind:
    """The kind of a file; whether it is a good one of that kind is not looked at.

    Raises:
        InputError: if it is YAML that cannot be read or whose `format` is of no kind.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".json":
        return "plan"
    if suffix not in {".yaml", ".yml"}:
        return "recording"
    located = read_yaml(read_bytes(path, LARGEST_TEXT_BYTES), str(path))
    kinds: tuple[YamlKind, ...] = get_args(YamlKind)
    formats = [f"micah-plan/{kind}/1" for kind in kinds]
    if "format" not in located.data:
        raise located.error((), "missing key 'format'", f"say what the file is: one of {', '.join(formats)}")
    stated = str(located.data["format"])
    for kind in kinds:
        if stated.startswith(f"micah-plan/{kind}/"):
            return kind
    raise located.error(("format",), f"unknown format {stated[:60]!r}", choices(stated, formats))
