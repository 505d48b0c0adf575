"""Roll-outs step by step: without actions they are the plain ones, and rewards add up to what these cost."""

import pytest
import torch

import tasks
from tasks.transfer import Reach
from tasks.trials import Trials
from tests.motions import Short
from torchds.errors import InvalidArgumentError


class Brief(Reach):
    """A task without running costs, in a few steps."""

    def motion(self):
        return super().motion()._replace(n_steps=12, dt=0.25)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [Short, Brief])
def test_without_actions_the_steps_are_the_plain_roll_out(kind):
    task = kind()
    trials, plain = Trials(task, 3), task.rollout(task.policy())
    rewards = [trials.step(torch.zeros(3, trials.n_actions)) for _ in range(trials.n_steps)]
    assert trials.done and torch.isfinite(trials.observe()).all()
    torch.testing.assert_close(trials.path().x, plain.x.detach().expand(3, -1, -1), rtol=1e-12, atol=1e-12)
    torch.testing.assert_close(-torch.stack(rewards).sum(0), task.cost(plain).detach().expand(3), rtol=1e-10, atol=0)
    assert kind is Short or not torch.stack(rewards[:-1]).any()  # all of it comes due at the end
    trials.reset()
    assert not trials.done and trials.observe().shape == (3, trials.n_observations)


@pytest.mark.slow
def test_what_cannot_be_stepped_is_refused():
    task = Short()
    with pytest.raises(InvalidArgumentError, match="n has to be at least 1, got 0"):
        Trials(task, 0)
    with pytest.raises(InvalidArgumentError, match=r"actions have to be \(2, 2\), got shape \(1, 2\)"):
        Trials(task, 2).step(torch.zeros(1, 2))
    trials = Trials(task, 1)
    for _ in range(20):
        trials.step(torch.zeros(1, 2))
    with pytest.raises(InvalidArgumentError, match=r"all 20 steps are made; call reset\(\)"):
        trials.step(torch.zeros(1, 2))

    class Elsewhere(tasks.ViaPoint):
        def rollout(self, policy):
            raise NotImplementedError

    with pytest.raises(InvalidArgumentError, match=r"has to use `Task\.rollout`, got 'elsewhere'"):
        Trials(Elsewhere(), 1)


def test_a_policy_with_roll_outs_of_its_own_is_not_tried_step_by_step():
    with pytest.raises(InvalidArgumentError, match=r"has to use `Task\.rollout`, got 'via_point'"):
        Trials(tasks.make("via_point", system="dmp"), 1)


@pytest.mark.parametrize("noise", ["sensor_noise", "pushes"])
def test_noise_is_not_left_out_silently(noise):
    with pytest.raises(InvalidArgumentError, match=r"are without chance, got 'divergent_field' with some; leave out"):
        Trials(tasks.make("divergent_field", **{noise: 0.1}), 1)
