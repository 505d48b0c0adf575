"""python -m train hardware: a robot in a process of its own, and what the commands print."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from torchds import Controller, files, load_policy
from train import __main__ as train_main
from train.hardware.records import hint
from train.learning.learner import Learner
from train.options import options_for

ROOT = Path(__file__).parents[3]
SECONDS, N, SEED = 1.0, 3, 5


def learner():
    options = options_for("lwr_digging", seconds=SECONDS, rollouts=N, updates=2, threads=1, seed=SEED)
    return Learner(replace(options, grains="coarse"))


@pytest.fixture
def command(monkeypatch, capsys):
    """Types `python -m train hardware ...` and returns the exit code and what was printed."""

    def type_(*words):
        monkeypatch.setattr(sys, "argv", ["train", "hardware", *map(str, words)])
        code = train_main.main()
        printed = capsys.readouterr()
        return code, printed.out + printed.err

    return type_


@pytest.mark.slow
def test_a_session_with_a_robot_in_another_process_learns_as_one_in_this_process(tmp_path, command):
    folder = tmp_path / "my session"
    start = f"start --initial-stiffness 150 --seconds {SECONDS} --rollouts {N} --updates 2 --seed {SEED}"
    assert command(*start.split(), folder)[0] == 0
    expected = learner()
    tried = []
    run = [sys.executable, Path(__file__).with_name("robot.py"), str(SECONDS), str(SEED)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(run, env=environment, text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as robot:
        for update in (1, 2):
            assert command("ask", folder)[0] == 0
            robot.stdin.write(f"{folder}/update-00{update}\n")
            robot.stdin.flush()
            assert robot.stdout.readline() == "executed\n"
            code, said = command("tell", folder)
            assert code == 0 and f"update {update} of 2 is made from 3 roll-outs" in said
            expected.searcher.step(expected.closure)
            tried.append(expected.searcher.optim.last)
            outcome = np.genfromtxt(folder / f"update-00{update}" / "outcome.csv", delimiter=",", names=True)
            assert outcome["cost"].tolist() == tried[-1].cost[:, 0].tolist()
            assert outcome["weight"].tolist() == tried[-1].weights[:, 0].tolist()
        robot.stdin.close()
    learned = load_policy(folder / "policy.pt").state_dict()
    assert all(torch.equal(learned[name], value) for name, value in expected.policy.state_dict().items())
    results = json.loads((folder / "results.json").read_text())
    assert results["rollouts"] == [0, 3] and results["failed"] == [0, 0] and results["seconds"] == 6 * SECONDS
    assert results["cost"] == [pytest.approx(last.cost[0].tolist(), rel=1e-14) for last in tried]
    assert set(results["terms"]) == {"gravel", "goal", "force", "stiffness", "acceleration", "control"}
    assert "all updates are made; the best that was tried: " in command("status", folder)[1]
    assert command("ask", folder)[0] == 2


@pytest.mark.slow
def test_commands_to_the_wrong_folder_are_one_line(command, tmp_path):
    start = ("start", "--seconds", SECONDS, "--rollouts", N, tmp_path / "s")
    assert command(*start)[0] == 0
    code, said = command("ask", tmp_path)
    assert code == 2 and said.startswith(f"error: {tmp_path} holds no session; python -m train hardware start")
    code, said = command("start", tmp_path / "s")
    assert code == 2 and "holds a session already; python -m train hardware status" in said


@pytest.mark.slow
def test_the_commands_say_what_comes_next(command, tmp_path):
    folder = tmp_path / "s"
    code, said = command("start", "--seconds", SECONDS, "--rollouts", N, "--updates", 1, folder)
    assert code == 0 and said.endswith(f"next: python -m train hardware ask {folder}\n")
    code, said = command("tell", folder)
    assert code == 0 and said.startswith("nothing has been asked yet; nothing is changed\nnext: ")
    code, said = command("ask", folder)
    assert "update 1 of 1, references in" in said and "or one costs.csv beside the references, then python" in said
    (folder / "update-001" / "costs.csv").write_text("rollout,cost\n1,3.0\n2,1.0\n3,2.0\n")
    code, said = command("tell", folder)
    assert "update 1 of 1 is made from 3 roll-outs" in said
    assert said.endswith(f"the last policy, not tried yet, is in {folder / 'policy.pt'}\n")
    code, said = command("tell", folder)
    assert said.startswith("update 1 has been told already; nothing is changed\nall updates are made")


@pytest.mark.slow
def test_a_session_of_another_task_has_its_columns_options_and_costs(tmp_path, command):
    folder = tmp_path / "s"
    assert command("start", folder, "--task", "via_point", "--shape", "P", "--rollouts", 3, "--updates", 1)[0] == 0
    assert command("ask", folder)[0] == 0
    for k in (1, 2, 3):
        header, *lines = (folder / "update-001" / f"rollout-{k}.csv").read_text().splitlines()
        assert header == "time [s],x1 [1],x2 [1],v_x1 [1/s],v_x2 [1/s]"
        rows = [",".join(line.split(",")[:3]) for line in lines]
        (folder / "update-001" / f"recording-{k}.csv").write_text("\n".join(["time [s],x1 [1],x2 [1]", *rows]) + "\n")
    code, said = command("tell", folder)
    assert code == 0 and "update 1 of 1 is made from 3 roll-outs" in said
    results = json.loads((folder / "results.json").read_text())
    assert results["task"] == "via_point" and results["options"]["shape"] == "P"
    expected = Learner(options_for("via_point", shape="P"))
    expected.start()
    for name, values in expected.history.terms.items():
        assert results["terms"][name][0] == pytest.approx(values[0], rel=1e-6)


@pytest.mark.slow
def test_the_best_policy_is_exported_as_it_was_tried(tmp_path, command):
    """Failed when it was tried first, dearer in the third update than in the second."""
    folder, best = tmp_path / "s", tmp_path / "best.pt"
    assert command("start", folder, "--task", "via_point", "--shape", "P", "--rollouts", 3, "--updates", 3)[0] == 0
    code, said = command("export", folder, best)
    assert code == 2 and f"no policy with a finite cost was tried yet; next: {hint('ask', folder)}" in said
    tried = []
    for update, nominal in enumerate(("failed", 2.0, 3.0), 1):
        tried.append(load_policy(folder / "policy.pt").pack()[0])
        command("ask", folder)
        (folder / f"update-00{update}" / "costs.csv").write_text(f"rollout,cost\n1,{nominal}\n2,1.0\n3,1.5\n")
        said = command("tell", folder)[1]
        if update == 1:
            assert command("export", folder, best)[0] == 2
    assert f"the best that was tried: {hint('export', folder)}" in said and hint("export", folder).endswith(" best.pt")
    said = command("export", folder, best, "--dt", 0.001)[1]
    cost = json.loads((folder / "results.json").read_text())["cost"][1][0]
    assert 2.0 <= cost < 2.1  # with its control cost
    assert said == f"{best}: the policy that cost {cost:.4g} when update 2 tried it, for a time step of 0.001 s\n"
    policy = load_policy(best)
    assert torch.equal(policy.pack(), tried[1]) and not torch.equal(tried[1], tried[2])
    info = load_policy(folder / "policy.pt").info
    assert (policy.info.dt, policy.info.names, policy.info.units) == (0.001, info.names, info.units)
    assert torch.equal(policy.info.goal, info.goal)
    command("export", folder, best)
    assert Controller.load(best).dt == info.dt


@pytest.mark.slow
def test_a_session_of_an_earlier_version_goes_on_and_keeps_the_best_from_then_on(tmp_path, command):
    folder = tmp_path / "s"
    command("start", folder, "--task", "via_point", "--shape", "P", "--rollouts", 3, "--updates", 2)
    for update, nominal in ((1, 1.0), (2, 2.0)):
        command("ask", folder)
        (folder / f"update-00{update}" / "costs.csv").write_text(f"rollout,cost\n1,{nominal}\n2,1.0\n3,1.5\n")
        assert command("tell", folder)[0] == 0
        if update == 1:
            state = files.load(folder / "session.pt", "session")
            del state["best"]
            files.save(folder / "session.pt", "session", state)
            code, said = command("export", folder, tmp_path / "best.pt")
            assert code == 2 and "was kept by the earlier version that tried them; next: python" in said
    assert "when update 2 tried it" in command("export", folder, tmp_path / "best.pt")[1]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("task", "words"),
    [
        ("half_plane_force", "half_plane_force simulates what a robot would be; make a torchds.sessions.Session"),
        (
            "via_point --system dmp",
            "a robot is asked for `torchds.rollout` of a policy, got 'via_point' with a rollout of",
        ),
        ("two_starts", "tasks of several starts are several sessions"),
        ("via_pont", "unknown task 'via_pont'. Did you mean 'via_point'"),
    ],
)
def test_tasks_that_no_session_can_have_are_refused(tmp_path, command, task, words):
    code, said = command("start", tmp_path / "s", "--task", *task.split())
    assert code == 2 and words in said and not (tmp_path / "s").exists()
