"""python -m train beyond: recruiting, repeats and one start a trial."""

import json
from functools import partial

import numpy as np
import pytest
import torch

from torchds.errors import InvalidArgumentError, UnknownNameError
from train.beyond import command as beyond
from train.beyond.command import Beyond, grow
from train.learning.learner import Learner
from train.options import options_for


@pytest.mark.slow
def test_growing_leaves_cost_noise_and_decay_where_they_were(task):
    learner = Learner(options_for("two_starts", runs=2, updates=4, rollouts=4), task)
    learner.start()
    learner.update()
    lr, cost = learner.searcher.optim.param_groups[0]["lr"], learner.history.cost[-1]
    drawn = learner.searcher.optim.generator.get_state()
    grow(learner, 2.0)
    terms = learner.evaluate()
    assert learner.policy.n_components == 12
    assert learner.searcher.optim.param_groups[0]["lr"] == lr
    assert torch.equal(learner.searcher.optim.generator.get_state(), drawn)
    # Only the control cost, a sum over parameters, knows that there are more of them.
    same = [sum(float(terms[name][i]) for name in terms if name != "control") for i in range(2)]
    before = [cost[i] - learner.history.terms["control"][-1][i] for i in range(2)]
    np.testing.assert_allclose(same, before, rtol=1e-9)
    learner.update()
    assert learner.searcher.optim.param_groups[0]["lr"] < lr


@pytest.mark.slow
def test_the_command_writes_what_it_measured(monkeypatch, tmp_path, task):
    small = {"runs": 2, "updates": 2, "rollouts": 4}
    one, two = options_for("via_point", **small, cost_noise=0.1), options_for("two_starts", **small)
    ways = {
        "recruit": [beyond.Way("a", "frozen", two, 3, trajectories=2), beyond.Way("a", "grown", two, 3, grow=(0.5,))],
        "noise": [beyond.Way("b", "three", one, wrap=partial(beyond.repeat, 3), trajectories=3)],
        "starts": [beyond.Way("c", "one", two, wrap=beyond.one_each)],
    }
    for name, rows in ways.items():
        assert {way.group.split(",")[0] for way in getattr(Beyond(), name)()}  # the real ones can be made
        monkeypatch.setattr(Beyond, name, lambda self, rows=rows: rows)
    folder = Beyond(runs=2, logdir=tmp_path).main()
    rows = json.loads((folder / "costs.json").read_text())["rows"]
    assert {name: [row["trajectories"] for row in rows[name]] for name in rows} == {
        "recruit": [16, 8],
        "noise": [24],
        "starts": [8],
    }
    report = (folder / "report.md").read_text()
    q1, median, q3 = np.quantile(rows["recruit"][1]["cost"], [0.25, 0.5, 0.75])
    assert f"| a | grown | 8 | {median:.3g} | {q1:.3g} | {q3:.3g} | " in report


@pytest.mark.parametrize(
    ("options", "error", "words"),
    [
        ({"experiments": ("recrut",)}, UnknownNameError, "unknown experiment 'recrut'"),
        ({"learners": ("pi",)}, UnknownNameError, "unknown learner 'pi'"),
        ({"levels": (-0.1,)}, InvalidArgumentError, "--levels"),
        ({"budget": 0.0}, InvalidArgumentError, "--budget"),
        ({"runs": 1}, InvalidArgumentError, "--runs"),
        ({"width": -1.0}, InvalidArgumentError, "--width"),
    ],
)
def test_wrong_options_are_refused_before_anything_runs(options, error, words, tmp_path):
    with pytest.raises(error, match=words):
        Beyond(**options, logdir=tmp_path).main()
    assert not list(tmp_path.iterdir())
