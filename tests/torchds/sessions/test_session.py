"""Sessions of two tasks that are no digging learn as the optimizer does, and survive kills, two processes and full disks."""

import errno
import json
import math
import multiprocessing
import os
import shutil

import pytest
import torch

import torchds
from tests.torchds.sessions.motions import MOTIONS, costs, learned, letter, record, session
from torchds import files
from torchds.errors import AllRolloutsFailedError, FileError, InvalidArgumentError, LastDigitsWarning
from torchds.recordings import read_table
from torchds.sessions import Session
from torchds.sessions.session import check_motion

N = 3


@pytest.mark.slow
def test_costs_come_from_recordings_through_the_cost_terms(tmp_path):
    mine = session(tmp_path / "s", "poses")
    mine.ask()
    for k in (1, 2, 3):
        record(mine, k)
    asked = mine.references()
    told = mine.tell()
    assert told.header == ["rollout", "goal", "effort", "control", "cost", "weight", "state"]
    goal = torch.tensor([0.0, 0.02, 0.01, 0, 0, 0.1], dtype=torch.float64)
    expected = (asked.x[:, -1] - goal).square().sum(-1)
    torch.testing.assert_close(
        torch.tensor([row[1] for row in told.rows], dtype=torch.float64), expected, atol=1e-12, rtol=1e-9
    )
    effort = 1e-3 * (asked.x.diff(dim=1) / 0.05).square().sum((1, 2))
    torch.testing.assert_close(
        torch.tensor([row[2] for row in told.rows], dtype=torch.float64), effort, atol=1e-12, rtol=1e-9
    )


@pytest.mark.slow
@pytest.mark.parametrize("motion", MOTIONS)
def test_opened_anew_for_each_command_it_learns_as_the_optimizer_does(tmp_path, motion):
    """From recordings that follow their references exactly, velocities by differences; the noise decays all the same."""
    trial, policy, optim, decay = learned(motion)
    initial = policy.pack().detach().clone()
    for _ in range(3):
        optim.step(lambda: sum(trial.cost_terms(torchds.rollout(policy, trial.x0, trial.n_steps, trial.dt)).values()))
        decay.step()
        session(tmp_path / "s", motion, n_updates=3).ask()
        mine = session(tmp_path / "s", motion, n_updates=3)
        for k in (1, 2, 3):
            record(mine, k)
        session(tmp_path / "s", motion, n_updates=3).tell()
    mine = session(tmp_path / "s", motion, n_updates=3)
    assert mine.done == 3 and mine.optim.param_groups[0]["lr"] == optim.param_groups[0]["lr"] < 1
    torch.testing.assert_close(mine.policy.pack(), policy.pack(), rtol=1e-5, atol=1e-6)
    assert not torch.equal(mine.policy.pack(), initial)
    with pytest.raises(InvalidArgumentError, match="all 3 updates are made"):
        mine.ask()


class Killed(BaseException):
    pass


@pytest.mark.slow
@pytest.mark.parametrize(("motion", "fault"), [("letter", "kill"), ("poses", "full")])
def test_killed_or_on_a_full_disk_at_every_write_it_ends_as_an_undisturbed_one(tmp_path, monkeypatch, motion, fault):
    faults, move = 0, os.replace

    def insist(command):
        """Let `command` fail at its first write, then again at its second, and so on until it reaches its end."""
        nonlocal faults
        for allowed in range(100):
            writes = iter(range(allowed))

            def write(source, target, writes=writes):
                if next(writes, None) is None:
                    raise Killed if fault == "kill" else OSError(errno.ENOSPC, "No space left on device")
                move(source, target)

            with monkeypatch.context() as patch:
                patch.setattr(os, "replace", write)
                try:
                    return command()
                except Killed:
                    faults += 1
                except FileError as error:
                    assert "No space left on device" in str(error)
                    faults += 1

    def learn(folder, do):
        do(lambda: session(folder, motion))
        for _ in range(2):
            do(lambda: session(folder, motion).ask())
            costs(session(folder, motion), 1.5, 0.5, 1.0)
            do(lambda: session(folder, motion).tell())
        names = ("results.json", "update-002/rollout-2.csv", "update-002/outcome.csv", "update-001/asked.json")
        state = files.load(folder / "session.pt", "session")
        return files.digest(state), [(folder / name).read_text() for name in names]

    whole = learn(tmp_path / "whole", lambda command: command())
    assert learn(tmp_path / "faulty", insist) == whole
    # Results, policy and state at the start; for each update these three and the first reference, since those that are there
    # stay; then outcome and the three again.
    assert faults == 3 + 2 * (4 + 4) == 19
    torchds.load_policy(tmp_path / "faulty" / "policy.pt")


def tell(folder, barrier, said):
    torch.set_num_threads(1)
    mine = session(folder)
    barrier.wait()
    try:
        told = mine.tell()
        said.put("told" if told else "nothing")
    except FileError as error:
        said.put(str(error))


@pytest.mark.slow
def test_of_two_processes_that_tell_at_once_one_makes_the_update(tmp_path):
    folder = tmp_path / "s"
    session(folder).ask()
    costs(session(folder), 1.5, 0.5, 1.0)
    context = multiprocessing.get_context("fork")
    barrier, said = context.Barrier(2), context.Queue()
    both = [context.Process(target=tell, args=(folder, barrier, said)) for _ in range(2)]
    for process in both:
        process.start()
    for process in both:
        process.join(60)
    words = sorted(said.get(timeout=5) for _ in both)
    assert words[1] == "told" and ("is in use by" in words[0] or "has gone on with the session" in words[0])
    assert session(folder).done == 1


def test_a_folder_may_be_moved_and_a_repeated_tell_changes_nothing(tmp_path):
    session(tmp_path / "s").ask()
    shutil.move(tmp_path / "s", tmp_path / "t")
    mine = session(tmp_path / "t")
    costs(mine, 1.5, 0.5, "failed")
    assert mine.tell().failed == 1
    before = {path: path.read_bytes() for path in (tmp_path / "t").rglob("[!.]*") if path.is_file()}
    assert session(tmp_path / "t").tell() is None
    assert {path: path.read_bytes() for path in (tmp_path / "t").rglob("[!.]*") if path.is_file()} == before
    assert json.loads((tmp_path / "t" / "results.json").read_text())["cost"] == [[pytest.approx(1.5, abs=0.2)]]


@pytest.mark.slow
def test_the_best_policy_is_exported_as_it_was_tried(tmp_path):
    mine = session(tmp_path / "s", n_updates=3)
    with pytest.raises(
        InvalidArgumentError, match=r"no policy with a finite cost was tried yet; next: session\.ask\(\)"
    ):
        mine.export(tmp_path / "best.pt")
    tried = []
    for nominal in (2.0, 1.0, 3.0):
        mine.ask()
        tried.append(mine.policy.pack().detach().clone())
        costs(mine, nominal, 0.5, 1.5)
        mine.tell()
    again = session(tmp_path / "s", n_updates=3)
    again.export(tmp_path / "best.pt", goal=[0.0, 0.0])
    best = torchds.load_policy(tmp_path / "best.pt")
    assert torch.equal(best.pack(), tried[1]) and again.best[1] == pytest.approx(1.0, abs=0.3)
    assert best.info.dt == mine.trial.dt and best.info.goal.tolist() == [0, 0]
    assert [f"{name} [{best.info.units}]" for name in best.info.names] == list(mine.trial.layout.position)
    assert torchds.Controller.load(tmp_path / "best.pt").dt == mine.trial.dt


@pytest.mark.slow
def test_only_finite_costs_are_the_best(tmp_path):
    mine = session(tmp_path / "s")
    mine.trial.cost_terms = lambda path: {"end": path.x[..., -1, 0] * torch.tensor([math.nan, 1, 1])}
    for update in (1, 2):
        mine.ask()
        for k in (1, 2, 3):
            record(mine, k)
        mine.tell()
        if update == 1:
            with pytest.raises(InvalidArgumentError, match="no policy with a finite cost was tried yet"):
                mine.export(tmp_path / "best.pt")
            state = files.load(tmp_path / "s" / "session.pt", "session")  # as earlier versions wrote it
            state["best"] = {"policy": mine.policy.state_dict(), "cost": math.nan}
            files.save(tmp_path / "s" / "session.pt", "session", state)
            mine = session(tmp_path / "s")
            mine.trial.cost_terms = lambda path: {"end": path.x[..., -1, 0]}
    assert mine.best[1] == mine.history.cost[1][0] and math.isnan(mine.history.cost[0][0])
    mine.export(tmp_path / "best.pt")


@pytest.mark.slow
def test_last_digits_of_another_processor_are_no_other_motion(tmp_path, monkeypatch):
    monkeypatch.setenv("TORCHDS_BACKEND", "eager")
    folder = session(tmp_path / "s").ask().folder
    eager = {path.name: path.read_text() for path in folder.glob("rollout-*")}
    monkeypatch.setenv("TORCHDS_BACKEND", "auto")
    (folder / "rollout-2.csv").rename(tmp_path / "lost.csv")
    with pytest.warns(LastDigitsWarning, match="begun on another processor or with other versions: it goes on"):
        mine = session(tmp_path / "s")
    mine.ask()
    fused = {path.name: path.read_text() for path in folder.glob("rollout-*")}
    assert fused.keys() == eager.keys() and fused["rollout-1.csv"] == eager["rollout-1.csv"]
    assert fused["rollout-2.csv"] != eager["rollout-2.csv"]
    for k in (1, 2, 3):
        record(mine, k)
    assert mine.tell().failed == 0
    session(tmp_path / "s").ask()  # said once


def test_motions_are_one_but_for_their_last_digits(tmp_path, randn):
    x, columns = randn(9, 2), ["x [m]", "y [m]"]
    begun = [{"x": x, "stiffness": x[:, :0]}, columns, 0.1]
    check_motion(tmp_path, begun, begun)
    check_motion(tmp_path, files.digest(begun), begun)
    single = [{"x": x.float()}, columns, 0.1]
    for was, now in (
        (begun, [{**begun[0], "x": x + 1e-9}, *begun[1:]]),
        (single, [{"x": x.float() + 1e-5}, *single[1:]]),
    ):
        with pytest.warns(LastDigitsWarning, match="last digits may differ"):
            check_motion(tmp_path, was, now)
        with pytest.raises(
            FileError, match=r"another motion.*; or an earlier version .* began it on another processor: tell once"
        ):
            check_motion(tmp_path, files.digest(was), now)
    for other in (
        [{**begun[0], "x": x + 1e-3}, columns, 0.1],
        [{**begun[0], "x": x[1:]}, columns, 0.1],
        [{**begun[0], "x": x.float()}, columns, 0.1],
        [begun[0], columns[::-1], 0.1],
        [begun[0], columns, 0.2],
    ):
        with pytest.raises(FileError, match="begun with another motion: policy, start, time step or columns differ"):
            check_motion(tmp_path, begun, other)


@pytest.mark.slow
def test_one_cost_is_a_term_and_folders_of_earlier_versions_go_on(tmp_path):
    def once(path):
        return path.x[..., -1, 0].square()

    mine = session(tmp_path / "s")
    mine.trial.cost_terms = once
    folder = mine.ask().folder
    for k in (1, 2, 3):
        record(mine, k)
    expected = ["rollout", "task", "control", "cost", "weight"]
    assert mine.tell().header == [*expected, "state"]
    table = [line.rpartition(",")[0] for line in (folder / "outcome.csv").read_text().splitlines()]
    (tmp_path / "numbers.csv").write_text("\n".join(table) + "\n")
    assert read_table(tmp_path / "numbers.csv")[0] == expected
    path = tmp_path / "s" / "session.pt"
    state = files.load(path, "session")
    terms = {{"task": "cost"}.get(name, name): rows for name, rows in state["history"]["terms"].items()}
    before = {"identity": files.digest(state["identity"]), "history": {**state["history"], "terms": terms}}
    files.save(path, "session", {**state, **before})
    mine = session(tmp_path / "s")
    mine.trial.cost_terms = once
    mine.ask()
    for k in (1, 2, 3):
        record(mine, k)
    mine.tell()
    assert [(name, len(rows)) for name, rows in mine.history.terms.items()] == [("task", 2), ("control", 2)]
    assert isinstance(files.load(path, "session")["identity"], list)


def test_where_all_fail_others_are_asked(tmp_path):
    mine = session(tmp_path / "s")
    mine.ask()
    costs(mine, "failed", "", "failed")
    with pytest.raises(AllRolloutsFailedError, match=r"the policy stays as it is\. next: session\.ask\(\)"):
        mine.tell()
    assert mine.ask().folder.name == "update-001.2"


@pytest.mark.slow
def test_what_does_not_fit_the_session_is_refused(tmp_path):
    mine = session(tmp_path / "s")
    mine.ask()
    trial, policy = letter()
    noise = torchds.exploration.Gaussian(0.1)
    with pytest.raises(FileError, match="begun with another motion: policy, start, time step or columns differ"):
        session(tmp_path / "s", "poses")
    with pytest.raises(FileError, match=r"session\.pt does not fit what is given now"):
        session(tmp_path / "s", n_rollouts=4)
    for options, words in (
        ({"elite": "none"}, r"PIBB with elite='none'; make it with elite='nominal'"),
        ({"elite": "best"}, r"PIBB with elite='best'; make it with elite='nominal'"),
        ({}, "made of policy.parameters"),
    ):
        optim = torchds.optim.PIBB((mine.policy if not options else policy).parameters(), exploration=noise, **options)
        with pytest.raises(InvalidArgumentError, match=words):
            Session(tmp_path / "t", trial, policy, optim)
    with pytest.raises(InvalidArgumentError, match=r"one policy, got a batch \(2,\)"):
        Session(tmp_path / "t", trial, policy.expand(2), optim)
    assert not (tmp_path / "t").exists()
    (tmp_path / "t").mkdir()
    (tmp_path / "t" / "options.json").write_text("{}")
    optim = torchds.optim.PIBB(policy.parameters(), exploration=noise, elite="nominal")
    with pytest.raises(InvalidArgumentError, match="holds a run; give another folder"):
        Session(tmp_path / "t", trial, policy, optim)
