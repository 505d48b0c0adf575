"""Every example of docs/extending.md is short, keeps what its kind promises, and takes part in learning."""

import json
import re
import sys
from pathlib import Path

import pytest
import torch

import torchds
from torchds import testing
from train import __main__ as commands
from train.learning import figures

PAGE = Path(__file__).parents[2] / "docs" / "extending.md"
SECTIONS = re.findall(r"^## (.+?)\n.*?```python\n(.*?)```", PAGE.read_text(), re.M | re.S)
START = torch.tensor([1.0, 0.8], dtype=torch.float64)
GOAL = torch.zeros(2, dtype=torch.float64)


@pytest.fixture(scope="module")
def page():
    """The names of all examples; each runs without the others."""
    names = {}
    for title, block in SECTIONS:
        own = {"__name__": "page"}
        exec(compile(block, f"{PAGE.name}: {title}", "exec"), own)
        names |= own
    return names


@pytest.fixture
def policy(page):
    centres = torch.tensor([[1.0, 1.0], [0.0, 0.0], [1.0, 0.0]], dtype=torch.float64)
    return page["Centres"](centres, width=0.5)


def learn(policy, optim, cost=None, updates=15, **options):
    """The cost of the policy before and after learning to end at GOAL + 0.3."""

    def closure():
        path = torchds.rollout(policy, START, n_steps=20, dt=0.1, **options)
        return torchds.costs.goal(path.x, GOAL + 0.3) + (0.0 if cost is None else cost(path))

    with torch.no_grad():
        before = float(closure())
    for _ in range(updates):
        optim.step(closure)
    with torch.no_grad():
        return before, float(closure())


def pibb(policy, **options):
    return torchds.optim.PIBB(policy.parameters(), torchds.exploration.Gaussian(0.2), n_rollouts=10, **options)


def test_there_is_an_example_of_each_kind_under_thirty_lines():
    titles = [title for title, _ in SECTIONS]
    kinds = ["policy", "exploration", "optimizer", "plant", "stop condition", "cost term", "task"]
    assert [title.split(" ", 1)[1] for title in titles] == kinds
    for title, block in SECTIONS:
        assert len(block.splitlines()) < 30, title


@pytest.mark.slow
def test_the_policy_learns_with_a_control_cost(policy, randn):
    testing.check_policy(policy, randn(4, 2))
    before, after = learn(policy, pibb(policy, control_weight=1e-4))
    assert after < 0.3 * before


def test_the_exploration_learns(page, policy):
    exploration = page["Relative"](share=0.1, least=0.1)
    testing.check_exploration(exploration, list(policy.parameters()))
    before, after = learn(policy, torchds.optim.PIBB(policy.parameters(), exploration))
    assert after < 0.3 * before


@pytest.mark.slow
def test_the_optimizer_learns(page, policy):
    def make(params):
        return page["Winner"](params, torchds.exploration.Gaussian(0.3))

    testing.check_optimizer(make)
    before, after = learn(policy, make(list(policy.parameters())))
    assert after < 0.3 * before


@pytest.mark.slow
def test_the_plant_is_learned_with(page, policy, randn):
    plant = page["Lag"](0.5)
    testing.check_plant(plant, randn(3, 2))
    before, after = learn(policy, pibb(policy), plant=plant)
    assert after < 0.3 * before


@pytest.mark.slow
def test_the_stop_condition_ends_roll_outs(page, policy, randn):
    stop = page["Disc"](GOAL, 0.2)
    testing.check_stop(stop, randn(8, 2))
    path = torchds.rollout(policy, START, n_steps=20, dt=0.1, stop=stop)
    assert bool(path.stopped) and float(path.x[-1].detach().norm()) > 0.2
    before, after = learn(policy, pibb(policy), stop=stop)
    assert after < before


@pytest.mark.slow
def test_the_cost_term_is_learned(page, policy):
    with torch.no_grad():
        many = torchds.GMRPolicy.from_mixture(
            torchds.GaussianMixture(torch.ones(1).double(), torch.zeros(1, 4).double(), torch.eye(4).double()[None]), 2
        ).expand(3)
        many.A.add_(torch.randn(3, 1, 2, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64))
        testing.check_cost(page["turning"], torchds.rollout(many, START, 10, 0.1))
    before, after = learn(policy, pibb(policy), cost=page["turning"])
    assert after < 0.3 * before


@pytest.mark.slow
def test_the_task_is_learned(page):
    task = page["Detour"](height=0.3)
    with torch.no_grad():
        testing.check_cost(task.cost, task.rollout(task.policy().expand(3)))
        before = float(task.cost(task.rollout(task.policy())))
    policy = task.policy()
    noise = torchds.exploration.TrajectorySpace.relative(policy, *task.motion())
    optim = torchds.optim.SurrogatePIBB(
        policy.parameters(),
        noise,
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(0),
    )
    for _ in range(15):
        optim.step(lambda: task.cost(task.rollout(policy)))
    with torch.no_grad():
        assert float(task.cost(task.rollout(policy))) < 0.5 * before


@pytest.mark.slow
def test_the_command_learns_the_task_with_its_own_options_and_the_optimizer(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "of_run", lambda learner: {})
    examples, file = dict(SECTIONS), tmp_path / "my_file.py"
    file.write_text(examples["A task"] + examples["An optimizer"])
    options = [
        "--height",
        "0.3",
        "--runs",
        "2",
        "--updates",
        "1",
        "--optimizer",
        f"{file}:Winner",
        "--logdir",
        str(tmp_path),
    ]
    monkeypatch.setattr(sys, "argv", ["train", f"{file}:Detour", *options])
    assert commands.main() == 0
    (found,) = (tmp_path / "detour" / "Winner").rglob("results.json")
    results = json.loads(found.read_text())
    assert set(results["terms"]) == {"above", "goal", "control"}
    assert results["cost"][0] == pytest.approx([0.3**2 / 2] * 2, rel=0.01)  # the imitated motion is the diagonal
    assert results["cost"][1] != results["cost"][0]
