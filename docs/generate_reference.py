"""Pages on the YAML files, effects and the command line, made from their definitions; and MkDocs' hook.

The tables come from the JSON Schemas of `micah_plan.documents.kind`, the examples are files that the project ships,
the help texts are what the commands print. `docs/write_outputs.py` stores these pages, so that links lead to them in
the repository too, and a test compares. The hook makes a page of every module whenever the site is built.
"""

from __future__ import annotations

import ast
import json
import math
import re
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

from micah_plan.automaton.effects.registry import forms
from micah_plan.cli.application import app
from micah_plan.documents.kind import schema
from micah_plan.execution.mujoco.parameters import defaults

ROOT = Path(__file__).resolve().parents[1]
WIDTH = 88

INTRODUCTIONS = {
    "model": (
        "Model file",
        "models/drawer.yaml",
        "The [hybrid automaton](../concepts/automaton.md) of an object. `micah-plan learn` writes it; people can read "
        "and edit it. What is loaded is checked.",
    ),
    "parts": (
        "Parts file",
        "models/parts/drawer.yaml",
        "Shapes and handles of an object's parts. `micah-plan learn --parts` copies them into the model. They are for "
        "drawing, for physics and for the clearances of a [robot](../concepts/robots.md); the plan of the "
        "object itself does not use the shapes.",
    ),
    "problem": (
        "Problem file",
        "problems/microwave_close.yaml",
        "What `micah-plan solve` is asked: from which uncertain start to which goal, with which model.",
    ),
    "scene": (
        "Scene file",
        "problems/explore_handle.yaml",
        "What `micah-plan explore` is asked: to open what is in the hand, within limits. See "
        "[an object without a model](../guides/explore.md).",
    ),
    "sweep": (
        "Sweep file",
        "problems/sweeps/drawer.yaml",
        "What `micah-plan sweep` solves: problems, values to try in them, and seeds. See "
        "[many problems at once](../guides/sweep.md).",
    ),
    "experiment": (
        "Experiment file",
        "problems/experiments/drawer.yaml",
        "Motions in open loop, which `micah-plan calibrate --experiment` writes and `micah-plan execute` makes. See "
        "[the next experiment](../concepts/calibration.md#the-next-experiment).",
    ),
    "conventions": (
        "Conventions file",
        "examples/logs/laboratory.conventions.yaml",
        "How somebody else's recording is meant: names of columns, units, rate, upward axis. That of `door.csv` is "
        "`door.conventions.yaml` beside it. See [other people's tables]"
        "(../concepts/recording.md#other-peoples-tables).",
    ),
    "tags": (
        "Tags file",
        "examples/video/tags.yaml",
        "Which printed tags are on which part of an object: what `micah-plan track --tags` reads a video by. See "
        "[from a phone to a model](../guides/video.md).",
    ),
    "plan": (
        "Plan file",
        "",
        "What `micah-plan solve` writes, as JSON: the outcome, the belief trajectory and the whole problem, so that it "
        "can be executed and shown without other files. The same problem and seed give the same bytes; timings lie "
        "beside it in `*.timings.json`. It is made to be read by programs: an edited plan is refused.",
    ),
}

# Layers of effects, as people say where they act.
WHERE = {
    "frame": "the frame of commands",
    "place": "what a command means",
    "memory": "the command, earlier ones too",
    "command": "the command",
    "force": "the joint",
    "guard": "an end or a threshold",
    "sensor": "the reading",
    "geometry": "the joint's geometry",
}
MOST_PARAMETERS = 12

HALF_SPACES = """
## Half-spaces and expressions

Guards, invariants and admissible inputs are lists of half-spaces that must all hold. A half-space is one comparison of
two sums:

```yaml
guard: [door >= 1.2]
inputs: [input door <= 0.1, input door >= -0.1]
invariant:
  - door <= 1.2
  - in front of the table: 0.5*x + 2*z - input x > 0.1   # with a name of its own
```

A plain name is a coordinate, `input name` is an input. A name that is no plain identifier stands in double quotes. The
operators are `>=`, `>`, `<=` and `<`; `>` and `<` leave out the boundary. `step` and `reset` take the same sums without
a comparison, and a coordinate that is left out there does not move or keeps its value.
"""


def pages() -> dict[str, str]:
    """Markdown of every page that is made from definitions, by its place below docs/."""
    made = {f"reference/{kind}_file.md": _file_page(kind) for kind in INTRODUCTIONS}
    return made | {"reference/cli.md": _cli_page(), "reference/effects.md": _effects_page()}


def on_files(files: Any, config: Any) -> Any:
    """MkDocs calls this when it has listed the files of the site."""
    from mkdocs.structure.files import File, InclusionLevel

    for place, text in module_pages().items():
        files.append(File.generated(config, place, content=text, inclusion=InclusionLevel.NOT_IN_NAV))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """MkDocs calls this for every page: in the reference, a package is the list of its modules, each with a page."""
    if not page.file.src_uri.startswith("reference/"):
        return markdown
    return re.sub(r"^::: (micah_plan\S*)$", lambda match: _package(match[1]), markdown, flags=re.MULTILINE)


def modules_of(package: str) -> dict[str, str]:
    """Modules of a package, those of its packages too, each with the first sentence of its docstring; empty: it is
    none."""
    folder = ROOT / package.replace(".", "/")
    files = sorted(folder.rglob("*.py")) if folder.is_dir() else []
    names = {".".join(file.relative_to(ROOT).with_suffix("").parts): file for file in files}
    docstrings = {
        name: ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
        for name, file in names.items()
        if file.name != "__init__.py"
    }
    return {name: " ".join(text.split("\n\n")[0].split()) for name, text in docstrings.items()}


def module_pages() -> dict[str, str]:
    """A page for every module of every package, so that none is longer than a file."""
    packages = [file.parent.name for file in sorted((ROOT / "micah_plan").glob("*/__init__.py"))]
    return {
        f"reference/modules/{name}.md": f"# `{name}`\n\n::: {name}\n    options:\n      show_root_heading: false\n"
        for package in packages
        for name in modules_of(f"micah_plan.{package}")
    }


def _package(name: str) -> str:
    found = modules_of(name)
    if not found:
        return f"::: {name}"
    rows = [
        f"| [`{module.removeprefix(name + '.')}`](modules/{module}.md) | {said} |" for module, said in found.items()
    ]
    own = f"::: {name}\n    options:\n      show_submodules: false\n"
    return "\n".join([own, "", "| module | content |", "| --- | --- |", *rows])


def _effects_page() -> str:
    sections = [
        "# Effects\n\nWhat a model may lack, as [`calibrate`](../concepts/calibration.md#effects) names it and a "
        "[model file](model_file.md#effect) holds it. v is the command along a coordinate c in one step, t the time; "
        "*coordinate* stands for the unit of the coordinate, rad or m; *none* is the value without an effect. "
        "[Your own effect](../guides/own_effect.md) is a class with one formula.\n",
        "| effect | acts on | what it does |\n| --- | --- | --- |",
    ]
    shown = [form for form in forms() if len(form.parameters) < MOST_PARAMETERS]
    rows = [f"| [`{form.name}`](#{form.name}) | {WHERE[form.layer]} | {form.sentence} |" for form in shown]
    sections[-1] += "\n" + "\n".join(rows) + "\n"
    for form in shown:
        said = textwrap.dedent(f"    {type(form).__doc__ or ''}").strip()
        lines = ["| parameter | unit | bounds | none |", "| --- | --- | --- | --- |"]
        for each in form.parameters:
            bounds = f"{_bound(each.lower)} to {_bound(each.upper)}"
            bounds = "any" if bounds == "-∞ to ∞" else bounds
            neutral = "" if each.neutral is None else _bound(each.neutral) + ", left out" * each.is_optional
            lines.append(f"| `{each.name}` | {each.unit} | {bounds} | {neutral} |")
        table = "\n".join(lines)
        sections.append(f"## `{form.name}` {{#{form.name}}}\n\n{said}\n\n{table}\n\nSource: {form.source}.\n")
        told = "\n".join(f"- from `{other}`: {what}" for other, what in form.experiments)
        if told:
            sections.append(f"Told apart\n\n{told}\n")
    return "\n".join(sections)


def _bound(value: float) -> str:
    return f"{value:g}" if math.isfinite(value) else ("∞" if value > 0 else "-∞")


def _file_page(kind: str) -> str:
    title, example, introduction = INTRODUCTIONS[kind]
    described = schema(kind)
    sections = [
        f"# {title}\n\n{introduction}\n",
        f"Unknown keys, missing keys and wrong types are errors with the line number. Units are SI, angles in rad, "
        f"quaternions scalar last, paths relative to the file.\n\nCompletion and hover [in your editor](editors.md): "
        f"`micah-plan schema {kind}` prints the JSON Schema.\n",
        _example(example),
        f"## The file\n\n{_table(described)}",
    ]
    for name in _in_order_of_use(described):
        anchor = f"## {_heading(name)} {{#{_anchor(name)}}}"
        sections.append(f"{anchor}\n\n{_table(described['$defs'][name], name)}")
    if kind == "model":
        sections.append(HALF_SPACES)
    return "\n".join(sections)


def _example(place: str) -> str:
    if not place:
        return ""
    return f"## Example\n\n`{place}`:\n\n```yaml\n{_shortened((ROOT / place).read_text(encoding='utf-8'))}```\n"


def _shortened(text: str) -> str:
    """A file without the rows of covariance matrices, which are long and say little."""
    kept: list[str] = []
    depth = -1
    for line in text.splitlines():
        indent = len(line) - len(line.lstrip())
        if depth >= 0 and indent > depth:
            continue
        depth = -1
        if line.strip() == "covariances:":
            depth = indent
            line = "covariances: # names and matrix of each joint, left out on this page"
        elif line.strip().startswith("covariance:"):
            depth = indent
            line = " " * indent + "covariance: # names and matrix, left out on this page"
        kept.append(line)
    return "\n".join(kept) + "\n"


def _in_order_of_use(described: Mapping[str, Any]) -> list[str]:
    """Names of the definitions, each after the one that first refers to it."""
    found: list[str] = []
    waiting = [described]
    while waiting:
        text = json.dumps({key: value for key, value in waiting.pop(0).items() if key != "$defs"})
        for name in re.findall(r'"#/\$defs/(\w+)"', text):
            if name not in found:
                found.append(name)
                waiting.append(described["$defs"][name])
    return found


def _heading(name: str) -> str:
    words = re.findall(r"[A-Z][a-z]*", name.removesuffix("Document"))
    return " ".join(words).capitalize()


def _anchor(name: str) -> str:
    return _heading(name).lower().replace(" ", "-")


def _table(entry: Mapping[str, Any], name: str = "") -> str:
    lines = ["| key | value | default | meaning |", "| --- | --- | --- | --- |"]
    required = entry.get("required", [])
    for key, value in entry["properties"].items():
        default = "*required*" if key in required else _default(key, value, name)
        meaning = value.get("description", "").replace("|", "\\|")
        lines.append(f"| `{key}` | {_kind(value)} | {default} | {meaning} |")
    return "\n".join(lines) + "\n"


def _default(key: str, value: Mapping[str, Any], name: str) -> str:
    default = value.get("default")
    if name == "PlantDocument" and default is None:
        return _plant_default(key)
    return "" if default is None else f"`{json.dumps(default)}`"


def _plant_default(key: str) -> str:
    """The file leaves these open; what then holds is what the plant is built with."""
    standing, held = defaults(held=False), defaults(held=True)
    if key in standing and key in held and standing[key] != held[key]:
        return f"`{json.dumps(standing[key])}`, held: `{json.dumps(held[key])}`"
    return f"`{json.dumps({**held, **standing}[key])}`"


def _kind(value: Mapping[str, Any]) -> str:
    """A JSON Schema type in words."""
    if "$ref" in value:
        name = value["$ref"].rpartition("/")[2]
        return f"[{_heading(name).lower()}](#{_anchor(name)})"
    if "const" in value:
        return f"`{value['const']}`"
    if "enum" in value:
        return ", ".join(f"`{choice}`" for choice in value["enum"])
    if "anyOf" in value:
        if any(option.get("maxProperties") == 1 for option in value["anyOf"]):
            return "[half-space](#half-spaces-and-expressions)"
        is_name = any("maxLength" in option for option in value["anyOf"])
        if {option.get("type") for option in value["anyOf"]} == {"string", "number"} and not is_name:
            return "[expression](#half-spaces-and-expressions)"
        options = [option for option in value["anyOf"] if option.get("type") != "null"]
        return " or ".join(dict.fromkeys(_kind(option) for option in options))
    if value.get("type") == "array":
        if "prefixItems" in value:
            return f"{len(value['prefixItems'])} numbers"
        return f"list of {_kind(value['items'])}"
    if value.get("type") == "object":
        inner = value.get("additionalProperties")
        return f"by name: {_kind(inner)}" if isinstance(inner, dict) else "keys"
    plain = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true or false"}
    return plain.get(value.get("type", ""), "any") + _limits(value)


def _limits(value: Mapping[str, Any]) -> str:
    symbols = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    found = [f"{symbol} {value[key]:,}" for key, symbol in symbols.items() if key in value]
    return f" {', '.join(found)}" if found else ""


def help_text(*command: str) -> str:
    """What `micah-plan COMMAND --help` prints in a terminal of `WIDTH` columns."""
    options = {"prog_name": "micah-plan", "terminal_width": WIDTH, "max_content_width": WIDTH}
    return CliRunner().invoke(app, [*command, "--help"], **options).output  # type: ignore[arg-type]


def _cli_page() -> str:
    sections = [
        "# Command line\n\nThe help texts, as the commands print them. Exit codes: 0 done, 1 no result (for example: "
        "no plan found), 2 bad input. Results go to stdout, progress and errors to stderr. With `--json`, stdout gets "
        "exactly one JSON object.\n",
        f"```text\n{help_text()}```\n",
    ]
    commands = [str(info.name or getattr(info.callback, "__name__", "")) for info in app.registered_commands]
    sections += [f"## {name}\n\n```text\n{help_text(name)}```\n" for name in commands]
    return "\n".join(sections)
