"""PI^BB as a torch optimizer: groups, checkpoints, copies, hooks, schedulers, and any nn.Module."""

import copy
import pickle
from itertools import pairwise

import pytest
import torch
from torch import nn
from torch.func import functional_call, vmap
from torch.optim import lr_scheduler

import torchds
from torchds import GMRPolicy
from torchds.errors import InvalidArgumentError
from torchds.exploration import Exploration, Gaussian, Homogeneous
from torchds.optim import PIBB, InverseIteration

START = torch.tensor([-1.0, 0.5], dtype=torch.float64)


def make_policy(dtype=torch.float64):
    generator = torch.Generator().manual_seed(4)
    shapes = {"means": (3, 2), "A": (3, 2, 2), "b": (3, 2)}
    values = {name: torch.randn(s, dtype=dtype, generator=generator) for name, s in shapes.items()}
    return GMRPolicy(
        torch.full((3,), 1 / 3, dtype=dtype), covariances=torch.eye(2, dtype=dtype).repeat(3, 1, 1), **values
    )


def make_optimizer(policy, **options):
    options = {"n_rollouts": 5, "control_weight": 0.01, **options}
    return PIBB(policy.parameters(), Homogeneous(policy, 0.2), **options)


def make_closure(policy):
    def closure():
        path = torchds.rollout(policy, START.to(policy.A.dtype), n_steps=8, dt=0.1)
        return torchds.costs.goal(path.x, torch.zeros(2, dtype=policy.A.dtype))

    return closure


def make_learner():
    policy = make_policy()
    optim = make_optimizer(policy)
    return policy, optim, lr_scheduler.LambdaLR(optim, InverseIteration(0.2))


def learn(policy, optim, decay, updates):
    for _ in range(updates):
        optim.step(make_closure(policy))
        decay.step()


def small(n_rollouts=4, **options):
    """An optimizer of two numbers, and its closure."""
    theta = nn.Parameter(torch.zeros(2))
    return PIBB([theta], Gaussian(0.3), n_rollouts, **options), lambda: (theta - 1.0).square().sum(-1)


# ------------------------------------------------------------------ groups


def test_it_is_an_optimizer_whose_options_live_in_its_groups():
    policy = make_policy()
    optim = PIBB(policy.parameters(), Homogeneous(policy), lr=0.5, eliteness=7.0, temperature="median")
    assert isinstance(optim, torch.optim.Optimizer)
    options = {"lr": 0.5, "eliteness": 7.0, "temperature": "median", "control_weight": 0.0}
    assert options.items() <= optim.defaults.items()
    (group,) = optim.param_groups
    assert group == {"params": list(policy.parameters()), **options}
    assert "eliteness: 7.0" in repr(optim)


def test_a_group_takes_what_it_does_not_say_from_the_defaults():
    a, b = nn.Parameter(torch.zeros(2)), nn.Parameter(torch.zeros(3))
    optim = PIBB([{"params": [a], "lr": 0.1}], Gaussian(0.2), lr=0.7)
    given = {"params": b, "exploration": Gaussian(0.5), "eliteness": 3.0}
    optim.add_param_group(given)
    assert [(g["lr"], g["eliteness"]) for g in optim.param_groups] == [(0.1, 10.0), (0.7, 3.0)]
    assert [e.std for e in optim.explorations] == [0.2, 0.5]
    assert set(given) == {"params", "exploration", "eliteness"}  # the caller's own dict


class Picky(Exploration):
    """Refuses with an error that is not ours."""

    def check(self, parameters):
        raise RuntimeError("not these")

    def __call__(self, parameters, normals):
        raise AssertionError


first, other = nn.Parameter(torch.zeros(2)), nn.Parameter(torch.zeros(2))


@pytest.mark.parametrize(
    ("group", "error", "message"),
    [
        ({"params": [first]}, ValueError, "some parameters appear in more than one parameter group"),
        ({"params": [other, nn.Parameter(torch.zeros(1).double())]}, InvalidArgumentError, "need one dtype and device"),
        ({"params": [other], "exploration": Gaussian([0.1, 0.2])}, InvalidArgumentError, "2 values of std for 1 param"),
        ({"params": [other], "exploration": Homogeneous(make_policy())}, InvalidArgumentError, "Homogeneous explores"),
        ({"params": [other], "exploration": 0.3}, InvalidArgumentError, "a group needs an exploration.*got 0.3"),
        ({"params": [other], "exploration": Picky()}, RuntimeError, "not these"),
        ({"params": [other], "lr": -1.0}, InvalidArgumentError, "lr has to be ≥ 0, got -1.0"),
        ({"params": [other], "temperature": "x"}, InvalidArgumentError, "temperature has to be"),
        ({"params": [("name", other)]}, ValueError, "with/without names"),
        ({"params": {other}}, TypeError, "ordered collections"),
        ({"params": [other * 2]}, ValueError, "non-leaf"),
    ],
)
def test_a_group_that_is_refused_is_not_added(group, error, message):
    optim = PIBB([first], Gaussian(0.1), n_rollouts=3)
    with pytest.raises(error, match=message):
        optim.add_param_group(group)
    assert len(optim.param_groups) == len(optim.explorations) == 1
    optim.step(lambda: first.sum(-1))


def test_a_group_added_between_ask_and_tell_is_asked_again():
    theta, late = nn.Parameter(torch.zeros(2)), nn.Parameter(torch.zeros(2))
    optim = PIBB([theta], Gaussian(0.3), n_rollouts=3)
    optim.ask()
    optim.add_param_group({"params": [late]})
    with pytest.raises(InvalidArgumentError, match=r"call ask\(\) first"):
        optim.tell(torch.zeros(3))
    optim.step(lambda: (theta + late).sum(-1))
    assert theta.any()
    assert late.any()


# ------------------------------------------------------------------ checkpoints


@pytest.mark.parametrize("asked", [False, True])
def test_a_run_continues_from_a_checkpoint_bit_for_bit(tmp_path, asked):
    whole = make_learner()
    learn(*whole, 3)
    if asked:
        whole[1].ask()
    names = ("policy", "optim", "decay")
    torch.save({name: part.state_dict() for name, part in zip(names, whole, strict=True)}, tmp_path / "run.pt")
    saved = torch.load(tmp_path / "run.pt", weights_only=True)
    resumed = make_learner()
    learn(*resumed, 1)  # whatever stood there is overwritten
    for name, part in zip(names, resumed, strict=True):
        part.load_state_dict(saved[name])
    assert resumed[1].param_groups[0]["lr"] == whole[1].param_groups[0]["lr"] == 0.5
    for learner in (whole, resumed):
        if asked:
            learner[1].param_groups[0]["control_weight"] = 0.0
            learner[1].tell(torch.arange(5, dtype=torch.float64))
        learn(*learner, 3)
    assert torch.equal(whole[0].pack(), resumed[0].pack())
    assert torch.equal(whole[1].generator.get_state(), resumed[1].generator.get_state())
    assert all(map(torch.equal, whole[1].last, resumed[1].last))


def test_two_optimizers_share_nothing_after_loading_without_a_file():
    policy, optim, decay = make_learner()
    twin, twin_optim, _ = make_learner()
    asked = optim.ask()
    twin_optim.load_state_dict(optim.state_dict())
    learn(policy, optim, decay, 2)
    seen = []
    twin_optim.step(lambda: seen.extend(p.data for p in twin.parameters()) or make_closure(twin)())
    assert all(map(torch.equal, asked, seen))
    assert twin_optim.param_groups[0]["lr"] == 1.0 != optim.param_groups[0]["lr"]


class Counting(Exploration):
    """Changes while learning: every call halves the noise."""

    def __init__(self):
        self.calls = 0

    def __call__(self, parameters, normals):
        self.calls += 1
        return [z * 0.5**self.calls for z in normals]

    def state_dict(self):
        return {"calls": self.calls}

    def load_state_dict(self, state):
        self.calls = state["calls"]


def test_explorations_are_part_of_the_checkpoint():
    def make():
        parameters = [nn.Parameter(torch.zeros(1)), nn.Parameter(torch.zeros(1))]
        return PIBB([{"params": [p], "exploration": Counting()} for p in parameters], n_rollouts=2)

    optim, other = make(), make()
    for _ in range(3):
        optim.step(lambda: torch.arange(2.0))
    optim.explorations[1].calls = 8
    other.load_state_dict(optim.state_dict())
    assert [e.calls for e in other.explorations] == [3, 8]


@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.parametrize(
    "duplicate", [copy.deepcopy, lambda x: pickle.loads(pickle.dumps(x))], ids=["deepcopy", "pickle"]
)
def test_a_copy_continues_equally_on_parameters_of_its_own(duplicate, asked):
    policy, optim, decay = make_learner()
    learn(policy, optim, decay, 2)
    if asked:
        optim.ask()
    twin, twin_optim = duplicate((policy, optim))
    assert [id(p) for p in twin_optim.param_groups[0]["params"]] == [id(p) for p in twin.parameters()]
    assert twin_optim.explorations[0].policy is twin
    assert all(map(torch.equal, twin_optim.last, optim.last))
    before = twin.pack()
    for _ in range(3):
        optim.step(make_closure(policy))
    assert torch.equal(twin.pack(), before)  # independent
    for _ in range(3):
        twin_optim.step(make_closure(twin))
    assert torch.equal(twin.pack(), policy.pack())
    assert not torch.equal(twin.pack(), before)
    twin_optim.add_param_group({"params": [nn.Parameter(torch.zeros(1))], "exploration": Gaussian(0.1)})
    assert len(optim.param_groups) == len(optim.explorations) == 1


# ------------------------------------------------------------------ hooks


def test_step_hooks_fire_once_for_a_step_and_once_for_tell():
    optim, closure = small()
    fired = []
    optim.register_step_pre_hook(lambda *_: fired.append("pre"))
    optim.register_step_post_hook(lambda *_: fired.append("post"))
    optim.step(closure)
    assert fired == ["pre", "post"]
    optim.ask()
    assert fired == ["pre", "post"]
    optim.tell(torch.arange(4.0))
    assert fired == ["pre", "post"] * 2


def test_state_dict_hooks_fire_once():
    optim, _ = small()
    fired = []
    optim.register_state_dict_pre_hook(lambda _: fired.append("save"))
    optim.register_state_dict_post_hook(lambda _, state: fired.append("saved") or {**state, "mine": 1})
    optim.register_load_state_dict_pre_hook(lambda *_: fired.append("load"))
    optim.register_load_state_dict_post_hook(lambda _: fired.append("loaded"))
    state = optim.state_dict()
    assert state["mine"] == 1
    assert set(state) == {"state", "param_groups", "search", "generator", "explorations", "mine"}
    optim.load_state_dict(state)
    assert fired == ["save", "saved", "load", "loaded"]


# ------------------------------------------------------------------ schedulers

SCHEDULERS = {
    "LambdaLR": lambda o: lr_scheduler.LambdaLR(o, InverseIteration()),
    "MultiplicativeLR": lambda o: lr_scheduler.MultiplicativeLR(o, lambda epoch: 0.9),
    "StepLR": lambda o: lr_scheduler.StepLR(o, 2),
    "MultiStepLR": lambda o: lr_scheduler.MultiStepLR(o, [2, 4]),
    "ConstantLR": lambda o: lr_scheduler.ConstantLR(o, 0.5, 3),
    "LinearLR": lambda o: lr_scheduler.LinearLR(o, 0.2, 1.0, 4),
    "ExponentialLR": lambda o: lr_scheduler.ExponentialLR(o, 0.8),
    "CosineAnnealingLR": lambda o: lr_scheduler.CosineAnnealingLR(o, 6),
    "CosineAnnealingWarmRestarts": lambda o: lr_scheduler.CosineAnnealingWarmRestarts(o, 3),
    "ReduceLROnPlateau": lambda o: lr_scheduler.ReduceLROnPlateau(o, patience=0, threshold=10.0),
    "CyclicLR": lambda o: lr_scheduler.CyclicLR(o, 0.1, 0.8, 2, cycle_momentum=False),
    "OneCycleLR": lambda o: lr_scheduler.OneCycleLR(o, 0.9, total_steps=8, cycle_momentum=False),
    "PolynomialLR": lambda o: lr_scheduler.PolynomialLR(o, 6),
    "ChainedScheduler": lambda o: lr_scheduler.ChainedScheduler(
        [lr_scheduler.ConstantLR(o, 0.5, 2), lr_scheduler.ExponentialLR(o, 0.9)]
    ),
    "SequentialLR": lambda o: lr_scheduler.SequentialLR(
        o, [lr_scheduler.ConstantLR(o, 0.5, 2), lr_scheduler.ExponentialLR(o, 0.9)], [3]
    ),
}


def test_the_list_of_schedulers_is_complete():
    assert set(SCHEDULERS) == set(lr_scheduler.__all__) - {"LRScheduler"}


@pytest.mark.parametrize("name", SCHEDULERS)
@pytest.mark.parametrize("halves", [False, True], ids=["step", "ask and tell"])
def test_every_torch_scheduler_decays_the_exploration_as_it_does_sgd(name, halves):
    optim, closure = small(lr=0.6)
    sgd = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=0.6)
    schedulers = [SCHEDULERS[name](o) for o in (optim, sgd)]
    z = torch.arange(1.0, 9.0).reshape(4, 2)
    rates = []
    for _ in range(6):
        theta = optim.param_groups[0]["params"][0].detach().clone()
        (tried,) = optim.ask([[z]])
        rates.append(sgd.param_groups[0]["lr"])
        torch.testing.assert_close(tried - theta, 0.3 * rates[-1] * z, rtol=1e-5, atol=1e-6)
        cost = optim.tell(torch.arange(4.0)) if halves else optim.step(closure)
        sgd.step()
        for scheduler in schedulers:
            scheduler.step(*([cost] if name == "ReduceLROnPlateau" else []))
        assert optim.param_groups[0]["lr"] == sgd.param_groups[0]["lr"]
    assert any(a != b for a, b in pairwise(rates))


# ------------------------------------------------------------------ any module, beside any optimizer


def test_zero_grad_is_harmless_and_gradients_are_left_alone():
    optim, closure = small()
    (theta,) = optim.param_groups[0]["params"]
    optim.zero_grad()
    closure().backward()
    gradient = theta.grad.clone()
    optim.step(closure)
    assert torch.equal(theta.grad, gradient)
    optim.zero_grad()
    assert theta.grad is None


def test_it_takes_turns_with_adam_on_one_closure():
    policy = make_policy()
    search, adam = make_optimizer(policy), torch.optim.Adam(policy.parameters(), lr=0.05)
    closure = make_closure(policy)

    def with_gradient():
        adam.zero_grad()
        cost = closure()
        cost.backward()
        return cost

    before = closure().item()
    for _ in range(5):
        search.step(closure)
        adam.step(with_gradient)
    assert policy.A.grad.shape == policy.A.shape
    assert closure().item() < before


def make_regression(dtype=torch.float32):
    generator = torch.Generator().manual_seed(8)
    linear = nn.Linear(3, 2, dtype=dtype)
    with torch.no_grad():
        for p in linear.parameters():
            p.zero_()
    x = torch.randn(20, 3, dtype=dtype, generator=generator)
    y = x @ torch.randn(3, 2, dtype=dtype, generator=generator) + 0.5
    return linear, x, y


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.slow
def test_any_module_learns_with_one_call_per_rollout(dtype):
    linear, x, y = make_regression(dtype)
    optim = PIBB(linear.parameters(), Gaussian(0.2), n_rollouts=10, batched=False)
    costs = [optim.step(lambda: (linear(x) - y).square().mean()) for _ in range(60)]
    assert costs[-1].dtype == linear.weight.dtype == dtype
    assert costs[-1] < 0.2 * costs[0]


def test_a_module_that_does_not_broadcast_is_told_about_batched():
    linear, x, _ = make_regression()
    optim = PIBB(linear.parameters(), Gaussian(0.2), n_rollouts=4)
    for closure in (lambda: linear(x).mean(), lambda: linear.bias.mean()):
        with pytest.raises((RuntimeError, InvalidArgumentError), match=r"does not broadcast over.*use batched=False"):
            optim.step(closure)
    assert linear.weight.shape == (2, 3)


def test_ask_gives_named_parameters_by_name_for_functional_call():
    linear, x, y = make_regression()
    optim = PIBB(linear.named_parameters(), Gaussian(0.2), n_rollouts=8)
    other, *_ = make_regression()
    loop = PIBB(other.parameters(), Gaussian(0.2), n_rollouts=8, batched=False)
    for _ in range(4):
        tried = optim.ask()
        assert {name: t.shape for name, t in tried.items()} == {"weight": (8, 2, 3), "bias": (8, 2)}
        predicted = vmap(lambda parameters: functional_call(linear, parameters, (x,)))(tried)
        optim.tell((predicted - y).square().mean((-1, -2)))
        loop.step(lambda: (other(x) - y).square().mean())
    torch.testing.assert_close(linear.weight, other.weight, rtol=1e-4, atol=1e-5)
    assert linear.weight.any()


def test_ask_gives_a_list_in_order_for_parameters_without_names():
    linear, *_ = make_regression()
    tried = PIBB(linear.parameters(), Gaussian(0.2), n_rollouts=8).ask()
    assert [t.shape for t in tried] == [(8, 2, 3), (8, 2)]
    assert not any(t.requires_grad for t in tried)
