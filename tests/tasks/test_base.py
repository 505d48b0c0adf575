import pytest
import torch

import tasks
from torchds import Demonstrations, GaussianMixture, costs
from torchds.errors import InvalidArgumentError


def curve(size, h, D=2):
    s = torch.linspace(0, 1, 50, dtype=torch.float64)[:, None]
    bend = [h * torch.sin(torch.pi * s), h * torch.sin(2 * torch.pi * s)]
    return size * torch.cat([s - 1, *bend[: D - 1]], 1)


class Bend(tasks.Task):
    """As little as a task can be."""

    size: float = 1.0
    """Of everything."""
    dim: int = 2
    """D."""

    def default_demonstrations(self):
        return Demonstrations([curve(self.size, h, self.dim) for h in (0.3, 0.4)], dt=0.1, units="m")

    def cost_terms(self, path):
        return {"goal": costs.goal(path.x, torch.zeros(self.dim, dtype=path.x.dtype))}


@pytest.mark.parametrize("dim", [1, 2, 3])
@pytest.mark.slow
def test_a_task_of_demonstrations_and_a_cost_has_all_the_rest(dim):
    task = Bend(dim=dim)
    policy, motion, scene = task.policy(), task.motion(), task.scene()
    assert (policy.input_dim, policy.output_dim, motion.n_steps, motion.dt) == (dim, dim, 49, 0.1)
    torch.testing.assert_close(motion.x0, task.demonstrations[0].x[0])
    torch.testing.assert_close(scene.goal, torch.zeros(dim, dtype=torch.float64), atol=1e-9, rtol=0)
    assert scene.unit == "m" and scene.starts.shape == (1, dim)
    path, terms = task.evaluate(policy.expand(3))
    assert terms["goal"].shape == (3,) and terms["control"].eq(0).all()
    assert torch.equal(task.step_costs(path).sum(-1), task.cost(path))
    alone = Bend(dim=dim, mixture=task.mixture)
    assert alone.source is None
    torch.testing.assert_close(alone.policy().A, policy.A, rtol=0, atol=0)


def test_an_exploration_outside_the_defaults_is_refused():
    with pytest.raises(InvalidArgumentError, match=r"write defaults = \{'exploration': 'stable'\}"):
        type("Old", (Bend,), {"exploration": "stable"})


def test_its_name_is_that_of_the_class_and_its_options_are_its_fields():
    class LongerName3D(Bend):
        width: float = 2.0

    assert (Bend.name, LongerName3D.name) == ("bend", "longer_name3_d")
    assert (LongerName3D(size=3.0).size, LongerName3D(width=1.0).width, LongerName3D().dim) == (3.0, 1.0, 2)
    with pytest.raises(TypeError):
        LongerName3D(1.0)


@pytest.mark.slow
def test_a_task_that_gives_no_control_weight_has_no_control_cost():
    task = Bend()
    policy = task.policy()
    policy.unpack(2 * policy.pack().detach())
    assert float(task.evaluate(policy)[1]["control"].detach()) == 0


@pytest.mark.slow
def test_a_mixture_and_demonstrations_are_read_from_paths(tmp_path):
    own = Bend()
    own.mixture.save(tmp_path / "mixture.npz")
    given = Bend(mixture=str(tmp_path / "mixture.npz"))
    assert isinstance(given.mixture, GaussianMixture) and torch.equal(given.mixture.means, own.mixture.means)
