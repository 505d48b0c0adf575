import json
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from matplotlib.figure import Figure
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensorboard.plugins.hparams.metadata import parse_session_start_info_plugin_data

from tests.motions import Short
from torchds.errors import InvalidArgumentError
from train.folder import RunFolder
from train.learning import run as run_module
from train.learning.learner import Learner
from train.learning.run import resuming, run
from train.options import options_for

ROOT = Path(__file__).parents[3]


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    return run(options_for("via_point", runs=2, updates=4, rollouts=5, logdir=tmp_path_factory.mktemp("logs")))


def costs(folder):
    return json.loads((folder / "results.json").read_text())["cost"]


@pytest.mark.slow
def test_a_run_leaves_all_that_it_promises(finished):
    results = json.loads((finished / "results.json").read_text())
    assert set(results) >= {"task", "options", "versions", "rollouts", "cost", "terms", "seconds"}
    assert results["rollouts"] == [0, 5, 10, 15, 20]
    assert [len(row) for row in results["cost"]] == [2] * 5
    for update in range(5):
        for r in range(2):
            parts = sum(term[update][r] for term in results["terms"].values())
            assert results["cost"][update][r] == pytest.approx(parts, rel=1e-12)
    assert finished.parent.parts[-2:] == ("via_point", "pibb")
    for name in ("options.json", "checkpoint.pt", "policy.pt", "motion.png", "learning_curves.png"):
        assert (finished / name).stat().st_size > 0
    assert not list(finished.glob("*.part"))


@pytest.mark.slow
def test_tensorboard_has_scalars_figures_and_hparams(finished):
    events = EventAccumulator(str(finished), size_guidance={"images": 0, "scalars": 0}).Reload()
    scalars = set(events.Tags()["scalars"])
    assert scalars >= {"cost/total", "cost/via_points", "cost/control", "exploration/lr", "weights/entropy"}
    assert scalars >= {"rollouts/failed", "time/update_seconds", "cost/tried_q1", "rollouts/updates"}
    assert len(events.Scalars("cost/total")) == 5
    assert set(events.Tags()["images"]) == {"motion", "learning_curves"}
    start = parse_session_start_info_plugin_data(
        events.SummaryMetadata("_hparams_/session_start_info").plugin_data.content
    )
    assert {name: value.string_value for name, value in start.hparams.items()} == {
        "task": "via_point",
        "optimizer": "pibb",
        "exploration": "homogeneous",
        "seed": "0",
        "runs": "2",
        "updates": "4",
        "rollouts": "5",
    }
    assert "custom_scalars__config__" in events.summary_metadata


@pytest.mark.slow
def test_a_run_of_ten_updates_shows_its_motion_at_each_tenth_over_rollouts(undrawn, tmp_path):
    folder = run(options_for("via_point", runs=2, updates=20, rollouts=3, logdir=tmp_path))
    events = EventAccumulator(str(folder), size_guidance={"images": 0, "scalars": 0}).Reload()
    assert [picture.step for picture in events.Images("trial/motion")] == list(range(0, 61, 6))
    assert [scalar.step for scalar in events.Scalars("cost/total")] == list(range(0, 61, 3))
    assert [scalar.value for scalar in events.Scalars("rollouts/updates")] == list(range(21))


@pytest.mark.slow
def test_equal_seeds_give_equal_results_and_other_seeds_do_not(finished, undrawn, tmp_path):
    options = options_for("via_point", runs=2, updates=4, rollouts=5, logdir=tmp_path)
    assert costs(run(options)) == costs(finished)
    options.seed = 1
    assert costs(run(options))[1:] != costs(finished)[1:]


@pytest.mark.parametrize(("noise", "runs"), [(0.0, 1), (0.1, 3)])
@pytest.mark.slow
def test_where_nothing_is_random_one_run_stands_for_all(noise, runs, undrawn, tmp_path, capsys):
    folder = run(options_for("via_point", runs=3, updates=1, optimizer="adam", cost_noise=noise, logdir=tmp_path))
    assert [len(row) for row in costs(folder)] == [runs, runs]
    said = "nothing is random with --optimizer adam; one run stands for all 3" in capsys.readouterr().out
    assert said == (runs == 1)


@pytest.mark.slow
def test_a_command_whose_runs_are_one_can_be_given_again(undrawn, tmp_path, capsys):
    options = options_for("via_point", runs=3, updates=1, rollouts=2, optimizer="adam", folder=tmp_path / "mine")
    first = costs(run(options, given={"optimizer", "runs", "updates", "rollouts", "folder"}))
    assert costs(run(options, given={"optimizer", "runs", "updates", "rollouts", "folder"})) == first
    assert "all 1 updates are made, nothing is changed" in capsys.readouterr().out
    options.cost_noise = 0.1
    with pytest.raises(InvalidArgumentError, match=r"cannot take --cost-noise 0\.1 \(it was 0\.0\)"):
        run(options)


@pytest.mark.slow
def test_more_runs_of_what_is_random_are_refused(undrawn, tmp_path):
    folder = run(options_for("via_point", updates=0, logdir=tmp_path))
    with pytest.raises(InvalidArgumentError, match=r"cannot take --runs 3 \(it was 1\)"):
        run(options_for("via_point", runs=3, resume=folder))


@pytest.mark.slow
def test_a_primitive_leaves_figures_and_no_policy_file(tmp_path, request):
    folder = run(options_for("via_point", system="dmp", runs=2, updates=2, logdir=tmp_path))
    assert (folder / "motion.png").exists() and not (folder / "policy.pt").exists()
    request.getfixturevalue("undrawn")
    extended = run(options_for("via_point", resume=folder, updates=3), given={"resume", "updates"})
    assert len(costs(extended)) == 4


@pytest.mark.slow
def test_runs_of_one_batch_differ(finished):
    assert len(set(costs(finished)[-1])) == 2


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"runs": 0}, "--runs has to be at least 1, got 0"),
        ({"updates": -1}, "--updates has to be at least 0, got -1"),
        ({"rollouts": 0}, "--rollouts has to be at least 1, got 0"),
        ({"noise": -0.1}, "mean_speed has to be finite and ≥ 0, got -0.1"),
        ({"resume": Path("nowhere")}, "--resume nowhere: no options.json there"),
    ],
)
@pytest.mark.slow
def test_wrong_options_are_refused_before_a_folder_is_made(options, words, tmp_path):
    with pytest.raises(InvalidArgumentError, match=words):
        run(options_for("via_point", logdir=tmp_path, **options))
    assert not list(tmp_path.iterdir())


def test_a_command_that_goes_on_with_a_run_is_read_by_a_shell_as_it_was_meant(tmp_path):
    folder = RunFolder(tmp_path / "my runs" / "it's one")
    command = ["python", "-m", "train", "my task.json", "--resume", str(folder.path)]
    assert shlex.split(resuming("my task.json", folder)) == command


@pytest.mark.slow
def test_a_wrong_option_of_the_command_is_one_line_and_exit_code_2():
    command = [sys.executable, "-m", "train", "via_point", "--mixture", "nowhere.npz"]
    ended = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert ended.returncode == 2
    assert ended.stderr.strip().startswith("error: nowhere.npz: no such file")
    assert "Traceback" not in ended.stderr


@pytest.mark.slow
def test_zero_updates_leave_the_imitated_policy(tmp_path):
    assert len(costs(run(options_for("via_point", updates=0, logdir=tmp_path)))) == 1


@pytest.mark.parametrize("exploration", ["homogeneous", "gaussian"])
@pytest.mark.parametrize("decay", ["inverse", "none"])
@pytest.mark.slow
def test_every_exploration_and_decay_runs(exploration, decay, undrawn, tmp_path):
    run(options_for("via_point", updates=1, exploration=exploration, decay=decay, shape="P", logdir=tmp_path))


@pytest.mark.slow
def test_a_learner_that_finds_noise_says_how_much_there_was(undrawn, tmp_path, capsys):
    options = options_for("via_point", runs=20, updates=10, optimizer="surrogate", logdir=tmp_path, cost_noise=0.5)
    folder = run(options)
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("estimated noise"))
    share = float(line.split()[-5].rstrip("%"))
    assert 25 < share < 100 and line.endswith("% of the initial cost")
    assert {"surrogate/noise", "surrogate/length", "surrogate/predicted_cost", "surrogate/error"} <= set(
        EventAccumulator(str(folder)).Reload().Tags()["scalars"]
    )


class Tired(Short):
    """A letter that costs more from trial to trial."""

    def __post_init__(self):
        super().__post_init__()
        self.trials = torch.zeros(())

    def rollout(self, policy):
        self.trials += 1
        return super().rollout(policy)

    def cost_terms(self, path):
        return {name: term * (1 + 0.1 * self.trials) for name, term in super().cost_terms(path).items()}

    def state_dict(self):
        return {"trials": self.trials}

    def load_state_dict(self, state):
        self.trials = state["trials"].clone()


@pytest.mark.slow
def test_trials_that_are_made_for_pictures_do_not_count(tmp_path, monkeypatch):
    drawn = []

    def draw(learner, *path):
        drawn.append(learner.task.rollout(learner.initial))
        return Figure() if path else {}

    monkeypatch.setattr(run_module.figures, "progress", draw)
    monkeypatch.setattr(run_module.figures, "of_run", draw)
    options = options_for("via_point", updates=10, rollouts=3)
    plain, pictured = Learner(options, Tired()).learn(), Learner(options, Tired())
    (tmp_path / "mine").mkdir()
    run_module.learn(RunFolder(tmp_path / "mine"), pictured)
    assert len(drawn) == 12
    assert pictured.history.cost == plain.history.cost and pictured.task.trials == plain.task.trials == 21
