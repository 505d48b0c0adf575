"""A session with a robot: what it asks, what it is told, and what survives a kill."""

import json
import os
import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tasks.digging.simulation import Recording
from torchds import files, load_policy
from torchds.errors import AllRolloutsFailedError, InvalidArgumentError, TorchdsError
from train.hardware.session import Session
from train.learning.learner import Learner
from train.options import options_for

ROOT = Path(__file__).parents[3]
SECONDS, N, SEED = 1.0, 3, 5
T = 250
HEADER = "time [s],x [m],z [m],angle [rad],force_x [N],force_z [N]"


def options(**changed):
    return replace(options_for("lwr_digging", seconds=SECONDS, rollouts=N, updates=2, threads=1, seed=SEED), **changed)


def learner(**changed):
    return Learner(options(grains="coarse", **changed))


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """The folder of a session that has asked."""
    folder = tmp_path_factory.mktemp("begun") / "s"
    Session.start(folder, options()).ask()
    return folder


@pytest.fixture
def session(begun, tmp_path):
    """A copy of it in `tmp_path`/s."""
    shutil.copytree(begun, tmp_path / "s")
    return lambda: Session.open(tmp_path / "s")


def costs(update_folder, *values):
    lines = [f"{k},{value}" for k, value in enumerate(values, 1) if value is not None]
    (update_folder / "costs.csv").write_text("\n".join(["rollout,cost", *lines]) + "\n")


def record(folder, k, t=None, shift=0.0):
    """Write a recording that follows its reference, without any force."""
    table = np.loadtxt(folder / f"rollout-{k}.csv", delimiter=",", skiprows=1)
    t = table[:, 0] if t is None else t
    pose = np.stack([np.interp(t, table[:, 0], column) for column in table[:, 1:4].T], -1) + shift
    rows = np.column_stack([t, pose, np.zeros((len(t), 2))])
    np.savetxt(folder / f"recording-{k}.csv", rows, "%.17g", ",", header=HEADER, comments="")


def cost_terms(session):
    """The cost terms of what came back, while the policy does not carry its noise."""
    return session.evidence(["there"] * N).terms(session.learner.policy)


@pytest.mark.slow
def test_the_references_are_what_the_policies_ask_for_digit_by_digit(session):
    mine = session()
    for p in mine.learner.policy.parameters():
        p.data = p.data + mine.optim.state[p]["noise"]
    _, poses, stiffness = mine.task.reference(mine.learner.policy)
    t = torch.linspace(0, SECONDS, T + 1, dtype=torch.float64)
    for k in range(N):
        file = mine.update_folder / f"rollout-{k + 1}.csv"
        assert file.read_text().splitlines()[0] == (
            "time [s],x [m],z [m],angle [rad],v_x [m/s],v_z [m/s],v_angle [rad/s],stiffness [N/m]"
        )
        table = torch.from_numpy(np.loadtxt(file, delimiter=",", skiprows=1))
        torch.testing.assert_close(table[:, 0], t, rtol=0, atol=1e-15)
        assert torch.equal(table[:, 1:4], poses[k, 0])
        assert torch.equal(table[:-1, 7], stiffness[k, 0]) and table[-1, 7] == stiffness[k, 0, -1]
        torch.testing.assert_close(table[:-1, 4:7], poses[k, 0].diff(dim=0) / 0.004, rtol=0, atol=1e-12)
        assert (table[-1, 4:7] == 0).all()
    _, imitated, _ = mine.task.reference(mine.learner.initial)
    torch.testing.assert_close(poses[0, 0], imitated, rtol=0, atol=1e-12)
    assert (poses[1:, 0] - imitated).abs().amax((1, 2)).min() > 1e-3


@pytest.mark.slow
def test_asking_again_writes_the_same_files(session):
    folder = session().update_folder
    before = {file.name: file.read_text() for file in folder.iterdir()}
    (folder / "rollout-2.csv").unlink()
    session().ask()
    assert {file.name: file.read_text() for file in folder.iterdir()} == before


@pytest.mark.slow
def test_a_partial_set_changes_nothing_until_the_rest_counts_as_failed(session, tmp_path):
    folder, before = session().update_folder, (tmp_path / "s" / "session.pt").read_bytes()
    record(folder, 1)
    (folder / "recording-2.failed").touch()
    with pytest.raises(InvalidArgumentError, match=r"1 there; 2 failed; 3 missing; nothing is changed"):
        session().tell()
    assert (tmp_path / "s" / "session.pt").read_bytes() == before
    assert session().status().states == ["there", "failed", "missing"]
    told = session().tell(missing="failed")
    assert told.failed == 2 and len(told.rows) == 3 and "from 3 roll-outs, 2 failed" in str(told)
    # The one that is left is the policy itself: it has all the weight, and nothing moves.
    mine = session()
    assert torch.equal(mine.learner.policy.pack()[0], mine.learner.initial.pack())
    mine.ask()
    costs(mine.update_folder, 1, 2, 3)
    record(mine.update_folder, 1)
    with pytest.raises(TorchdsError, match=r"has recordings and costs\.csv"):
        session().tell()


@pytest.mark.slow
def test_a_repeated_tell_says_so_and_changes_nothing(session, tmp_path):
    costs(session().update_folder, 1.0, 2.0, 3.0)
    session().tell()
    before = {file: file.read_bytes() for file in tmp_path.rglob("[!.]*.*") if file.is_file()}
    assert session().tell() is None
    assert {file: file.read_bytes() for file in tmp_path.rglob("[!.]*.*") if file.is_file()} == before


@pytest.mark.slow
def test_where_all_roll_outs_fail_the_policy_stays_and_other_ones_are_asked(session, tmp_path):
    first = session().update_folder
    costs(first, "failed", "", "failed")
    with pytest.raises(AllRolloutsFailedError, match=r"all roll-outs failed; the policy stays as it is\. next: .* ask"):
        session().tell()
    assert torch.equal(session().learner.policy.pack()[0], session().learner.initial.pack())
    session().ask()
    second = session().update_folder
    assert second.name == "update-001.2"
    assert (second / "rollout-1.csv").read_text() == (first / "rollout-1.csv").read_text()
    assert (second / "rollout-2.csv").read_text() != (first / "rollout-2.csv").read_text()
    costs(second, 1.0, 2.0, 3.0)
    session().tell()
    results = json.loads((tmp_path / "s" / "results.json").read_text())
    assert (results["rollouts"], results["failed"], results["terms"]["measured"]) == ([3], [3], [[1.0]])


@pytest.mark.slow
def test_a_reference_out_of_reach_is_not_given_to_the_robot(tmp_path):
    Session.start(tmp_path, options(noise=2.0)).ask()
    mine = Session.open(tmp_path)
    missing = [k for k in range(1, N + 1) if not (mine.update_folder / f"rollout-{k}.csv").exists()]
    assert missing and missing == [
        k for k in range(1, N + 1) if (mine.update_folder / f"recording-{k}.failed").exists()
    ]
    assert mine.ask().out_of_reach == missing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("optimizer", "exploration"), [("pibb", "homogeneous"), ("surrogate", "trajectory"), ("pi2cma", "trajectory")]
)
def test_a_session_that_is_closed_after_each_command_learns_from_costs_as_an_optimizer_does(
    optimizer, exploration, tmp_path
):
    """The cost of a policy is made of its parameters here, so that no robot is needed."""
    chosen = options(optimizer=optimizer, exploration=exploration, updates=4)
    expected = Learner(chosen)

    def cost(policy):
        return 1e3 * (policy.pack() - expected.initial.pack() - 0.01).square().sum(-1)

    def closure():
        expected.task.reference(expected.policy)
        return cost(expected.policy)

    Session.start(tmp_path, chosen)
    for update in range(4):
        asked = Session.open(tmp_path).ask()
        assert asked.again[:1] == ([2] if optimizer == "surrogate" and update == 0 else [])
        mine = Session.open(tmp_path)
        for p in mine.learner.policy.parameters():
            p.data = p.data + mine.optim.state[p]["noise"]
        costs(mine.update_folder, *cost(mine.learner.policy)[:, 0].tolist())
        Session.open(tmp_path).tell()
        expected.searcher.step(closure)
    assert torch.equal(Session.open(tmp_path).learner.policy.pack(), expected.policy.pack())
    assert not torch.equal(expected.policy.pack()[0], expected.initial.pack())


class Killed(BaseException):
    pass


def same(a, b):
    """Whether two saved states are equal, bit for bit."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[key], b[key]) for key in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return torch.equal(a, b) if isinstance(a, torch.Tensor) else a == b


@pytest.mark.slow
def test_killed_at_every_write_and_typed_again_a_session_ends_as_an_undisturbed_one(tmp_path, monkeypatch):
    kills, move = 0, os.replace

    def insist(command):
        """Let `command` end at its first write, then again at its second, and so on until it reaches its end."""
        nonlocal kills
        for allowed in range(100):
            writes = iter(range(allowed))

            def write(source, target, writes=writes):
                if next(writes, None) is None:
                    raise Killed
                move(source, target)

            with monkeypatch.context() as patch:
                patch.setattr(os, "replace", write)
                try:
                    return command()
                except Killed:
                    kills += 1

    def learn(folder, do):
        do(lambda: Session.start(folder, options()))
        for update in (1, 2):
            do(lambda: Session.open(folder).ask())
            costs(folder / f"update-00{update}", 1.5, 0.5, 1.0)
            do(lambda: Session.open(folder).tell())
        state = files.load(folder / "session.pt", "session")
        texts = [
            (folder / name).read_text()
            for name in ("results.json", "update-002/rollout-2.csv", "update-002/outcome.csv")
        ]
        return state, files.load(folder / "policy.pt", "policy"), texts

    whole, policy, texts = learn(tmp_path / "whole", lambda command: command())
    killed, policy_killed, texts_killed = learn(tmp_path / "killed", insist)
    # At the start demonstrations, mixture, results, policy and state; for each update the last three and the first reference,
    # since those that are there stay, then outcome and the three again.
    assert kills == 5 + 2 * (4 + 4)
    assert texts == texts_killed
    assert same(killed, whole) and same(policy_killed, policy)


@pytest.mark.parametrize(
    ("file", "words"),
    [
        (lambda good: good.replace("x [m]", "x [mm]", 1), r"no column 'x \[m\]'.*the header says .*x \[mm\]"),
        (lambda good: good.replace(",force_z [N]", ",f", 1), r"no column 'force_z \[N\]'"),
        (lambda good: "\n".join(good.splitlines()[:100]) + "\n", r"lasts from 0 to 0\.392 s, the motion from 0 to 1 s"),
        (lambda good: good + good.splitlines()[-1].replace("1,", "1.05,", 1) + "\n", r"lasts from 0 to 1\.05 s"),
        (lambda good: re.sub(r"\n0\.02,[^,]*", "\n0.02,nan", good), r"line 7, column 'x \[m\]': 'nan' is not a finite"),
        (lambda good: good.replace("\n0.02,", "\n0.03,"), r"the time has to increase, but 0\.024 s follows 0\.03 s"),
        (
            lambda good: "\n".join([*good.splitlines()[:50], *good.splitlines()[99:], ""]),
            r"nothing between 0\.192 and 0\.392 s",
        ),
        (lambda good: "", "no header"),
        (lambda good: good[:-1], "ends within a line, as a file does that is half-written"),
        (lambda good: good[:-5] + "\n", "values under 6 column names|lasts from"),
        (lambda good: good.splitlines()[0] + "\n", "at least two samples are needed, got 0"),
    ],
    ids=["unit", "column", "short", "long", "nan", "time", "gap", "empty", "no newline", "cut", "header alone"],
)
@pytest.mark.slow
def test_recordings_that_cannot_be_used_are_refused_and_change_nothing(file, words, session, tmp_path):
    folder, before = session().update_folder, (tmp_path / "s" / "session.pt").read_bytes()
    for k in (1, 2, 3):
        record(folder, k, t=np.round(np.arange(T + 1) * 0.004, 9))
    good = re.sub(r"\n([\d.e-]+),", lambda match: f"\n{float(match[1]):g},", (folder / "recording-2.csv").read_text())
    (folder / "recording-2.csv").write_text(file(good))
    with pytest.raises(TorchdsError, match=words) as error:
        session().tell()
    assert "recording-2.csv" in str(error.value)
    assert (tmp_path / "s" / "session.pt").read_bytes() == before


@pytest.mark.slow
def test_a_recording_that_starts_elsewhere_is_refused(session):
    for k in (1, 2, 3):
        record(session().update_folder, k, shift=0.1)
    with pytest.raises(TorchdsError, match=r"starts at x \[m\] = 0\.689186, its reference at 0\.589186"):
        session().tell()


@pytest.mark.parametrize("line", ["4,1.0", "1,1.0", "2,much", "2,inf", "2,nan", "2", "2,1,1"])
@pytest.mark.slow
def test_costs_that_cannot_be_used_are_refused(line, session):
    (session().update_folder / "costs.csv").write_text(f"rollout,cost\n1,1.0\n{line}\n")
    with pytest.raises(TorchdsError, match=re.escape(f"{line!r} is no line like 3,1.25 or 3,failed")):
        session().tell()


@pytest.mark.slow
def test_recordings_at_other_rates_give_the_costs_of_the_motion(session):
    """A smooth motion under a smooth force, sampled at 1 kHz, at 100 Hz, and at uneven times: the same cost."""
    mine = session()
    start, folder = mine.task.start.numpy(), mine.update_folder

    def motion(t):
        return start + np.stack([0.1 * np.sin(2 * t), 0.05 * (np.cos(3 * t) - 1), 0.2 * t**2], -1)

    def force(t):
        return np.stack([20 * np.sin(3 * t), 5 * np.cos(2 * t), 30 * t], -1)

    uneven = np.sort(np.random.default_rng(0).uniform(0, SECONDS, 200))
    for k, t in enumerate((np.arange(1001) / 1000, np.arange(101) / 100, np.r_[0, uneven, SECONDS]), 1):
        names = HEADER.replace("force_x [N]", "temperature [K],force_y [N],force_x [N]")
        fx, fy, fz = force(t).T
        rows = np.column_stack([t, motion(t), np.full(len(t), 293.0), fy, fx, fz])
        np.savetxt(folder / f"recording-{k}.csv", rows, "%.17g", ",", header=names, comments="")
    terms = cost_terms(mine)
    t = np.arange(T + 1) / T
    pose, push = (torch.from_numpy(f(t)) for f in (motion, force))
    path, _, stiffness = mine.task.reference(mine.learner.initial)
    none = torch.zeros(0)
    load = push[-125:, 2].mean()
    plant = Recording(pose, push[1:], none, stiffness, load, none, torch.tensor(False))
    exact = mine.task.cost_terms(replace(path, x=pose, v=pose.diff(dim=0) / 0.004, plant=plant))
    for name in ("gravel", "goal", "force", "stiffness", "acceleration"):
        for measured in terms[name][:, 0]:
            torch.testing.assert_close(measured, exact[name], rtol=2e-3, atol=1e-9)


@pytest.mark.slow
def test_a_force_across_the_plane_is_zero_where_it_is_not_recorded_and_costs_where_it_is(session):
    folder = session().update_folder
    for k in (1, 2, 3):
        record(folder, k)
    terms = cost_terms(session())
    assert (terms["force"] == 0).all()
    text = (folder / "recording-2.csv").read_text().splitlines()
    lines = [f"{text[0]},force_y [N]", *(f"{line},10" for line in text[1:])]
    (folder / "recording-2.csv").write_text("\n".join(lines) + "\n")
    after = cost_terms(session())["force"][:, 0]
    assert after.tolist() == pytest.approx([0.0, T * 2 * 1e-6 * 100, 0.0])


@pytest.mark.slow
def test_a_session_is_told_one_kind_of_file_and_exports_the_best(session, tmp_path):
    costs(session().update_folder, 1.0, 2.0, 3.0)
    session().tell()
    mine = session()
    best = mine.export(tmp_path / "best.pt")
    info = load_policy(tmp_path / "best.pt").info
    assert torch.equal(best.pack(), mine.learner.initial.pack()) and torch.equal(info.goal, mine.task.scene().goal)
    assert (info.names, info.units, info.dt) == (("x", "z"), "m", mine.task.dt)
    session().ask()
    for k in (1, 2, 3):
        record(session().update_folder, k)
    with pytest.raises(InvalidArgumentError, match=r"a session is told recordings or costs\.csv all along"):
        session().tell()


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"runs": 2}, "a robot learns in one run.*runs=2"),
        ({"elite": "best"}, "tries the policy itself first.*elite='best'"),
        ({"optimizer": "pi2"}, "--optimizer pi2 cannot wait for a robot; use --optimizer pibb"),
        ({"optimizer": "cma"}, "--optimizer cma"),
        ({"rollouts": 0}, "--rollouts has to be at least 1"),
    ],
)
@pytest.mark.slow
def test_options_that_do_not_fit_a_robot_are_refused_before_a_folder_is_made(changed, words, tmp_path):
    with pytest.raises(InvalidArgumentError, match=words):
        Session.start(tmp_path / "s", options(**changed))
    assert not (tmp_path / "s").exists()


@pytest.mark.slow
def test_a_session_keeps_its_demonstrations_and_may_be_moved(tmp_path):
    given = tmp_path / "given"
    shutil.copytree(ROOT / "tasks" / "digging" / "demonstrations", given)
    (given / "5.csv").unlink()
    mine = Session.start(tmp_path / "s", options(demonstrations=given))
    shutil.rmtree(given)
    shutil.move(tmp_path / "s", tmp_path / "t")
    again = Session.open(tmp_path / "t")
    assert torch.equal(again.task.goal, mine.task.goal)
    mine.optim.ask()
    again.optim.ask()
    for p, q in zip(mine.learner.policy.parameters(), again.learner.policy.parameters(), strict=True):
        assert torch.equal(mine.optim.state[p]["noise"], again.optim.state[q]["noise"])
