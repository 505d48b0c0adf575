"""What all released problems have: no demonstrations of their own, the explicit plant, a floor that is added twice."""

import pytest
import torch

import tasks
from tasks.released import base
from tasks.released.base import Released, released_plant
from torchds import Demonstrations, GaussianMixture
from torchds.errors import InvalidArgumentError
from torchds.plants import Command

NAMES = [name for name, classes in tasks.TASKS.items() if "released" in classes]


def test_every_problem_of_the_program_has_a_class_of_its_own():
    assert set(NAMES) == {"via_point", "two_starts", "constrained_reaching", "divergent_field", "half_plane_force"}
    for name in NAMES:
        cls = tasks.registry.task_class(name, "released")
        assert issubclass(cls, Released) and issubclass(cls, tasks.registry.task_class(name))


@pytest.mark.parametrize("name", NAMES)
def test_without_data_it_says_what_to_give(name):
    with pytest.raises(
        InvalidArgumentError, match=rf"{name} .*no demonstrations.*give demonstrations=PATH or mixture=PATH"
    ):
        tasks.make(name, convention="released").policy()


def test_the_plant_is_a_unit_mass_with_unit_damping_pulled_at_ten():
    """One explicit step by hand: a = 10 (x_ref − x) + 2 √10 (v_ref − v) − v."""
    plant = released_plant()
    x, reference, v = (torch.tensor(value, dtype=torch.float64) for value in ([1.0, -2.0], [1.5, -1.0], [0.3, 0.2]))
    state = plant.step(plant.reset(x), Command(x=reference, v=v, x_before=x, v_before=v, stiffness=None, t=0.0, dt=0.1))
    a = 10 * (reference - x) + 2 * 10**0.5 * v
    torch.testing.assert_close(state.v, 0.1 * a, rtol=1e-12, atol=0)
    torch.testing.assert_close(state.x, x + 0.01 * a, rtol=1e-12, atol=0)


@pytest.mark.parametrize("own", [False, True])
def test_positions_alone_are_paired_with_forward_differences_and_own_velocities_stay(own, monkeypatch):
    """What is learned from: x_{t+1} = x_t + v_t dt of the positions, or what was recorded."""
    x = torch.linspace(0, 3, 12, dtype=torch.float64)[:, None] ** torch.tensor([2.0, 3.0])
    v = [0.9 * x] if own else None
    given = Demonstrations([x], v, dt=0.1).shift_to_goal([0.3, -0.7])  # which rounds other digits
    seen = []

    def fit(demonstrations, n_components, **settings):
        seen.extend(demonstrations)
        return GaussianMixture(torch.ones(1), torch.zeros(1, 4), torch.eye(4)[None])

    monkeypatch.setattr(base.GaussianMixture, "fit", fit)
    assert tasks.make("via_point", convention="released", demonstrations=given).mixture.n_components == 1
    (d,) = seen
    if own:
        assert torch.equal(d.x, given[0].x) and torch.equal(d.v, v[0])
    else:
        assert torch.equal(d.x, given[0].x[:-1])
        torch.testing.assert_close(d.x + 0.1 * d.v, given[0].x[1:], rtol=0, atol=1e-14)
