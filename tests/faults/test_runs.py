"""Runs, comparisons, sessions and the digging experiment survive every interruption, and resume as what they were."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from tests.faults import cases
from tests.fitted import fitted_once  # noqa: F401
from tests.motions import Short
from torchds import files
from torchds.errors import FileError, InvalidArgumentError, TorchdsError
from torchds.locks import one_writer
from torchds.monitor.events import NAME
from train import __main__ as train_main
from train.folder import RunFolder
from train.learning import run as run_module
from train.learning.history import History
from train.learning.learner import Learner
from train.options import RunOptions, options_for

ROOT = Path(__file__).parents[2]
GIVEN = {"runs": 2, "updates": 3, "rollouts": 4}
KILLS = min(300, cases.CASES) or 3
"""Interruptions of each command and kind in `make fuzz`, and in a run of the tests, which has one kind for each command."""
COMMANDS, FAULTS = ("run", "compare", "session", "digging"), ("kill", "full", "broken", "read-only")
USUAL = (("run", "kill"), ("compare", "broken"), ("session", "read-only"), ("digging", "kill"))
PAIRS = [(command, fault) for command in COMMANDS for fault in FAULTS] if cases.CASES else USUAL


def shorten(monkeypatch):
    """One short letter, no pictures, and a checkpoint after every update."""
    short = Short()
    monkeypatch.setattr(RunOptions, "make_task", lambda options: short)
    monkeypatch.setattr(run_module.figures, "of_run", lambda learner: {})
    monkeypatch.setattr(run_module, "SAVE_EVERY", 0.0)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    shorten(monkeypatch)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A finished run, which no test touches."""
    with pytest.MonkeyPatch.context() as monkeypatch:
        shorten(monkeypatch)
        return run_module.run(options_for("via_point", **GIVEN, logdir=tmp_path_factory.mktemp("made")))


@pytest.fixture
def finished(made, tmp_path):
    """A copy of it: a run may be moved."""
    return Path(shutil.copytree(made, tmp_path / "via_point" / "pibb" / made.name))


def resume(folder, **given):
    return run_module.run(options_for("via_point", resume=folder, **given))


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.name != ".lock"}


def steps(folder):
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    return {
        tag: [event.step for event in events.Scalars(tag)] for tag in events.Tags()["scalars"] if "hparam" not in tag
    }


@pytest.mark.slow
def test_interrupted_at_any_write_and_typed_again_a_command_ends_as_if_nothing_had_happened():
    """All in one process, which imports everything once; it finds no OpenGL library, which stops nothing that draws nothing."""
    typed = [argument for command, fault in PAIRS for argument in (command, str(KILLS), fault)]
    command = [sys.executable, "-m", "tests.faults.killer", *typed]
    environment = {**os.environ, "MUJOCO_GL": "osmesa"}
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment)
    rows = [line.split(" | ") for line in ended.stdout.splitlines() if line.startswith("| ")]
    for name, calls, fault, tried, *_ in rows:
        cases.TRIED[f"{name[2:]} at {calls} writes, {fault}"] += int(tried)
    assert [(row[0][2:], row[2], row[3], row[4]) for row in rows] == [
        (command, fault, str(KILLS), "0") for command, fault in PAIRS
    ], ended.stdout + ended.stderr
    assert ended.returncode == 0


# ------------------------------------------------------------------ TensorBoard


@pytest.mark.slow
def test_a_finished_run_that_is_resumed_is_left_as_it_is(finished, capsys):
    before = contents(finished)
    resume(finished)
    assert contents(finished) == before and "all 3 updates are made, nothing is changed" in capsys.readouterr().out


@pytest.mark.slow
def test_a_run_that_is_extended_goes_on_and_tensorboard_has_each_update_once(finished, tmp_path, capsys):
    resume(finished, updates=5)
    assert (
        "3 updates are made, goes on to 5; the noise keeps the decay that it was begun with" in capsys.readouterr().out
    )
    found = steps(finished)
    assert found["cost/total"] == [0, 4, 8, 12, 16, 20] and found["time/update_seconds"] == [4, 8, 12, 16, 20]
    record = RunFolder(finished).results()
    assert record["options"]["updates"] == 5 and len(record["cost"]) == 6
    straight = run_module.run(options_for("via_point", **{**GIVEN, "updates": 5}, logdir=tmp_path / "straight"))
    assert RunFolder(straight).results()["cost"] == record["cost"]  # the decay of this task does not know the end


@pytest.mark.slow
def test_events_that_were_lost_are_made_again_from_the_history(finished, capsys):
    (finished / "results.json").unlink()
    (finished / NAME).write_bytes(b"")
    resume(finished)
    assert steps(finished)["cost/total"] == [0, 4, 8, 12] and "was cut or lost" in capsys.readouterr().err


@pytest.mark.slow
def test_events_after_the_checkpoint_are_written_again_once(finished):
    (finished / "results.json").unlink()
    with (finished / NAME).open("ab") as file:
        file.write(b"half a record")
    resume(finished)
    assert steps(finished)["cost/total"] == [0, 4, 8, 12]


# ------------------------------------------------------------------ whose a run is


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seed": 4}, r"cannot take --seed 4 \(it was 0\)"),
        ({"optimizer": "pi2", "runs": 3}, r"cannot take --runs 3 \(it was 2\), --optimizer pi2 \(it was pibb\)"),
        ({"updates": 2}, r"has made 3 already; give more, or none"),
    ],
)
@pytest.mark.slow
def test_options_that_contradict_are_refused_and_nothing_is_changed(finished, given, words):
    before = contents(finished)
    with pytest.raises(InvalidArgumentError, match=words):
        resume(finished, **given)
    assert contents(finished) == before


@pytest.mark.slow
def test_an_option_that_is_said_with_its_usual_value_contradicts_too(tmp_path):
    folder = run_module.run(options_for("via_point", **GIVEN, seed=5, logdir=tmp_path))
    with pytest.raises(InvalidArgumentError, match=r"--seed 0 \(it was 5\)"):
        run_module.run(options_for("via_point", resume=folder), given=train_main.given(["--seed", "0"]))


def test_a_run_of_another_task_names_the_command(finished):
    with pytest.raises(
        InvalidArgumentError, match="is a run of via_point, not of two_starts; continue it with: python"
    ):
        run_module.run(options_for("two_starts", resume=finished))


@pytest.mark.parametrize(
    "changed", [{"seed": 1}, {"optimizer": "surrogate"}, {"exploration": "gaussian"}, {"runs": 3}, {"rollouts": 5}]
)
@pytest.mark.slow
def test_the_checkpoint_of_another_run_is_refused_by_what_differs(finished, tmp_path, changed):
    other = run_module.run(options_for("via_point", **{**GIVEN, **changed}, logdir=tmp_path / "other"))
    shutil.copy(other / "checkpoint.pt", finished / "checkpoint.pt")
    before = contents(finished)
    with pytest.raises(FileError, match=f"checkpoint.pt belongs to another run: .*{next(iter(changed))}"):
        resume(finished)
    assert contents(finished) == before


def altered(folder, change):
    """Write a checkpoint whose digest is right and whose content is not."""
    content = files.load(folder / "checkpoint.pt", "checkpoint")
    change(content)
    files.save(folder / "checkpoint.pt", "checkpoint", content)
    (folder / "results.json").unlink()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda c: c["learner"].update(history={**vars(History())}), "holds an empty history"),
        (lambda c: c["learner"]["history"]["cost"].pop(), "columns or lines are missing"),
        (lambda c: c["learner"]["policy"].update(A=c["learner"]["policy"]["A"][:1]), "does not fit this run"),
        (lambda c: c["learner"].pop("noise"), "KeyError: 'noise'"),
        (
            lambda c: c["learner"]["initial"].update(A=c["learner"]["initial"]["A"] + 1),
            "demonstrations or mixture have ch",
        ),
        (lambda c: c.pop("learner"), "no learner in it"),
    ],
)
@pytest.mark.slow
def test_a_checkpoint_that_does_not_fit_is_refused_by_name(finished, change, words):
    altered(finished, change)
    before = contents(finished)
    with pytest.raises(FileError, match=words):
        resume(finished)
    assert contents(finished) == before


@pytest.mark.slow
def test_versions_that_differ_are_said(finished, capsys):
    altered(finished, lambda content: content["versions"].update(torch="1.0"))
    resume(finished)
    assert "checkpoint.pt was written with torch 1.0, here" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"elite": "worst"}, "option elite cannot be 'worst'; it has to be 'none' or 'nominal' or 'best' or nothing"),
        ({"runs": "two"}, "option runs cannot be 'two'; it has to be a whole number"),
        ({"optimizer": "pibbb"}, "unknown optimizer 'pibbb'. Did you mean 'pibb'"),
        ({"colour": 1}, "unknown option of via_point 'colour'"),
    ],
)
def test_unknown_options_in_a_folder_are_refused_by_name(finished, change, words):
    content = json.loads((finished / "options.json").read_text())
    content.pop("digest")
    files.write_sealed(finished / "options.json", {**content, "options": {**content["options"], **change}})
    with pytest.raises(TorchdsError, match=words):
        resume(finished)


def test_options_changed_by_hand_are_refused(finished):
    path = finished / "options.json"
    path.write_text(path.read_text().replace('"rollouts": 4', '"rollouts": 5'))
    with pytest.raises(FileError, match="damaged, or was changed by hand"):
        resume(finished)


def test_options_of_an_older_version_are_read(finished, made):
    path = finished / "options.json"
    content = json.loads(path.read_text())
    content["options"].pop("cost_noise")
    path.write_text(json.dumps({name: content[name] for name in ("task", "options")}))
    assert RunFolder(finished).options() == options_for("via_point", **GIVEN, logdir=made.parents[2])


@pytest.mark.slow
def test_a_checkpoint_of_an_older_version_is_refused_by_name(finished):
    import torch

    torch.save({"policy": {}}, finished / "checkpoint.pt")
    with pytest.raises(FileError, match="by a version before files were verified"):
        resume(finished)


# ------------------------------------------------------------------ one writer, and the disk


def test_the_second_one_is_told_who_works_there(finished):
    with one_writer(finished), pytest.raises(FileError, match=r"is in use by process \d+ on .* since 20"):
        resume(finished)


@pytest.mark.parametrize("seed", [-1, 2**63, 2**64, 2**80])
def test_seeds_that_no_generator_takes_are_refused(seed, tmp_path):
    with pytest.raises(InvalidArgumentError, match=f"--seed has to be a whole number from 0 to .* got {seed}"):
        run_module.run(options_for("via_point", seed=seed, logdir=tmp_path))


@pytest.mark.slow
def test_results_are_json_whatever_diverged(tmp_path, monkeypatch):
    monkeypatch.setattr(Learner, "evaluate", lambda learner: {"goal": learner.policy.A.new_full((2,), float("nan"))})
    folder = run_module.run(options_for("via_point", **GIVEN, logdir=tmp_path))

    def refuse(name):
        raise AssertionError(f"{name} is no JSON")

    json.loads((folder / "results.json").read_text(), parse_constant=refuse)
    cost = RunFolder(folder).results()["cost"]
    assert len(cost) == 4 and all(value != value for row in cost for value in row)


@pytest.mark.parametrize("logdir", ["/proc/nowhere", "/dev/null/logs"])
@pytest.mark.slow
def test_a_place_that_cannot_be_written_is_one_line_and_exit_code_2(logdir, capsys):
    options = options_for("via_point", **GIVEN, logdir=Path(logdir))
    assert train_main.ended(lambda: run_module.run(options)) == 2
    said = capsys.readouterr().err
    assert said.startswith("error: the folder /") and said.count("\n") == 1 and "Traceback" not in said
