"""README and documentation say what is so: examples print what they show, commands work, links lead somewhere."""

from __future__ import annotations

import pkgutil
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path

import generate_reference
import make_gallery
import pytest
import write_outputs
from extras import requires
from write_outputs import PAGES, SHIPPED, Command

from micah_plan.documents.kind import schema
from micah_plan.learning.settings import LearnSettings

ROOT = Path(__file__).resolve().parents[1]
COMMANDS = (
    "demo",
    "new",
    "track",
    "learn",
    "solve",
    "explain",
    "execute",
    "predict",
    "calibrate",
    "explore",
    "diff",
    "sweep",
    "show",
    "convert",
    "check",
    "schema",
    "doctor",
)

NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?")


@dataclass(frozen=True)
class Block:
    """A fenced block of a page: its language and text."""

    language: str
    text: str


def text_of(page: str) -> str:
    return (ROOT / page).read_text(encoding="utf-8")


def blocks(page: str, *languages: str) -> list[Block]:
    found = re.findall(r"^```(\w*)[^\n]*\n(.*?)^```$", text_of(page), flags=re.MULTILINE | re.DOTALL)
    return [Block(language, text) for language, text in found if not languages or language in languages]


def printed_lines(code: str) -> Iterator[str]:
    """What an example shows as its output: comments after a print, and comment lines."""
    for line in code.splitlines():
        shown = re.match(r"\s*print\(.*\)  # (.*)$", line) or re.match(r"# (.*)$", line)
        if shown:
            yield shown.group(1)


def commands(page: str) -> list[Command]:
    return write_outputs.commands(text_of(page))


WITH_PYTHON = [page for page in PAGES if blocks(page, "python")]
WITH_COMMANDS = [page for page in PAGES if commands(page)]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory from which the shipped files are seen as from the root of the repository."""
    for name in SHIPPED:
        (tmp_path / name).symlink_to(ROOT / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def generated() -> dict[str, str]:
    """The pages that are made from definitions by their place below docs/."""
    return generate_reference.pages()


def test_the_tools_of_this_file_find_examples() -> None:
    assert "README.md" in WITH_PYTHON
    assert {"README.md", "docs/start.md"} <= set(WITH_COMMANDS)
    assert list(printed_lines("print(1)  # 1\nx = 2  # why\n# two\n")) == ["1", "two"]


@pytest.mark.sweep
@pytest.mark.parametrize("page", WITH_PYTHON)
@pytest.mark.usefixtures("workplace")
def test_python_examples_print_what_they_show(page: str, capsys: pytest.CaptureFixture[str]) -> None:
    namespace: dict[str, object] = {}
    expected = []
    for number, block in enumerate(blocks(page, "python"), start=1):
        exec(compile(block.text, f"{page}, example {number}", "exec"), namespace)  # noqa: S102
        expected += list(printed_lines(block.text))
    assert capsys.readouterr().out.splitlines() == expected


@pytest.mark.sweep
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_commands_have_known_names_and_options_and_read_shipped_files(page: str) -> None:
    for command in commands(page):
        name, *arguments = shlex.split(command.line)[1:]
        assert name in (*COMMANDS, "--help"), command
        known = generate_reference.help_text(*([] if name == "--help" else [name]))
        for argument in arguments:
            if argument.startswith("-"):
                assert re.search(rf"(^|\s|,){re.escape(argument)}(\s|,)", known), f"{argument} in: {command.line}"
            elif argument.startswith(SHIPPED):
                assert (ROOT / argument.partition(":")[0]).is_file(), argument  # FILE.py:CLASS


def test_pages_followed_in_one_folder_do_not_get_in_each_others_way() -> None:
    """`new` overwrites nothing, so a folder that two pages name would stop whoever follows both."""
    made: dict[str, set[str]] = {}
    for page in PAGES:
        for folder in re.findall(r"micah-plan new \w+ ([\w/]+)", text_of(page)):
            made.setdefault(folder, set()).add(page)
    assert {folder: sorted(pages) for folder, pages in made.items() if len(pages) > 1} == {}


def test_commands_named_in_the_text_exist() -> None:
    named = {page: set(re.findall(r"`micah-plan (\w+)", text_of(page))) - set(COMMANDS) for page in PAGES}
    assert {page: unknown for page, unknown in named.items() if unknown} == {}


def alike(shown: str, printed: str) -> bool:
    """Whether two outputs say the same: the same words, numbers close; times and the lengths of rules do not count.

    A number with a ± may differ by a tenth of that: what is known so little another processor rounds otherwise.
    Percentages may differ by two.
    """

    def lines(text: str) -> list[str]:
        kept = [re.sub("─+", "─", " ".join(line.split())) for line in text.splitlines()]
        return [line for line in kept if line and not line.startswith("time ")]

    def words(line: str) -> str:
        return NUMBER.sub("#", line)

    def values(line: str) -> list[tuple[float, float]]:
        line = re.sub(r" in [\d.]+ s$", "", line)
        found = list(NUMBER.finditer(line))
        after = [line[number.end() : number.end() + 3] for number in found]
        spreads = [abs(float(found[k + 1][0])) if text == " ± " else 0.0 for k, text in enumerate(after)]
        sizes = [abs(float(number[0])) + spread for number, spread in zip(found, spreads, strict=True)]
        bounds = [2.0 if text.startswith(" %") else 0.02 + 0.1 * size for text, size in zip(after, sizes, strict=True)]
        return [(float(number[0]), bound) for number, bound in zip(found, bounds, strict=True)]

    old, new = lines(shown), lines(printed)
    if [words(line) for line in old] != [words(line) for line in new]:
        return False
    pairs = [pair for a, b in zip(old, new, strict=True) for pair in zip(values(a), values(b), strict=True)]
    return all(abs(a - b) <= bound for (a, bound), (b, _) in pairs)


def test_outputs_are_compared_by_words_and_roughly_by_numbers() -> None:
    assert alike("learned 2 mode(s) in 1.63 s\n ───\nerror 0.10", "learned 2 mode(s) in 9.9 s\n ─────\nerror   0.11")
    assert not alike("error 0.10", "error 0.16")
    assert alike("turned by 2 ± 33°", "turned by 1 ± 34°")
    assert not alike("turned by 2 ± 3°", "turned by 1 ± 3°")
    assert alike("success 99.0 % of 20", "success 99.6 % of 20")
    assert not alike("success 95.3 % of 20", "success 99.6 % of 20")
    assert not alike("2 modes", "2 joints")


@requires("sim")
@pytest.mark.slow
@pytest.mark.parametrize("page", WITH_COMMANDS)
def test_commands_work_one_after_the_other_and_print_what_is_shown(page: str, workplace: Path) -> None:
    for command in commands(page):
        output = write_outputs.printed(command.line, workplace)  # fails if the command does
        if command.output is not None:
            assert alike(command.output, output), f"{command.line} now prints\n{output}"


def test_the_pages_made_from_definitions_are_stored_as_they_are_now(generated: dict[str, str]) -> None:
    stale = [place for place, text in generated.items() if text_of(f"docs/{place}").split() != text.split()]
    assert stale == [], "python docs/write_outputs.py"


def test_relative_links_and_images_lead_somewhere() -> None:
    dead = []
    for page in PAGES:
        prose = re.sub(r"^```.*?^```$", "", text_of(page), flags=re.MULTILINE | re.DOTALL)
        for target in re.findall(r"\]\(([^)\s]+)\)", prose):
            file = (ROOT / page).parent / target.partition("#")[0]
            if not re.match(r"[a-z]+:|#", target) and not file.exists():
                dead.append((page, target))
    assert dead == []


def test_cross_references_name_code_that_exists() -> None:
    """What `[text][micah_plan.place]` refers to can be imported; the built docs link it to the reference."""
    named = {(page, place) for page in PAGES for place in re.findall(r"\]\[(micah_plan[\w.]*)\]", text_of(page))}
    assert {page for page, _ in named} >= {"docs/glossary.md", "docs/concepts/joints.md"}
    assert [(page, place) for page, place in sorted(named) if not resolves(place)] == []


def resolves(place: str) -> bool:
    try:
        pkgutil.resolve_name(place)
    except (ImportError, AttributeError):
        return False
    return True


def test_every_page_is_in_the_navigation_and_every_concept_on_the_home_page() -> None:
    navigation, home = text_of("mkdocs.yml"), text_of("docs/index.md")
    pages = [page.removeprefix("docs/") for page in PAGES if page.startswith("docs/")]
    assert [page for page in pages if f": {page}\n" not in navigation] == []
    concepts = [page for page in pages if page.startswith("concepts/") or "/" not in page]
    assert [page for page in concepts if page != "index.md" and f"({page})" not in home] == []


def test_every_benchmark_named_in_the_docs_exists_and_takes_the_options_shown() -> None:
    """Commands `python -m benchmarks NAME ...`: it is there, and knows its options (it mentions them in its source)."""
    shown = [command for page in PAGES for command in re.findall(r"python -m benchmarks ([a-z][^`\n]*)", text_of(page))]
    assert len(shown) > 15
    for command in shown:
        name, *arguments = shlex.split(command, comments=True)
        source = text_of(f"benchmarks/{name}.py")
        assert [a for a in arguments if a.startswith("--") and f'"{a}"' not in source] == [], command


def benchmark(*arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "benchmarks", *arguments]
    return subprocess.run(command, capture_output=True, encoding="utf-8", cwd=ROOT, check=False)


def test_every_benchmark_is_listed_with_what_it_measures_and_has_its_table() -> None:
    listed = dict(re.split(r"  +", line, maxsplit=1) for line in benchmark().stdout.splitlines())
    assert all(sentence[-1] in ".?" for sentence in listed.values()), listed
    tables = "".join(text_of(page) for page in PAGES if page.startswith("benchmarks/tables/"))
    assert [name for name in listed if not re.search(rf"-m benchmarks {name}\b|benchmarks/{name}\.py", tables)] == []


@pytest.mark.slow
def test_a_benchmark_is_run_by_its_name() -> None:
    assert "usage: cycles.py" in benchmark("cycles", "--help").stdout
    unknown = benchmark("cylces")
    assert (unknown.returncode, unknown.stdout) == (2, "")
    assert unknown.stderr == "no benchmark is called 'cylces'; did you mean cycles?\n"


def test_generated_pages_link_to_places_of_their_own(generated: dict[str, str]) -> None:
    for place, text in generated.items():
        anchors = set(re.findall(r"\{#([\w-]+)\}", text))
        anchors |= {title.lower().replace(" ", "-") for title in re.findall(r"^## (.+)$", text, re.MULTILINE)}
        assert set(re.findall(r"\]\(#([\w-]+)\)", text)) <= anchors, place


@pytest.mark.sweep
@pytest.mark.parametrize("kind", ["model", "parts", "problem", "scene", "sweep", "experiment", "conventions", "plan"])
def test_the_page_on_a_file_has_every_key(kind: str, generated: dict[str, str]) -> None:
    described = schema(kind)
    page = generated[f"reference/{kind}_file.md"]
    for entry in (described, *described.get("$defs", {}).values()):
        for key, value in entry["properties"].items():
            assert re.search(rf"^\| `{key}` \| .+ \| .* \| {re.escape(value['description'])} \|$", page, re.MULTILINE)


def test_the_page_on_the_command_line_is_what_the_commands_print(generated: dict[str, str]) -> None:
    page = generated["reference/cli.md"]
    assert re.findall(r"^## (\w+)$", page, re.MULTILINE) == list(COMMANDS)
    done = subprocess.run(
        [sys.executable, "-m", "micah_plan", "solve", "--help"], capture_output=True, encoding="utf-8", check=True
    )
    told = done.stdout.partition("Arguments:")[2].split()
    assert told
    assert " ".join(told) in " ".join(page.split())


def test_the_page_on_learning_names_every_setting() -> None:
    _, _, section = text_of("docs/concepts/learning.md").partition("\n## Settings\n")
    rows = re.findall(r"^\| (`[^|]+`) \|", section.partition("\n## ")[0], re.MULTILINE)
    assert {name for row in rows for name in re.findall(r"`(\w+)`", row)} == {
        item.name for item in fields(LearnSettings)
    }


def test_the_gallery_has_every_problem_with_its_picture_and_task(repository: Path) -> None:
    page = (repository / "docs" / "gallery.md").read_text(encoding="utf-8")
    pictures = {path.stem for path in (repository / "docs" / "images" / "gallery").iterdir()}
    assert pictures == set(make_gallery.names())
    for name in make_gallery.names():
        assert f"images/gallery/{name}.webp)\n\n{make_gallery.task(name)}\n" in page
