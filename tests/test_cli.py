"""The command line end to end on what the project ships: results, JSON keys, exit codes and one-line errors."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from micah_plan import cli
from micah_plan.api import inputs
from micah_plan.recording.read import read_recording


@pytest.fixture(scope="module")
def micah(repository):
    """Runs `micah-plan` with arguments in the repository and returns the finished process."""

    def run(*arguments, cwd=repository):
        command = [sys.executable, "-W", "error", "-m", "micah_plan", *map(str, arguments)]
        return subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)

    return run


def only_json(done):
    assert len(done.stdout.splitlines()) == 1, done.stdout
    return json.loads(done.stdout)


def only_error(done, code=2):
    """The single line of an error, after checking that there is nothing else: no traceback, no output."""
    assert done.returncode == code, done.stderr
    assert done.stdout == ""
    (line,) = done.stderr.splitlines()
    assert line.startswith("error: ")
    return line


@pytest.fixture(scope="module")
def road(micah, tmp_path_factory):
    """Learn, solve, execute and predict once, as a user would; the tests look at what came out."""
    folder = tmp_path_factory.mktemp("road")
    commands = {
        "learn": "learn examples/demonstrations/microwave.csv --parts models/parts/microwave.yaml"
        f" -o {folder}/model.yaml --figure {folder}/segments.png --html {folder}/recording.html --seed 3",
        "solve": f"solve problems/microwave_open.yaml --model {folder}/model.yaml -o {folder}/plan.json"
        f" --html {folder}/plan.html --figure {folder}/plan.png --seed 3",
        "execute": f"execute {folder}/plan.json --trials 2 -o {folder}/runs.csv --seed 3",
        "predict": f"predict {folder}/model.yaml {folder}/runs.csv",
    }
    return folder, {name: micah(*command.split(), "--json") for name, command in commands.items()}


@pytest.mark.slow
def test_every_step_of_the_road_ends_well(road):
    for name, done in road[1].items():
        assert done.returncode == 0, (name, done.stderr)
        assert done.stderr == "", name


def test_learn_reports_segments_and_writes_its_files(road):
    folder, done = road
    found = only_json(done["learn"])
    assert [segment["model"] for segment in found["segments"]] == ["revolute", "rigid"]
    assert found["segments"][0]["start"] == 0
    assert found["segments"][1]["start"] == found["changepoints"][0] == found["segments"][0]["end"] + 1
    assert found["segments"][0]["parameters"]["radius"] == pytest.approx(0.31, abs=0.01)
    assert {"seconds", "seed"} <= found.keys()
    assert (folder / "segments.png").read_bytes().startswith(b"\x89PNG")
    assert "<html" in (folder / "recording.html").read_text()


def test_solve_reports_a_verified_plan(road):
    folder, done = road
    found = only_json(done["solve"])
    assert found["outcome"] == "solved"
    assert found["modes"] == ["rigid", "revolute"]
    assert found["goal_error"] < 0.03
    assert found["success_probability"] > 0.9
    low, high = found["success_interval"]
    assert low < found["success_probability"] <= high
    assert {"total", "search", "optimise"} <= found["seconds"].keys()
    assert "<html" in (folder / "plan.html").read_text()


def test_execute_reports_trials_and_logs_a_recording(road):
    folder, done = road
    found = only_json(done["execute"])
    assert found["trials"] == 2
    assert found["successes"] + len(found["failures"]) == 2
    assert {"mean", "std", "max"} == found["final_error"].keys()
    runs = read_recording(folder / "runs.csv")
    assert runs.runs == (0, 1)
    assert runs.has_actions


def test_predict_reports_errors_per_run(road):
    found = only_json(road[1]["predict"])
    assert [run["run"] for run in found["per_run"]] == [0, 1]
    for kind in ("one_step", "rollout"):
        assert found[kind].keys() == {"position_rmse_m", "rotation_rmse_rad", "configuration_rmse"}
        assert 0 < found[kind]["configuration_rmse"] < 0.1


@pytest.mark.slow
def test_an_executed_run_can_be_learned_from(micah, road, tmp_path):
    runs = read_recording(road[0] / "runs.csv")
    assert len(runs) > 10
    found = only_json(micah("learn", road[0] / "runs.csv", "-o", tmp_path / "again.yaml", "--json"))
    assert "revolute" in [segment["model"] for segment in found["segments"]]


def test_show_writes_the_page_of_a_problem(micah, repository, tmp_path):
    done = micah("show", repository / "problems" / "microwave_close.yaml", "-o", tmp_path / "page.html", "--json")
    assert only_json(done)["kind"] == "problem"
    assert "NOT SOLVED YET" in (tmp_path / "page.html").read_text(encoding="utf-8")


@pytest.mark.sweep
@pytest.mark.parametrize("shown", ["model.yaml", "plan.json", "runs.csv"])
def test_show_writes_a_page(micah, road, shown, tmp_path):
    done = micah("show", road[0] / shown, "-o", tmp_path / "page.html", "--json")
    assert done.returncode == 0, done.stderr
    assert only_json(done)["bytes"] == len((tmp_path / "page.html").read_bytes())


@pytest.mark.slow
@pytest.mark.parametrize(
    "name",
    [
        *(pytest.param(name, marks=pytest.mark.evidence) for name in ("[/foo]", ":door:", "\u202erood")),
        "[link=http://x.y]door",
        "a\x1b[31mb",
    ],
)
def test_names_are_printed_as_they_are(micah, repository, tmp_path, name):
    rows = (repository / "examples" / "demonstrations" / "microwave.csv").read_text().splitlines()
    named = [rows[0], *(row.replace("door,", f"{name},", 1) for row in rows[1:])]
    (tmp_path / "named.csv").write_text("\n".join(named) + "\n", encoding="utf-8")
    done = micah("learn", tmp_path / "named.csv", "-o", tmp_path / "model.yaml")
    assert done.returncode in (0, 2), done.stderr
    printed = name.replace("\x1b", r"\x1b").replace("\u202e", r"\u202e")
    assert printed in done.stdout + done.stderr
    assert "\x1b" not in done.stdout + done.stderr


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(micah, road, tmp_path):
    micah("learn", "examples/demonstrations/microwave.csv", "--parts", "models/parts/microwave.yaml", "--seed", 3,
          "-o", tmp_path / "model.yaml")  # fmt: skip
    assert (tmp_path / "model.yaml").read_bytes() == (road[0] / "model.yaml").read_bytes()
    micah("solve", "problems/microwave_open.yaml", "--model", road[0] / "model.yaml", "--seed", 3,
          "-o", tmp_path / "plan.json", "--html", tmp_path / "plan.html")  # fmt: skip
    assert (tmp_path / "plan.json").read_bytes() == (road[0] / "plan.json").read_bytes()
    assert (tmp_path / "plan.html").read_bytes() == (road[0] / "plan.html").read_bytes()
    micah("execute", road[0] / "plan.json", "--trials", 2, "--seed", 3, "-o", tmp_path / "runs.csv")
    assert (tmp_path / "runs.csv").read_bytes() == (road[0] / "runs.csv").read_bytes()


@pytest.fixture
def edited(repository, tmp_path):
    """A copy of the drawer problem with one text replaced by another."""

    def edit(old, new):
        text = (repository / "problems" / "drawer_open.yaml").read_text()
        assert old in text
        text = text.replace("../models", str(repository / "models")).replace(old, new)
        path = tmp_path / "problem.yaml"
        path.write_text(text)
        return path

    return edit


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("tolerance", "tolerence", ["key 'goal.target.drawer.tolerence'", "tolerance"]),
        ("drawer.yaml", "drawers.yaml", ["key 'model'", "drawers.yaml", "does not exist"]),
        ("value: 0.25", "value: 2.5", ["key 'goal.target.drawer.value'", "2.5", " m"]),
        ("mean: {drawer: 0.03}", "mean: {drawer: -3}", ["start.mean", "-3"]),
    ],
    ids=["typo", "missing file", "goal out of range", "start in no mode"],
)
def test_a_bad_problem_is_one_line_with_problem_and_place(micah, edited, tmp_path, old, new, said):
    problem = edited(old, new)
    line = only_error(micah("solve", problem, "-o", tmp_path / "plan.json"))
    assert str(problem) in line
    assert ", line " in line
    for words in said:
        assert words in line
    assert not (tmp_path / "plan.json").exists()


@pytest.mark.slow
def test_without_a_plan_the_exit_code_is_1(micah, tmp_path, repository):
    model = (repository / "models" / "microwave.yaml").read_text()
    before, latch = model.split("  - source: rigid\n")
    (tmp_path / "stuck.yaml").write_text(before + latch[latch.index("noise:\n") :])
    assert "target: revolute" in latch
    done = micah("solve", repository / "problems" / "microwave_open.yaml", "--model", tmp_path / "stuck.yaml", "--json",
                 "-o", tmp_path / "plan.json", "--html", tmp_path / "plan.html")  # fmt: skip
    assert done.returncode == 1
    found = only_json(done)
    assert found["outcome"] == "no_plan"
    assert "rigid" in found["reason"]
    assert "NO PLAN" in (tmp_path / "plan.html").read_text().upper()
    line = only_error(micah("execute", tmp_path / "plan.json", "-o", tmp_path / "runs.csv"))
    assert "no_plan" in line
    explained = micah("explain", tmp_path / "plan.json", "--json")
    assert explained.returncode == 1
    told = only_json(explained)
    assert told["level"] == "search"
    assert told["findings"] == found["findings"]
    assert told["findings"][0]["code"] == "no_transition_to_goal"
    assert "add the missing transition to the model" in told["findings"][0]["remedy"]
    assert told["lines"] == micah("explain", tmp_path / "plan.json").stdout.splitlines()


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("learn", "nowhere.csv", "-o", "model.yaml"), ["nowhere.csv", "does not exist"]),
        (("learn", "examples/demonstrations/microwave.csv", "-o", "no/such/model.yaml"), ["no/such", "directory"]),
        (
            ("predict", "models/drawer.yaml", "examples/demonstrations/microwave.csv"),
            ["microwave.csv", "drawer", "door"],
        ),
        (("predict", "models/parts/drawer.yaml", "examples/demonstrations/drawer.csv"), ["parts/drawer.yaml", "model"]),
        (("execute", "models/drawer.yaml", "-o", "runs.csv"), ["drawer.yaml"]),
        (("show", "README.md", "-o", "page.html"), ["README.md"]),
    ],
)
def test_bad_arguments_are_one_line(micah, repository, arguments, said):
    line = only_error(micah(*arguments))
    for words in said:
        assert words in line
    assert not (repository / "runs.csv").exists()
    assert not (repository / "page.html").exists()


@pytest.mark.slow
def test_an_error_is_json_too_on_request(micah):
    done = micah("learn", "nowhere.csv", "-o", "model.yaml", "--json")
    assert done.returncode == 2
    said = only_json(done)
    assert "nowhere.csv" in said["error"]
    (error,) = said["errors"]
    assert error["message"] == said["error"]
    assert error["source"].endswith("nowhere.csv")
    assert (error["problem"], error["line"]) == ("the file does not exist", None)
    assert error["remedy"]


def test_version_and_help(micah):
    assert micah("--version").stdout.strip()
    for command in ("learn", "solve", "execute", "predict", "show"):
        assert command in micah("--help").stdout


def demonstration(repository, path, rows=None, part="door"):
    """The first rows of the microwave's demonstration (all: None), with its part renamed."""
    lines = (repository / "examples/demonstrations/microwave.csv").read_text().splitlines()
    kept = lines if rows is None else lines[: rows + 1]
    path.write_text("\n".join([kept[0], *(part + line.removeprefix("door") for line in kept[1:])]) + "\n")
    return path


@pytest.mark.sweep
@pytest.mark.parametrize("rows", [1, 2, 4])
def test_too_few_rows_to_learn_from_are_one_line_but_can_be_shown(micah, repository, tmp_path, rows):
    short = demonstration(repository, tmp_path / "short.csv", rows)
    line = only_error(micah("learn", short, "-o", tmp_path / "model.yaml"))
    for words in ("short.csv", "part 'door'", "at least 5 rows", f"found {rows}"):
        assert words in line
    assert not (tmp_path / "model.yaml").exists()
    if rows == 4:
        assert only_json(micah("show", short, "-o", tmp_path / "page.html", "--json"))["kind"] == "recording"


@pytest.mark.slow
def test_the_fewest_rows_suffice_to_learn(micah, repository, tmp_path):
    short = demonstration(repository, tmp_path / "short.csv", 5)
    assert only_json(micah("learn", short, "-o", tmp_path / "model.yaml", "--json"))["segments"]


@pytest.mark.slow
@pytest.mark.parametrize(("command", "written"), [("learn", "out.yaml"), ("show", "out.html")])
def test_a_part_named_as_the_base_is_refused_not_hidden(micah, repository, tmp_path, command, written):
    recording = demonstration(repository, tmp_path / "named.csv", 8, part="base")
    line = only_error(micah(command, recording, "-o", tmp_path / written))
    for words in ("named.csv, column 'part'", "'base'", "another name"):
        assert words in line
    assert not (tmp_path / written).exists()


@pytest.mark.slow
def test_a_recording_of_another_object_does_not_fit_the_model(micah, repository, tmp_path):
    header, *rows = demonstration(repository, tmp_path / "other.csv").read_text().splitlines()
    reversed_rows = [row.split(",") for row in rows]
    for row in reversed_rows:  # half a turn about the vertical: out of the range of the door
        row[2], row[3] = str(-float(row[2])), str(-float(row[3]))
        qx, qy, qz, qw = (float(value) for value in row[5:9])
        row[5:9] = map(str, (-qy, qx, qw, -qz))
    (tmp_path / "other.csv").write_text("\n".join([header, *(",".join(row) for row in reversed_rows)]) + "\n")
    line = only_error(micah("predict", "models/microwave.yaml", tmp_path / "other.csv"))
    for words in ("other.csv", "run 0 does not fit the model", "door = ", " rad", "allows door ", "take the model"):
        assert words in line


@pytest.mark.slow
def test_a_list_is_no_plan(micah, tmp_path):
    (tmp_path / "list.json").write_text("[1, 2]")
    line = only_error(micah("show", tmp_path / "list.json", "-o", tmp_path / "page.html"))
    assert "list.json: expected a plan, found a list of 2" in line


@pytest.mark.slow
def test_no_output_overwrites_what_an_input_names(micah, tmp_path, repository):
    (tmp_path / "problems").mkdir()
    for name in ("models/microwave.yaml", "problems/microwave_close.yaml"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text((repository / name).read_text())
    scene = (repository / "problems" / "explore_handle.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(scene.replace("microwave_open.yaml", "problems/microwave_close.yaml"))
    before = (tmp_path / "models" / "microwave.yaml").read_text()
    for arguments in (
        ("explore", "scene.yaml", "-o", "models/microwave.yaml"),
        ("calibrate", "problems/microwave_close.yaml", "runs.csv", "-o", "models/microwave.yaml"),
    ):
        assert "-o would overwrite an input" in only_error(micah(*arguments, cwd=tmp_path))
    assert (tmp_path / "models" / "microwave.yaml").read_text() == before


@pytest.mark.slow
def test_what_the_system_refuses_is_one_line(micah):
    assert "file name too long; give a shorter path" in only_error(micah("check", "a" * 10_000 + ".csv"))


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("learn in.csv -o in.csv", "in.csv: -o would overwrite an input"),
        ("learn in.csv -o link.csv", "link.csv: -o would overwrite an input"),
        ("learn in.csv --parts parts.yaml -o ./parts.yaml", "parts.yaml: -o would overwrite an input"),
        ("learn in.csv -o same.yaml --html ../{folder}/same.yaml", "-o and --html would write the same file"),
        ("solve problem.yaml -o problem.yaml", "problem.yaml: -o would overwrite an input"),
        ("solve problem.yaml --model parts.yaml -o plan.json --html parts.yaml", "--html would overwrite an input"),
        ("solve plan.timings.json -o plan.json", "plan.timings.json: the times of -o would overwrite an input"),
        ("execute plan.json -o plan.json", "plan.json: -o would overwrite an input"),
        ("show plan.json -o plan.json", "plan.json: -o would overwrite an input"),
        ("learn in.csv -o new.txt", "new.txt: -o must end in .yaml or .yml, found '.txt'"),
        ("learn in.csv -o new.yaml --figure new.pdf", "new.pdf: --figure must end in .png, found '.pdf'"),
        ("learn in.csv -o new.yaml --html new", "new: --html must end in .html, found ''"),
        ("solve problem.yaml -o new.yaml", "new.yaml: -o must end in .json, found '.yaml'"),
        ("execute plan.json -o new.tum", "new.tum: -o must end in .csv or .npz, found '.tum'"),
        ("execute plan.json -o new.csv --figure new.jpg", "new.jpg: --figure must end in .png"),
        ("show plan.json -o new.json", "new.json: -o must end in .html, found '.json'"),
        ("show plan.json -o .", "found a directory"),
    ],
)
def test_outputs_never_destroy_files_or_have_the_wrong_kind(micah, tmp_path, arguments, said):
    for name in ("in.csv", "parts.yaml", "problem.yaml", "plan.json"):
        (tmp_path / name).write_text(f"what {name} holds")  # refused before it is read
    (tmp_path / "link.csv").symlink_to("in.csv")
    before = {path.name: path.read_text() for path in tmp_path.iterdir()}
    line = only_error(micah(*arguments.format(folder=tmp_path.name).split(), cwd=tmp_path))
    assert said in line
    assert {path.name: path.read_text() for path in tmp_path.iterdir()} == before


@pytest.mark.sweep
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("learn x.csv", "missing option '-o' / '--output'; see micah-plan learn --help"),
        ("solve", "missing argument"),
        ("learn x.csv -o x.yaml --method foo", "'--method': 'foo' is not one of 'act-champ', 'champ'"),
        ("learn x.csv -o x.yaml --seed -1", "'--seed'"),
        ("execute x.json -o x.csv --trials 0", "'--trials'"),
        ("predict a.yaml b.csv c.csv", "unexpected extra argument"),
        ("lern x.csv", "no such command 'lern'"),
        ("learn x.csv -o x.yaml --colour", "no such option: --colour"),
    ],
)
def test_wrong_usage_is_one_line_and_json_on_request(micah, tmp_path, arguments, said):
    line = only_error(micah(*arguments.split(), cwd=tmp_path))
    assert said in line
    done = micah(*arguments.split(), "--json", cwd=tmp_path)
    assert done.returncode == 2
    assert line == "error: " + only_json(done)["error"]


@pytest.mark.slow
def test_help_is_shown_without_arguments_and_for_commands(micah):
    done = micah()
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == micah("--help").stdout
    for command in ("learn", "solve", "execute", "predict", "show"):
        done = micah(command, "--help")
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout.startswith(f"Usage: micah-plan {command} ")


@pytest.fixture
def stopped(monkeypatch, capsys):
    """Runs `learn --json` in this process, with an exception raised while it reads, and returns what it printed."""

    def run(raised, expected):
        def fail(*_, **__):
            raise raised

        monkeypatch.setattr(inputs, "demonstration_of", fail)
        monkeypatch.setattr(sys, "argv", ["micah-plan", "learn", "x.csv", "-o", os.devnull + ".yaml", "--json"])
        monkeypatch.setattr(sys, "excepthook", sys.excepthook)  # typer puts its own there
        with pytest.raises(expected) as caught:
            cli.main()
        return caught.value, capsys.readouterr()

    return run


def test_an_interrupt_is_shown_by_its_exit_code(stopped):
    ended, printed = stopped(KeyboardInterrupt(), SystemExit)
    assert ended.code == 130
    assert "interrupted" in json.loads(printed.out)["error"]
    assert printed.err.startswith("error: interrupted")


def test_an_interrupt_while_a_compiled_module_is_loaded_is_no_bug(stopped):
    failed = ImportError("initialization failed")
    failed.__cause__ = KeyboardInterrupt()
    ended, printed = stopped(failed, SystemExit)
    assert ended.code == 130
    assert printed.err.startswith("error: interrupted")
    assert stopped(ImportError("initialization failed"), SystemExit)[0].code == 70


def test_an_unexpected_exception_is_reported_as_a_bug(stopped):
    ended, printed = stopped(RuntimeError("no such\nthing"), SystemExit)
    assert ended.code == 70
    assert "this is a bug" in json.loads(printed.out)["error"]
    line, *trace = printed.err.splitlines()
    assert trace[0].startswith("Traceback")
    assert line.startswith("error: RuntimeError: no such thing; this is a bug")


_INTERRUPT = """
import sys
class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            raise HOW
sys.meta_path.insert(0, Interrupt())
from micah_plan.cli import main
main()
"""


@pytest.mark.parametrize("how", ["KeyboardInterrupt", "ImportError from KeyboardInterrupt()"])
def test_an_interrupt_while_libraries_are_loaded_is_one_line(how: str) -> None:
    script = _INTERRUPT.replace("HOW", how)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, "")
    assert done.stderr == "error: interrupted; no file was left half-written\n"
    command = [sys.executable, "-c", script, "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (130, '{"error": "interrupted; no file was left half-written"}\n')
