"""Optimizers and explorations that stand in a file of the user: learned with, compared, resumed, and refused in words."""

import csv
import json

import pytest

from tests.motions import Short
from torchds.errors import InvalidArgumentError, UnknownNameError
from train.compare import command as compare
from train.compare.command import Compare
from train.learning.learner import Learner
from train.learning.run import run
from train.options import options_for

MINE = '''
import torch
from torchds.exploration import Gaussian
from torchds.optim import PIBB

class Same(PIBB):
    """As PIBB."""

class Half(Gaussian):
    """Half as wide as what --noise says, or 0.1."""
    def __init__(self, policy, noise=0.2):
        assert policy.batch_shape == (2,)
        super().__init__(noise / 2)

class Strange(PIBB):
    def __init__(self, params, exploration, n_rollouts, lr):
        super().__init__(params, exploration, n_rollouts, lr)

class Without(Gaussian):
    def __init__(self, policy):
        super().__init__(0.1)

number = 3
'''

SPACE = """
import torch
from tasks import Task
from torchds import Demonstrations, costs
from torchds.exploration import Homogeneous
from torchds.optim import PIBB

class Half(PIBB):
    pass

class Quiet(Homogeneous):
    pass

class Space(Task):
    def default_demonstrations(self):
        s = torch.linspace(0, 1, 40, dtype=torch.float64)[:, None]
        return Demonstrations([torch.cat([s - 1, h * torch.sin(3 * s), 1 - s], 1) for h in (0.9, 1.0)], dt=0.1)

    def cost_terms(self, path):
        return {"goal": costs.goal(path.x, torch.ones(3, dtype=path.x.dtype))}
"""


@pytest.fixture
def mine(tmp_path):
    """Names a class in the user's file."""
    (tmp_path / "mine.py").write_text(MINE)
    return lambda name: f"{tmp_path / 'mine.py'}:{name}"


@pytest.fixture(scope="module")
def task():
    return Short()


def learner(task, **options):
    return Learner(options_for("via_point", **{"runs": 2, "updates": 3, "rollouts": 5, **options}), task)


@pytest.mark.slow
def test_an_own_optimizer_gets_what_pibb_gets(task, mine):
    given = {"scale": 0.7, "seed": 5, "temperature": "capped", "elite": "nominal", "decay": "inverse"}
    own, usual = (learner(task, optimizer=name, **given).learn() for name in (mine("Same"), "pibb"))
    assert type(own.searcher.optim).__name__ == "Same"
    assert own.history.cost == usual.history.cost


def test_an_own_exploration_gets_the_policy_and_the_noise(task, mine):
    usual = learner(task, exploration="gaussian", noise=0.1).learn()
    assert learner(task, exploration=mine("Half")).learn().history.cost == usual.history.cost
    assert learner(task, exploration=mine("Half"), noise=0.2).learn().history.cost == usual.history.cost
    assert learner(task, exploration=mine("Half"), noise=0.4).learn().history.cost != usual.history.cost


def test_an_own_exploration_gives_coordinates_too(task, mine):
    own, usual = ({"exploration": mine("Half")}, {"exploration": "gaussian", "noise": 0.1})
    costs = [learner(task, optimizer="cma", **options).learn().history.cost for options in (own, usual)]
    assert costs[0] == costs[1]


def test_a_run_with_both_resumes(task, mine):
    options = {"optimizer": mine("Same"), "exploration": mine("Half")}
    whole, first, second = (learner(task, **options) for _ in range(3))
    whole.learn()
    first.start()
    first.update()
    second.load_state_dict(first.state_dict())
    assert second.learn().history.cost == whole.history.cost


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        (
            {"optimizer": "Strange"},
            InvalidArgumentError,
            r"Strange has to be made with \(generator, lr=, .*generator=\), .*temperature",
        ),
        (
            {"exploration": "Without", "noise": 0.3},
            InvalidArgumentError,
            r"Without has to be made with \(GMRPolicy, float\), got",
        ),
        ({"optimizer": "Half"}, InvalidArgumentError, r"has to be a subclass of torchds\.optim\.\S*PolicySearch"),
        (
            {"exploration": "Same"},
            InvalidArgumentError,
            r"has to be a subclass of torchds\.exploration\.\S*Exploration",
        ),
        ({"exploration": "number"}, InvalidArgumentError, "has to be a subclass of"),
        ({"optimizer": "Sam"}, UnknownNameError, "Did you mean 'Same'"),
    ],
)
def test_what_is_no_optimizer_or_exploration_is_refused_in_words(task, mine, options, error, words):
    named = {name: mine(value) if isinstance(value, str) else value for name, value in options.items()}
    with pytest.raises(error, match=words):
        learner(task, **named)


@pytest.mark.slow
def test_they_are_compared_like_all_others(task, mine, tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "made", lambda options: task)
    folder = Compare(
        tasks=("via_point-N",),
        optimizers=("pibb", mine("Same")),
        coordinates=("plain", mine("Half")),
        runs=2,
        updates=1,
        factors=(1.0,),
        logdir=tmp_path / "logs",
    ).main()
    with (folder / "table.csv").open(newline="") as file:
        rows = {row["optimizer"]: row for row in csv.DictReader(file)}
    assert list(rows) == ["pibb", "pibb, Half", "Same", "Same, Half"]
    for kind in ("", ", Half"):
        assert rows[f"pibb{kind}"]["final median"] == rows[f"Same{kind}"]["final median"]
    assert rows["pibb"]["final median"] != rows["pibb, Half"]["final median"]
    records = [json.loads(path.read_text()) for path in (tmp_path / "logs").rglob("results.json")]
    assert len(records) == 4


@pytest.mark.slow
def test_they_learn_and_their_places_are_kept(tmp_path, capsys):
    file = tmp_path / "of_somebody.py"
    file.write_text(SPACE)
    own = {"optimizer": f"{file}:Half", "exploration": f"{file}:Quiet", "noise": 0.02}
    folder = run(options_for(f"{file}:Space", updates=2, rollouts=4, logdir=tmp_path / "logs", **own))
    assert folder.relative_to(tmp_path / "logs").parts[:2] == ("space", "Half")
    kept = json.loads((folder / "results.json").read_text())
    assert (kept["task"], kept["options"]["optimizer"]) == (f"{file}:Space", f"{file}:Half")
    usual = {"optimizer": "pibb", "exploration": "homogeneous", "noise": 0.02}
    again = run(options_for(f"{file}:Space", updates=2, rollouts=4, logdir=tmp_path / "logs", **usual))
    assert json.loads((again / "results.json").read_text())["cost"] == kept["cost"]
    assert "the positions of space have 3 dimensions" in capsys.readouterr().out
    assert [p.name for p in folder.glob("*.png")] == ["learning_curves.png"]
