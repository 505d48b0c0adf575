"""Running a closure under perturbed parameters, against calls by hand."""

import numpy as np
import pytest
import torch
from torch import nn

import torchds
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.optim.evaluation import controls, evaluate

N, T, DT = 4, 6, 0.1
START = torch.tensor([-1.0, 0.5], dtype=torch.float64)


def normal(seed, *shape):
    return torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def make_policy():
    identity = torch.eye(2, dtype=torch.float64).repeat(3, 1, 1)
    priors = torch.full((3,), 1 / 3, dtype=torch.float64)
    policy = GMRPolicy(priors, normal(0, 3, 2), identity, normal(1, 3, 2, 2), normal(2, 3, 2))
    with torch.no_grad():
        policy.b.add_(0.3)  # moved away from the demonstrated one
    return policy


def noise_of(policy):
    return {p: 0.1 * normal(i + 3, N, *p.shape) for i, p in enumerate(policy.parameters())}


def make_closure(policy):
    return lambda: torchds.rollout(policy, START, T, DT).x[..., -1, :].square().sum(-1)


@pytest.mark.parametrize("batched", [True, False])
def test_costs_and_visits_are_those_of_each_perturbed_policy(batched):
    policy = make_policy()
    noise = noise_of(policy)
    with torch.no_grad():
        trial = evaluate(make_closure(policy), noise, N, batched)
        (visit,) = trial.visits
        assert visit.policy is policy
        assert visit.features.shape == (N, T, 9)
        for n in range(N):
            alone = make_policy()
            for p, (_, epsilon) in zip(alone.parameters(), noise.items(), strict=True):
                p.add_(epsilon[n])
            path = torchds.rollout(alone, START, T, DT)
            torch.testing.assert_close(trial.costs[n], path.x[-1].square().sum(), rtol=1e-12, atol=0)
            torch.testing.assert_close(visit.features[n], alone.features(path.x[:-1]), rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("batched", [True, False])
@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, RuntimeError])
def test_parameters_are_restored_whatever_the_closure_does(batched, error):
    policy = make_policy()
    noise = noise_of(policy)
    before = [p.detach().clone() for p in policy.parameters()]

    def closure():
        assert not any(torch.equal(p[0] if batched else p, value) for p, value in zip(noise, before, strict=True))
        raise error("no")

    with pytest.raises(error, match="no") as caught:
        evaluate(closure, noise, N, batched)
    assert all(map(torch.equal, policy.parameters(), before))
    notes = getattr(caught.value, "__notes__", [])
    assert any("batched=False" in note for note in notes) == (batched and error is RuntimeError)


@pytest.mark.parametrize("reference", ["demonstrated", "zero"])
def test_the_control_cost_is_the_printed_formula_of_each_step(reference):
    """Υ = r (θ* + M ε)ᵀ (θ* + M ε) with M = g gᵀ/(gᵀ g) for each output row (Algorithm 1, lines 15-16)."""
    policy, r = make_policy(), 0.7
    noise = noise_of(policy)
    with torch.no_grad():
        trial = evaluate(make_closure(policy), noise, N, batched=True)
        (control,) = controls(trial.visits, noise, dict.fromkeys(noise, r), reference)
        theta = policy.rows() - (policy.initial_rows if reference == "demonstrated" else 0.0)
        rows, epsilon, features = theta.numpy(), control.noise.numpy(), control.visit.features.numpy()
    for n in range(N):
        for t in range(T):
            g = features[n, t]
            moved = rows + epsilon[n] @ np.outer(g, g) / (g @ g)
            assert control.upsilon[n, t].item() == pytest.approx(r * (moved**2).sum(), rel=1e-10)


def test_other_policies_cost_no_control_and_one_that_is_optimised_has_to_be_there():
    policy, other = make_policy(), make_policy()
    noise = noise_of(policy)
    closure, reference = make_closure(policy), make_closure(other)
    with torch.no_grad():
        trial = evaluate(lambda: closure() + reference(), noise, N, batched=True)
        weight = dict.fromkeys(noise, 1.0)
        assert [c.visit.policy for c in controls(trial.visits, noise, weight, "zero")] == [policy]
        strangers = {nn.Parameter(torch.zeros(2)): torch.zeros(N, 2)}
        with pytest.raises(InvalidArgumentError, match="need to know which features the roll-outs"):
            controls(trial.visits, strangers, dict.fromkeys(strangers, 1.0), "zero")
