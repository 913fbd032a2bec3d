"""Experiment files: what they say is what is carried out, and mistakes are told in one line."""

from __future__ import annotations

import pytest

from micah_plan.documents.experiment import experiment_text, load_experiment
from micah_plan.documents.model import dump_model, load_model
from micah_plan.errors import InputError


@pytest.fixture
def shipped(repository):
    return repository / "problems" / "experiments" / "drawer.yaml"


def test_what_is_written_is_read_again(shipped, tmp_path) -> None:
    experiment = load_experiment(shipped)
    assert experiment.repetitions == 3
    assert [len(motion.commands) for motion in experiment.motions] == [12, 12]
    assert experiment.motions[1].commands[0] == (-0.03,)
    (tmp_path / "models").mkdir()
    model = tmp_path / "models" / "model.yaml"
    dump_model(experiment.automaton, model)
    copy = tmp_path / "experiment.yaml"
    copy.write_text(experiment_text(experiment, model, copy, "tells apart"))
    assert copy.read_text().startswith("# tells apart\nformat: micah-plan/experiment/1\nmodel: models/model.yaml\n")
    assert load_experiment(copy) == experiment


def test_inputs_that_are_left_out_are_zero(repository, tmp_path) -> None:
    cabinet = load_model(repository / "models" / "cabinet.yaml")
    names = cabinet.input_names
    means = ", ".join(f"{name}: 0.1" for name in cabinet.coordinate_names)
    file = tmp_path / "experiment.yaml"
    text = f"""format: micah-plan/experiment/1
model: {repository / "models" / "cabinet.yaml"}
motions:
  - start: {{mean: {{{means}}}, std: {{{means}}}}}
    commands: {{{names[1]}: [0.01, 0.02]}}
"""
    file.write_text(text)
    (motion,) = load_experiment(file).motions
    assert motion.commands == ((0.0, 0.01), (0.0, 0.02))


@pytest.mark.parametrize(
    ("old", "new", "where", "told"),
    [
        ("repetitions: 3", "repetitions: 0", "repetitions", "expected a number >= 1, found 0"),
        ("      drawer: [0.03,", "      door: [0.03,", "motions.0.commands.door", "unknown input 'door'"),
        ("mean: {drawer: 0.2}", "mean: {drawer: 9.0}", "motions.1.start.mean", "lies in no mode's invariant"),
        ("drawer: [-0.03,", "drawer: [fast,", "motions.1.commands.drawer.0", "number"),
        ("models/drawer.yaml", "models/absent.yaml", "model", "absent.yaml"),
        ("drawer: [0.03,", "drawer: [30.0,", "motions.0.commands", "command 0 moves 'drawer' by 30 m, the whole range"),
        ("-0.03, -0.03, -0.03,", "-0.03, -899996.0, -0.03,", "motions.1.commands", "command 1 moves"),
        ("repetitions: 3", "repeat: 3", "repeat", "unknown key"),
    ],
)
def test_mistakes_are_reported(shipped, repository, tmp_path, old, new, where, told) -> None:
    text = shipped.read_text().replace("../../models", str(repository / "models"))
    assert old in text
    file = tmp_path / "experiment.yaml"
    file.write_text(text.replace(old, new))
    with pytest.raises(InputError) as caught:
        load_experiment(file)
    assert where in str(caught.value)
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_command_over_the_whole_range_is_an_experiment(shipped, repository, tmp_path) -> None:
    text = shipped.read_text().replace("../../models", str(repository / "models"))
    file = tmp_path / "experiment.yaml"
    file.write_text(text.replace("drawer: [0.03,", "drawer: [0.27,"))
    assert load_experiment(file).motions[0].commands[0] == (0.27,)


def test_inputs_need_equally_many_commands(repository, tmp_path) -> None:
    file = tmp_path / "experiment.yaml"
    file.write_text(
        f"""format: micah-plan/experiment/1
model: {repository / "models" / "drawer.yaml"}
motions:
  - start: {{mean: {{drawer: 0.1}}, std: {{drawer: 0.01}}}}
    commands: {{}}
"""
    )
    with pytest.raises(InputError, match="expected as many commands of each input, found none"):
        load_experiment(file)
