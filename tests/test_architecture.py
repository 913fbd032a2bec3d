"""The structure that the design promises: layers without cycles, one importer per heavy library, a cheap import."""

from __future__ import annotations

import ast
import importlib.util
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import micah_plan
from micah_plan.automaton.joint import JOINT_KINDS

PACKAGE = Path(micah_plan.__file__).parent

# Lowest first. A module may import from its own entry and from the lines above, never from its own line's neighbours
# or from below. Entries are packages or files of the top level: there are no exceptions for single modules.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("arrays", "errors", "message", "quantities"),
    ("changepoints", "files", "mujoco_library", "summaries"),
    ("output_files", "xml_text"),
    ("recording",),
    ("automaton",),
    ("task",),
    ("documents", "learning", "symbolic"),
    ("robot", "vision"),
    ("belief",),
    ("planning",),
    ("execution",),
    ("exploration", "residual"),
    ("view",),
    ("exchange",),
    ("checking", "environment", "templates"),
    ("api",),
    ("sweep",),
    ("cli",),
    ("__main__",),
)

# Where each heavy library may be imported, and whether only one file there may.
IMPORTERS: dict[str, tuple[tuple[str, ...], bool]] = {
    "casadi": (("symbolic.", "planning.nlp", "planning.transcription."), False),
    "ompl": (("planning.search.ompl_library",), True),
    "pinocchio": (("robot.",), False),
    "coal": (("robot.",), False),
    "meshcat": (("view.",), True),
    "numba": (("residual.row_loop",), True),
    "mujoco": (("mujoco_library",), True),
    "matplotlib": (("view.",), False),
    "jinja2": (("view.",), True),
    "ruamel": (("documents.",), True),
    "yaml": (("documents.",), True),
    "pydantic": (("documents.",), False),
    "cv2": (("vision.opencv",), True),
    **dict.fromkeys(("mcap", "lz4", "zstandard"), (("recording.ros_mcap",), True)),
    "rosbags": (("recording.ros_bags", "recording.ros_mcap"), False),
    "distributed": (("sweep.",), True),
    "pyarrow": (("sweep.result", "recording.parquet_file"), False),
    "typer": (("cli",), False),
    "rich": (("cli",), False),
}
SLOW_TO_LOAD = (
    "ompl",
    "pinocchio",
    "coal",
    "meshcat",
    "mujoco",
    "casadi",
    "numba",
    "matplotlib",
    "jinja2",
    "mcap",
    "distributed",
    "pyarrow",
)
LIGHT = (
    "errors",
    "files",
    "recording",
    "automaton",
    "task",
    "documents",
    "learning",
    "api",
)


def _sources(root: Path) -> dict[str, ast.Module]:
    """Syntax tree of every module, by its name below the root package ('' for the package itself)."""
    trees = {}
    for file in sorted(root.rglob("*.py")):
        parts = file.relative_to(root).with_suffix("").parts
        trees[".".join(part for part in parts if part != "__init__")] = ast.parse(file.read_text(encoding="utf-8"))
    return trees


def _is_type_checking(test: ast.expr) -> bool:
    return (isinstance(test, ast.Name) and test.id == "TYPE_CHECKING") or (
        isinstance(test, ast.Attribute) and test.attr == "TYPE_CHECKING"
    )


def _runtime_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """All nodes that can run, those inside functions too, without what only type checkers see."""
    yield node
    skipped: list[ast.stmt] = node.body if isinstance(node, ast.If) and _is_type_checking(node.test) else []
    for child in ast.iter_child_nodes(node):
        if child not in skipped:
            yield from _runtime_nodes(child)


def _imported(tree: ast.Module) -> Iterator[str]:
    """Absolute dotted names that a module imports anywhere; for ``from a import b`` it is a.b."""
    for node in _runtime_nodes(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import in line {node.lineno}"
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"import_module", "__import__"}:
                yield str(node.args[0].value)


def _edges(trees: Mapping[str, ast.Module], package: str = "micah_plan") -> dict[str, set[str]]:
    """Which modules of the package each of its modules imports."""
    edges: dict[str, set[str]] = {name: set() for name in trees}
    for name, tree in trees.items():
        for target in _imported(tree):
            if target.split(".")[0] == package:
                inner = target.removeprefix(package).lstrip(".")
                edges[name].add(inner if inner in trees else inner.rpartition(".")[0])
    return edges


def _layer(module: str) -> tuple[int, str]:
    """Level and entry of the layer that holds the module: its name up to the first dot."""
    entry = module.split(".")[0]
    levels = [level for level, entries in enumerate(LAYERS) if entry in entries]
    assert levels, f"micah_plan.{module} belongs to no layer: add it to LAYERS where it fits"
    return levels[0], entry


def _cycle(edges: Mapping[str, set[str]]) -> list[str]:
    try:
        TopologicalSorter(edges).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


@cache
def _trees() -> Mapping[str, ast.Module]:
    """Of the package: parsed by the process that runs these tests, not by all that collect them."""
    return _sources(PACKAGE)


@cache
def _libraries() -> Mapping[str, frozenset[str]]:
    """Of every module of the package, the top-level packages that it imports anywhere."""
    return {module: frozenset(name.split(".")[0] for name in _imported(tree)) for module, tree in _trees().items()}


@cache
def _imports() -> Mapping[str, set[str]]:
    return _edges(_trees())


def test_the_tools_of_this_file_see_cycles_hidden_in_functions_but_not_those_of_types(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("def f():\n    from p.b import x\n")
    (tmp_path / "b.py").write_text(
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import p.a\nelse:\n    import mujoco\n"
    )
    trees = _sources(tmp_path)
    assert _edges(trees, "p") == {"a": {"b"}, "b": set()}
    assert "mujoco" in set(_imported(trees["b"]))
    (tmp_path / "b.py").write_text("import importlib\nimportlib.import_module('p.a')\n")
    assert set(_cycle(_edges(_sources(tmp_path), "p"))) == {"a", "b"}


@pytest.mark.slow
def test_every_imported_module_of_the_package_exists() -> None:
    unknown = {name: targets - _trees().keys() for name, targets in _imports().items()}
    assert {name: targets for name, targets in unknown.items() if targets} == {}


def _exists(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # its parent is no package
        return False


def test_benchmarks_and_examples_import_what_is_there(repository: Path) -> None:
    missing = []
    for file in sorted((*repository.glob("benchmarks/*.py"), *repository.glob("examples/*.py"))):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "micah_plan":
                module = importlib.import_module(str(node.module))
                names = [alias.name for alias in node.names]
                # A name is one of the module, or a module in it.
                missing += [
                    f"{file.name}: {node.module}.{name}"
                    for name in names
                    if not hasattr(module, name) and not _exists(f"{node.module}.{name}")
                ]
    assert missing == []


def test_no_import_cycle() -> None:
    assert not _cycle(_imports())


def test_imports_only_go_down_the_layers() -> None:
    wrong = []
    for module, targets in _imports().items():
        if not module:  # the package itself is a shop window over all layers; cycles through it are found above
            continue
        level, entry = _layer(module)
        for target in filter(None, targets):
            target_level, target_entry = _layer(target)
            if target_entry != entry and target_level >= level:
                wrong.append(f"{module} imports {target}")
    assert not wrong


@pytest.mark.parametrize("library", IMPORTERS)
def test_each_heavy_library_has_one_importer(library: str) -> None:
    allowed, one_file = IMPORTERS[library]
    users = {module for module, libraries in _libraries().items() if library in libraries}
    assert not {module for module in users if not module.startswith(allowed)}
    assert not one_file or len(users) <= 1


def test_only_the_command_line_loads_code_that_is_not_the_packages() -> None:
    """Above everything that reads files: no problem, sweep or plan can have code loaded."""
    loaders = {"spec_from_file_location", "entry_points", "run_path", "SourceFileLoader"}
    users = {module for module, tree in _trees().items() if loaders & {n.rpartition(".")[2] for n in _imported(tree)}}
    assert users == {"cli.plants", "cli.user_code"}


def _run(code: str, *options: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *options, "-c", code], capture_output=True, text=True, check=False)


def _import_without(libraries: tuple[str, ...], modules: list[str]) -> str:
    """What goes wrong when the modules are imported one after the other where the libraries are not installed."""
    code = f"""
import importlib, sys
class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in {libraries!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Absent())
for module in {modules!r}:
    try:
        importlib.import_module(module)
    except ImportError as error:
        print(f"{{module}}: {{error}}")
print(*sorted(set({libraries!r}) & set(sys.modules)), sep="\\n", end="")
"""
    result = _run(code)
    return (result.stdout + result.stderr).strip()


def _full(module: str) -> str:
    return f"micah_plan.{module}".rstrip(".")


def test_a_missing_library_is_noticed_by_these_tests() -> None:
    assert _import_without(("numpy",), ["micah_plan.recording.value"]) == (
        "micah_plan.recording.value: No module named 'numpy'"
    )


def test_the_package_imports_without_any_heavy_library() -> None:
    assert _import_without(SLOW_TO_LOAD, ["micah_plan"]) == ""


def test_the_lower_layers_import_without_any_heavy_library() -> None:
    light = [module for module in _trees() if any(module == name or module.startswith(f"{name}.") for name in LIGHT)]
    assert len(light) > len(LIGHT)
    assert _import_without(SLOW_TO_LOAD, [_full(module) for module in light]) == ""


@pytest.mark.slow
def test_all_but_one_file_imports_without_the_extra_for_simulation() -> None:
    users = {module for module, libraries in _libraries().items() if "mujoco" in libraries}
    assert _import_without(("mujoco",), [_full(module) for module in _trees() if module not in users]) == ""


def test_importing_the_package_loads_few_modules() -> None:
    def loaded(code: str) -> set[str]:
        result = _run(code, "-X", "importtime")
        assert result.returncode == 0, result.stderr
        return {line.rpartition("|")[2].strip() for line in result.stderr.splitlines() if "|" in line}

    new = loaded("import micah_plan") - loaded("pass")
    assert "micah_plan" in new
    assert not {name for name in new if name.split(".")[0] in (*IMPORTERS, "numpy", "scipy")}
    assert len(new) < 50, sorted(new)


# What a command may not load: libraries that its answer does not need; they are most of the time of a start.
# MeshCat's own package imports a server and IPython; `scipy.stats` takes half a second for a quantile.
NEVER = ("scipy.stats", "meshcat", "tornado", "zmq", "IPython", "pyngrok", "pandas", "sympy")
NOT_LOADED: dict[str, tuple[str, ...]] = {
    "--version": ("numpy", "scipy", "jinja2", "ruamel", "yaml"),
    "--help": ("numpy", "scipy", "jinja2", "ruamel", "yaml"),
    "schema problem": ("scipy", "ompl", "pinocchio", "casadi", "matplotlib", "jinja2"),
    "check problems/drawer_open.yaml": ("scipy", "ompl", "pinocchio", "casadi", "matplotlib", "jinja2"),
    "learn examples/demonstrations/drawer.csv -o {out}/model.yaml": (
        *("ompl", "pinocchio", "casadi", "mujoco", "matplotlib", "jinja2", "umsgpack"),
    ),
    "solve problems/drawer_open.yaml -o {out}/plan.json": ("pinocchio", "mujoco", "matplotlib", "jinja2", "umsgpack"),
    "show models/drawer.yaml -o {out}/page.html": ("ompl", "casadi", "mujoco"),
    "execute {out}/plan.json --trials 1 -o {out}/runs.csv": ("mujoco", "matplotlib", "jinja2", "umsgpack"),
    "predict models/drawer.yaml {out}/runs.csv": ("ompl", "pinocchio", "mujoco", "matplotlib", "jinja2", "umsgpack"),
    "show {out}/plan.json -o {out}/plan.html": ("ompl", "mujoco"),
}


def _bold_seams(tree: ast.Module) -> list[str]:
    """Lines of a module's docstring that begin a part of their own: what stands there is another module."""
    return [line for line in (ast.get_docstring(tree) or "").splitlines() if line.startswith("**")]


def _late_constants(tree: ast.Module) -> list[str]:
    """Names of values below the first function that do not depend on one: they belong above it."""
    late, defined = list[str](), set[str]()
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and defined:
            read = [node.value] + ([node.annotation] if isinstance(node, ast.AnnAssign) else [])
            used = {name.id for part in read if part for name in ast.walk(part) if isinstance(name, ast.Name)}
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
            if used & defined or any(name.startswith("__") for name in names):
                defined.update(names)
            elif not any(isinstance(target, ast.Attribute) for target in targets):
                late += names
    return late


def test_a_module_has_one_idea_and_its_constants_first() -> None:
    assert {module: seams for module, tree in _trees().items() if (seams := _bold_seams(tree))} == {}
    assert {module: late for module, tree in _trees().items() if (late := _late_constants(tree))} == {}


def test_two_ideas_and_late_constants_are_seen() -> None:
    tree = ast.parse('"""One.\n\n**Another.** Two.\n"""\nA = 1\ndef f(): ...\nB = f()\nC = 2\nD = B + C\n')
    assert _bold_seams(tree) == ["**Another.** Two."]
    assert _late_constants(tree) == ["C"]


def _cut_words(tree: ast.Module) -> list[tuple[int, str]]:
    """Line and text wherever a string is compared with words of a sentence, or cut at them."""
    cutting = {"split", "rsplit", "partition", "rpartition", "startswith", "endswith", "removeprefix", "removesuffix"}
    found = []
    for node in ast.walk(tree):
        asked: list[ast.expr] = []
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in cutting:
            asked = node.args
        elif isinstance(node, ast.Compare):
            asked = [node.left, *node.comparators]
        for part in asked:
            pieces = part.values if isinstance(part, ast.JoinedStr) else [part]
            texts = [piece.value if isinstance(piece, ast.Constant) else "x" for piece in pieces]
            text = "".join(each for each in texts if isinstance(each, str))
            if text.startswith("; ") or re.search(r"[a-z]{2,} [a-z]{2,} [a-z]{2,}", text):
                found.append((part.lineno, text))
    return found


def test_no_sentence_is_compared_or_cut() -> None:
    """Reasons and remedies are values (`task.reason`); what they say is for people."""
    seen = ast.parse('a = text.split("; ")\nb = "lower the confidence" in remedy\nc = name == "joint limit"')
    assert [line for line, _ in _cut_words(seen)] == [1, 2]
    assert {module: cut for module, tree in _trees().items() if (cut := _cut_words(tree))} == {}


def test_no_module_imports_what_loads_statistics() -> None:
    """`scipy.signal` loads `scipy.stats`: seen here at once, by the commands only where the slow tests run."""

    def users(*libraries: str) -> set[str]:
        return {
            module
            for module, tree in _trees().items()
            if any(name == each or name.startswith(f"{each}.") for name in _imported(tree) for each in libraries)
        }

    assert users("scipy.linalg")  # imports of submodules are seen
    assert not users("scipy.stats", "scipy.signal")


@pytest.mark.slow
def test_each_command_loads_only_what_it_needs(repository: Path, tmp_path: Path) -> None:
    code = (
        "import sys; from micah_plan.cli import main\n"
        "sys.argv = ['micah-plan', *{arguments!r}]\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code, end.code\n"
        "print('\\nloaded', *sys.modules)"
    )
    loaded = {}
    for line in NOT_LOADED:
        arguments = line.format(out=tmp_path).split()
        done = subprocess.run(
            [sys.executable, "-c", code.format(arguments=arguments)],
            cwd=repository,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        loaded[line] = set(done.stdout.splitlines()[-1].split()[1:])
    needless = {line: sorted(found.intersection((*NEVER, *NOT_LOADED[line]))) for line, found in loaded.items()}
    assert needless == {line: [] for line in NOT_LOADED}
    assert all("typer" in found for found in loaded.values())  # what is loaded is seen


def test_the_package_says_that_it_is_typed() -> None:
    assert (PACKAGE / "py.typed").is_file()


def _own_code(repository: Path) -> list[Path]:
    folders = (PACKAGE, repository / "examples", repository / "benchmarks")
    return [file for folder in folders for file in sorted(folder.rglob("*.py"))]


def test_no_source_file_is_over_700_lines(repository: Path) -> None:
    lengths = {str(file): len(file.read_text(encoding="utf-8").splitlines()) for file in _own_code(repository)}
    assert {file: length for file, length in lengths.items() if length > 700} == {}


def test_no_function_is_over_60_lines(repository: Path) -> None:
    long = {}
    for file in _own_code(repository):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                length = (node.end_lineno or node.lineno) - node.lineno + 1
                if length > 60:
                    long[f"{file}:{node.lineno} {node.name}"] = length
    assert long == {}


VAGUE_NAMES = {"own", "one", "found", "seen", "told", "left", "known", "given", "other", "some"}


def stored_names(source: str) -> list[str]:
    """All names that a text assigns to: variables, loops and comprehensions, and arguments."""
    nodes = list(ast.walk(ast.parse(source)))
    stored = [node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)]
    return stored + [node.arg for node in nodes if isinstance(node, ast.arg)]


@pytest.mark.slow
def test_hardly_any_name_fits_everything() -> None:
    assert stored_names("def f(own, x):\n    found = [one for one in x]") == ["found", "one", "own", "x"]
    names = [name for path in PACKAGE.rglob("*.py") for name in stored_names(path.read_text(encoding="utf-8"))]
    vague = sum(name in VAGUE_NAMES for name in names)
    assert vague < 0.01 * len(names), f"{vague} of {len(names)} names could stand for anything"


def test_no_two_classes_have_one_name() -> None:
    places = Counter(node.name for tree in _trees().values() for node in tree.body if isinstance(node, ast.ClassDef))
    assert {name for name, count in places.items() if count > 1 and not name.startswith("_")} == set()


def test_functions_share_a_name_only_from_command_to_stage() -> None:
    """What has one name is one thing: a command, the function behind it, and the stage that does the work."""
    places: dict[str, list[str]] = {}
    for module, tree in _trees().items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef) and not node.name.startswith("_") and node.name != "main":
                places.setdefault(node.name, []).append(module)
    shared = {name: modules for name, modules in places.items() if len(modules) > 1}
    assert {name: modules for name, modules in shared.items() if not any(m.startswith("cli.") for m in modules)} == {}
    below = {name: [m for m in modules if not m.startswith(("cli.", "api."))] for name, modules in shared.items()}
    assert {name: modules for name, modules in below.items() if len(modules) > 1} == {}


def test_motion_is_a_property_of_the_joint() -> None:
    """Above the models nobody tells kinds of joint by their names: a new kind is a row of `KINDS`."""
    named = [
        f"{module}: {ast.unparse(node)}"
        for module, tree in _trees().items()
        if not module.startswith(("automaton.", "documents.", "learning."))
        for node in ast.walk(tree)
        if isinstance(node, ast.Compare) and "joint.kind" in ast.unparse(node.left)
        if {c.value for c in ast.walk(node) if isinstance(c, ast.Constant)} & set(JOINT_KINDS)
    ]
    assert named == []


def test_every_package_and_module_has_a_page_in_the_reference(repository: Path) -> None:
    pages = "\n".join(page.read_text(encoding="utf-8") for page in (repository / "docs" / "reference").glob("*.md"))
    documented = {line.removeprefix("::: ").strip() for line in pages.splitlines() if line.startswith("::: ")}
    top = {_full(module.split(".")[0]) for module in _trees() if module not in {"", "__main__"}}
    assert {
        name for name in top if name not in documented and not any(d.startswith(f"{name}.") for d in documented)
    } == set()


def test_no_two_test_files_have_one_name(repository: Path) -> None:
    """Folders of tests are no packages, so a second file of a name cannot be collected with the first."""
    names = [path.name for path in (repository / "tests").rglob("*.py") if path.name != "conftest.py"]
    assert sorted({name for name in names if names.count(name) > 1}) == []
