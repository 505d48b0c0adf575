"""A step is all or nothing, state comes back bit for bit or is refused, and wrong input is refused in our words."""

import copy
import functools
import math
import sys
import warnings
from decimal import Decimal
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import torch
from hypothesis import strategies as st
from torch import nn

import torchds
from tests.faults.cases import fuzz
from torchds import visits
from torchds.errors import AllRolloutsFailedError, EqualCostsWarning, InvalidArgumentError, TorchdsError
from torchds.exploration import Exploration, Gaussian, Homogeneous, Stable, TrajectorySpace
from torchds.optim import PI2, PI2CMA, PIBB, SurrogatePIBB
from torchds.optim.evaluation import controls
from torchds.optim.functional import cost_weights, relative_costs
from torchds.optim.regression import Regression

N, T, DT = 4, 5, 0.1
SEARCHES = {"PIBB": PIBB, "PI2": PI2, "PI2CMA": PI2CMA, "SurrogatePIBB": SurrogatePIBB}
PACKAGE = str(Path(torchds.__file__).parent)
each_search = pytest.mark.parametrize("name", SEARCHES)


def make_policy(dtype=torch.float64, Q=0, batch=(), seed=4):
    generator = torch.Generator().manual_seed(seed)

    def draw(*shape):
        return torch.randn(*shape, generator=generator, dtype=torch.float64).to(dtype)

    stiffness = (draw(2, Q, 2), draw(2, Q)) if Q else ()
    gate = torch.full((2,), 0.5, dtype=dtype), draw(2, 2), torch.eye(2, dtype=dtype).repeat(2, 1, 1)
    policy = torchds.GMRPolicy(*gate, draw(2, 2, 2), draw(2, 2), *stiffness)
    return policy.expand(*batch) if batch else policy


def start(policy):
    return torch.tensor([-1.0, 0.5], dtype=policy.A.dtype)


@pytest.fixture(scope="module", autouse=True)
def _imported():
    """The first optimizer, and the first state that is loaded, import a large part of torch."""
    optim = PIBB([nn.Parameter(torch.zeros(1))], Gaussian(0.1))
    optim.load_state_dict(optim.state_dict())


EXPLORATIONS = {
    "Gaussian": lambda policy: Gaussian(0.1),
    "Homogeneous": lambda policy: Homogeneous(policy, 0.2, mean_stiffness=0.1),
    "TrajectorySpace": lambda policy: TrajectorySpace(
        policy, start(policy), T, DT, 0.1, stiffness_spread=0.1, mean_stiffness=0.1
    ),
}


def make(name, policy=None, exploration="Gaussian", seed=0, **options):
    policy = make_policy() if policy is None else policy
    options = {"n_rollouts": N, "control_weight": 0.01, **options}
    options |= {"n_candidates": 8, "memory": 6} if name == "SurrogatePIBB" else {}
    generator = torch.Generator().manual_seed(seed)
    optim = SEARCHES[name](policy.parameters(), EXPLORATIONS[exploration](policy), generator=generator, **options)
    return policy, optim


def trial(policy, optim):
    """Costs of the policies as they stand, per step where the search wants them so."""

    def closure():
        path = torchds.rollout(policy, start(policy), T, DT)
        steps = path.x[..., 1:, :].square().sum(-1)
        return steps if optim.costs_per_step else steps.sum(-1)

    return closure


def bits(value):
    """All of a nested value, to the last bit."""
    if isinstance(value, torch.Tensor):
        value = value.detach()
        return str(value.dtype), tuple(value.shape), value.numpy().tobytes()
    if isinstance(value, dict):
        return {name: bits(entry) for name, entry in value.items()}
    return [bits(entry) for entry in value] if isinstance(value, (list, tuple)) else repr(value)


def everything(optim):
    """Parameters, state, options and generator to the last bit."""
    parameters = [p.data for group in optim.param_groups for p in group["params"]]
    state = optim.state_dict()
    state["state"] = {i: entries for i, entries in state["state"].items() if entries}
    return bits([parameters, state, optim.last])


# ------------------------------------------------------------------ frozen parameters


@each_search
@pytest.mark.parametrize("exploration", EXPLORATIONS)
@pytest.mark.parametrize("frozen", [["A"], ["b"], ["stiffness_A", "b"], ["A", "b", "stiffness_A", "stiffness_b"]])
def test_frozen_parameters_are_neither_moved_nor_perturbed(name, exploration, frozen):
    policy = make_policy(Q=1)
    for p in frozen:
        policy.get_parameter(p).requires_grad_(False)
    policy, optim = make(name, policy, exploration)
    before = {p: bits(value) for p, value in policy.named_parameters()}
    seen = []

    def closure():
        seen.append({p: value.data.clone() for p, value in policy.named_parameters()})
        path = torchds.rollout(policy, start(policy), T, DT)
        steps = path.x[..., 1:, :].square().sum(-1) + path.stiffness.square().sum(-1)
        return steps if optim.costs_per_step else steps.sum(-1)

    with warnings.catch_warnings():
        warnings.simplefilter("error" if len(frozen) < 4 else "ignore")
        for _ in range(4):
            optim.step(closure)
    for p, value in policy.named_parameters():
        tried = torch.stack([trial[p] for trial in seen])
        assert (bits(value) == before[p]) == (p in frozen)
        assert (tried == tried[:, :1]).all() == (p in frozen)


def test_a_parameter_frozen_later_stays_where_it_is_then():
    policy, optim = make("PI2CMA")
    for i in range(6):
        policy.b.requires_grad_(i not in (2, 3))
        before = policy.b.detach().clone()
        optim.step(trial(policy, optim))
        assert torch.equal(policy.b, before) == (i in (2, 3))
    assert (torch.linalg.eigvalsh(optim.state[policy.A]["covariance"]) > 0).all()


def test_the_best_so_far_does_not_bring_a_frozen_parameter_back():
    policy, optim = make("PIBB", elite="best")
    optim.step(trial(policy, optim))
    policy.A.requires_grad_(False)
    A, _ = optim.ask()
    assert torch.equal(A, policy.A.expand(N, *policy.A.shape))


def test_noise_along_the_motion_is_that_of_the_free_parameters_alone():
    """C = (JᵀJ/(T spread²) + D⁻¹)⁻¹ over b, not a cut of the one over A and b."""
    policy = make_policy()
    J = TrajectorySpace(policy, start(policy), T, DT, 0.1, damping=0.0)
    J.refresh_now()
    std = policy.join(J._homogeneous.std())
    free = policy.pack(lambda p: torch.full_like(p, float(p is policy.b))).bool()
    expected = torch.linalg.inv(J._felt[free][:, free] + torch.diag(1 / (J.widening * std[free]) ** 2))
    policy.A.requires_grad_(False)
    found = TrajectorySpace(policy, start(policy), T, DT, 0.1, damping=0.0).covariance
    torch.testing.assert_close(found[free][:, free], expected, rtol=1e-8, atol=0)
    assert not found[~free].any()
    assert not torch.allclose(J.covariance[free][:, free], expected, rtol=0.01)


def test_stable_wants_both_or_none_of_a_and_b_frozen():
    policy = make_policy()
    policy.A.data[:] = -torch.eye(2, dtype=torch.float64)
    policy.b.data.zero_()
    noise, goal = Gaussian(0.1), torch.zeros(2, dtype=torch.float64)
    optim = PIBB(policy.parameters(), Stable(policy, noise, goal), n_rollouts=N)
    policy.b.requires_grad_(False)
    for call in (optim.ask, lambda: PIBB(policy.parameters(), Stable(policy, noise, goal))):
        with pytest.raises(InvalidArgumentError, match="both have to be free or both frozen"):
            call()


def test_frozen_parameters_cost_no_control():
    policy, optim = make("PIBB", control_weight=0.7, eliteness=5.0)
    policy.b.data += 0.3  # away from the demonstrated one
    policy.A.data += 0.2
    policy.A.requires_grad_(False)
    optim.ask()
    noise = {p: optim.state[p]["noise"] for p in policy.parameters()}
    free = policy.rows(lambda p: torch.full_like(p, float(p.requires_grad))).bool()[0].numpy()
    theta = (policy.rows() - policy.initial_rows).detach().numpy()
    epsilon = policy.rows(lambda p: noise[p]).numpy()
    seen = []
    optim.step(lambda: seen.append(torchds.rollout(policy, start(policy), T, DT)) or torch.arange(4.0))
    for n in range(N):
        upsilon = 0.0
        for g in seen[0].features[n].numpy():
            M = np.outer(g[free], g[free]) / (g[free] @ g[free])  # line 15 of Algorithm 1, of what is free alone
            upsilon += 0.7 * ((theta[:, free] + epsilon[n][:, free] @ M) ** 2).sum()
        assert optim.last.control[n].item() == pytest.approx(0.5 * upsilon, rel=1e-10)


@pytest.mark.parametrize("weighting", ["time", "gating"])
def test_pi2_projects_onto_what_is_free(weighting):
    """Every step by hand: δθ_t = Σ_r P_r M_r ε_r with M of the free parameters."""
    policy, optim = make("PI2", weighting=weighting, control_weight=0.0)
    policy.A.requires_grad_(False)
    optim.ask()
    rows = policy.rows(lambda p: optim.state[p]["noise"]).numpy()
    before, seen = policy.b.detach().clone(), []

    def closure():
        seen.append(torchds.rollout(policy, start(policy), T, DT))
        return seen[0].x[..., 1:, :].square().sum(-1)

    optim.step(closure)
    features, gating = seen[0].features.numpy(), seen[0].gating.numpy()
    costs = seen[0].x[..., 1:, :].square().sum(-1).numpy()
    b = [2, 5]  # of [A_1 row, b_1, A_2 row, b_2]
    update, size = np.zeros((2, 2)), np.zeros(2)
    for t in range(T):
        weights = cost_weights(torch.from_numpy(costs[:, t:].sum(1))).numpy()
        share = (T - t) * (gating[:, t].mean(0) if weighting == "gating" else np.ones(2))
        size += share
        for n in range(N):
            g = features[n, t][b]
            update += share * weights[n] * (rows[n][:, b] @ np.outer(g, g)) / (g @ g)
    torch.testing.assert_close(policy.b - before, torch.from_numpy((update / size).T), rtol=1e-9, atol=1e-13)


# ------------------------------------------------------------------ costs

TYPES = {
    **{
        str(dtype): lambda c, d=dtype: torch.tensor(c, dtype=d)
        for dtype in (torch.float16, torch.bfloat16, torch.float32)
    },
    **{str(dtype): lambda c, d=dtype: torch.tensor(c, dtype=d) for dtype in (torch.float64, torch.int64, torch.uint8)},
    "with gradient": lambda c: torch.tensor(c, requires_grad=True),
    "numpy": lambda c: np.array(c),
    "numpy of integers": lambda c: np.array(c, dtype=np.int32),
    "long double": lambda c: np.array(c, dtype=np.longdouble),
    "list": list,
    "tuple": tuple,
    "list of tensors": lambda c: [torch.tensor(x) for x in c],
    "Decimal": lambda c: [Decimal(x) for x in c],
    "Fraction": lambda c: [Fraction(x) for x in c],
    "sparse": lambda c: torch.tensor(c).to_sparse(),
}


@pytest.mark.parametrize("kind", TYPES)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("name", ["PIBB", "PI2CMA", "SurrogatePIBB"])
def test_costs_of_any_type_are_those_numbers(kind, dtype, name):
    values = [3.0, 1.0, 0.0, 7.0]
    learned = []
    for costs in (torch.tensor(values, dtype=dtype), TYPES[kind](values)):
        for half in (False, True):
            policy, optim = make(name, make_policy(dtype), control_weight=0.0, elite="nominal")
            for _ in range(3):
                if half:
                    optim.ask()
                    mean = optim.tell(costs)
                else:
                    mean = optim.step(lambda costs=costs: costs)
            assert mean.dtype == policy.A.dtype == dtype
            assert all(value.dtype == dtype for value in optim.last[:3])
            learned.append(bits([policy.pack(), optim.state_dict()["state"]]))
    assert all(found == learned[0] for found in learned)


@pytest.mark.parametrize(
    ("costs", "message"),
    [
        (None, r"got NoneType None; does the closure end with `return cost`\?"),
        ({"goal": torch.zeros(N)}, r"got dict .*return their sum, e\.g\. sum\(terms\.values\(\)\)"),
        ((torch.zeros(N), {"x": 1}), "got tuple .*return the cost alone"),
        ((torch.zeros(N), torch.zeros(N)), "got tuple .*return the cost alone"),
        ([torch.zeros(N), torch.zeros(N)], "numbers, got list"),
        ([[1.0], [2.0, 3.0]], "numbers, got list"),
        (["1", "2", "3", "4"], "numbers, got list"),
        ("cost", "numbers, got str"),
        (torch.zeros(N, dtype=torch.complex64), "numbers, got Tensor"),
        ([10**400] * N, "numbers, got list"),
        (torch.zeros(N, device="meta"), "numbers, got Tensor"),
        (object(), "numbers, got object"),
        (torch.zeros(N + 1), "costs of shape"),
        (1.0, "costs of shape"),
        (torch.zeros(()), "costs of shape"),
        (torch.zeros(0), "costs of shape"),
    ],
)
def test_costs_of_another_kind_are_refused_and_nothing_changes(costs, message):
    _, optim = make("PIBB", control_weight=0.0)
    before = everything(optim)
    with pytest.raises(InvalidArgumentError, match=message):
        optim.step(lambda: costs)
    assert everything(optim) == before
    optim.ask()
    before = everything(optim)
    with pytest.raises(InvalidArgumentError, match=message):
        optim.tell(costs)
    assert everything(optim) == before


def test_calls_that_differ_are_refused():
    policy, optim = make("PIBB", batched=False)
    lengths = iter([5, 5, 6, 5])
    with pytest.raises(InvalidArgumentError, match="every call of the closure has to return a cost of the same shape"):
        optim.step(lambda: torchds.rollout(policy, start(policy), next(lengths), DT).x.sum())


@each_search
def test_equal_costs_leave_the_parameters_with_one_warning(name):
    policy, optim = make(name, control_weight=0.0)
    before = bits(policy.pack())

    def level():
        path = torchds.rollout(policy, start(policy), T, DT)
        return torch.ones(N, T) if optim.costs_per_step else torch.ones(path.x.shape[:1])

    with pytest.warns(EqualCostsWarning, match=r"all roll-outs of 1 of 1 runs cost the same.*Explore more"):
        optim.step(level)
    for _ in range(3):
        optim.step(level)  # once is enough
    assert bits(policy.pack()) == before
    assert "covariance" not in optim.state[policy.A] or torch.equal(
        optim.state[policy.A]["covariance"], torch.eye(12, dtype=torch.float64)
    )
    optim.step(trial(policy, optim))
    assert bits(policy.pack()) != before


def test_of_a_batch_only_the_runs_with_equal_costs_stay():
    policy, optim = make("PIBB", make_policy(batch=(3,)), control_weight=0.0)
    before = policy.pack().detach().clone()
    costs = torch.arange(12.0).reshape(4, 3)
    costs[:, 1] = 2.0
    costs[1:, 2] = torch.nan  # one of four came back: that is something
    with pytest.warns(EqualCostsWarning, match="of 1 of 3 runs"):
        optim.step(lambda: costs)
    assert (policy.pack() != before).any(-1).tolist() == [True, False, True]


@pytest.mark.parametrize("temperature", ["range", "median", "capped"])
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_costs_whose_range_overflows_still_update(temperature, dtype):
    top = torch.finfo(dtype).max
    shares = torch.tensor([-1.0, 0.5, 1.0, 0.9], dtype=dtype)
    expected = relative_costs(shares, temperature)
    torch.testing.assert_close(relative_costs(shares * top, temperature), expected, rtol=1e-5, atol=0)
    policy, optim = make("PIBB", make_policy(dtype), control_weight=0.0, temperature=temperature)
    tried = optim.ask()
    mean = optim.tell(shares * top)
    torch.testing.assert_close(mean, shares.mean() * top, rtol=1e-5, atol=0)
    weights = cost_weights(shares, 10.0, temperature)
    torch.testing.assert_close(policy.b.data, torch.einsum("n,nkd->kd", weights, tried[1]), rtol=1e-4, atol=1e-6)


def test_coordinates_near_the_largest_number_are_predicted():
    tried = torch.tensor([[1e200, 0.0], [-1e200, 1.0], [3.0, 4.0]], dtype=torch.float64)
    found = Regression(tried, torch.tensor([1.0, 2.0, 3.0], dtype=torch.float64)).predict(tried + 1)
    assert found.isfinite().all()


@pytest.mark.slow
def test_a_step_does_not_look_at_autocast():
    results = []
    for enabled in (False, True):
        for name in SEARCHES:
            policy, optim = make(name, make_policy(torch.float32))
            with torch.autocast("cpu", dtype=torch.bfloat16, enabled=enabled):
                for _ in range(3):
                    optim.step(trial(policy, optim))
            results.append(bits([policy.pack(), optim.state_dict()["state"]]))
    assert results[:4] == results[4:]


# ------------------------------------------------------------------ all or nothing


class Interrupt:
    """Raises KeyboardInterrupt before the n-th line of torchds that runs."""

    def __init__(self, at, within=PACKAGE):
        self.left, self.within = at, within

    def __enter__(self):
        self.outer = sys.gettrace()
        sys.settrace(self.trace)
        return self

    def __exit__(self, *_):
        sys.settrace(self.outer)

    def trace(self, frame, event, _):
        if not frame.f_code.co_filename.startswith(self.within):
            return self.trace if event == "call" else None
        if event == "line":
            self.left -= 1
            if self.left == 0:
                raise KeyboardInterrupt
        return self.trace


def lines(call):
    """How many lines of torchds a call runs."""
    with Interrupt(0) as counter:
        call()
    return -counter.left


CALLS = {
    "step": lambda policy, optim: optim.step(trial(policy, optim)),
    "ask": lambda policy, optim: optim.ask(),
    "tell": lambda policy, optim: optim.step(trial(policy, optim)),  # of what was asked
    "load": lambda policy, optim: optim.load_state_dict(optim.other),
}


def prepared(name, call, exploration, elite):
    policy, optim = make(name, None, exploration, elite=elite)
    for _ in range(2):
        optim.step(trial(policy, optim))
    if call == "tell":
        optim.ask()
    if call == "load":
        other_policy, other = make(name, None, exploration, seed=7, elite=elite)
        for _ in range(3):
            other.step(trial(other_policy, other))
        optim.other = copy.deepcopy(other.state_dict())
    return policy, optim


@fuzz(
    usual=24,
    name=st.sampled_from(list(SEARCHES)),
    call=st.sampled_from(list(CALLS)),
    exploration=st.sampled_from(list(EXPLORATIONS)),
    elite=st.sampled_from(["none", "nominal"]),
    where=st.floats(0, 1),
)
@pytest.mark.slow
def test_an_interruption_anywhere_leaves_all_or_nothing(name, call, exploration, elite, where):
    total = lines(functools.partial(CALLS[call], *prepared(name, call, exploration, elite)))
    interrupted(name, call, exploration, elite, at=1 + int(where * (total - 1)))


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.slow
def test_an_interruption_of_the_last_lines_leaves_all_or_nothing(call):
    total = lines(functools.partial(CALLS[call], *prepared("PIBB", call, "Gaussian", "none")))
    for at in range(total - 8, total + 1):
        interrupted("PIBB", call, "Gaussian", "none", at)


def interrupted(name, call, exploration, elite, at):
    policy, optim = prepared(name, call, exploration, elite)
    before = everything(optim)
    CALLS[call](policy, optim)
    after = everything(optim)
    assert after != before
    policy, optim = prepared(name, call, exploration, elite)
    assert everything(optim) == before
    with pytest.raises(KeyboardInterrupt), Interrupt(at):
        CALLS[call](policy, optim)
    assert everything(optim) == before
    assert visits.listener.get() is None
    CALLS[call](policy, optim)  # as if nothing had been
    assert everything(optim) == after


@fuzz(usual=8, name=st.sampled_from(list(SEARCHES)), at=st.integers(1, 60))
@pytest.mark.slow
def test_an_interruption_of_the_restoring_itself_restores_too(name, at):
    policy, optim = prepared(name, "tell", "TrajectorySpace", "nominal")
    before = everything(optim)

    def fails():
        trial(policy, optim)()
        sys.settrace(interrupt.trace)
        raise ZeroDivisionError

    outer = sys.gettrace()
    interrupt = Interrupt(at, within=str(Path(PACKAGE) / "optim" / "transaction.py"))
    with pytest.raises((ZeroDivisionError, KeyboardInterrupt)):
        try:
            optim.step(fails)
        finally:
            sys.settrace(outer)  # coverage, if it is measured
    assert everything(optim) == before


@fuzz(
    usual=20,
    name=st.sampled_from(list(SEARCHES)),
    function=st.sampled_from(
        [
            "torch.linalg.eigh",
            "torch.linalg.cholesky",
            "torch.randn",
            "torch.softmax",
            "torch.cdist",
            "torch.Tensor.add_",
        ]
    ),
    at=st.integers(1, 4),
    error=st.sampled_from([KeyboardInterrupt, RuntimeError, MemoryError, torch.linalg.LinAlgError]),
)
@pytest.mark.slow
def test_a_function_that_raises_leaves_nothing_half_done(name, function, at, error):
    policy, optim = prepared(name, "step", "TrajectorySpace", "nominal")
    before, calls = everything(optim), []
    where, _, attribute = function.rpartition(".")
    owner = {"torch": torch, "torch.linalg": torch.linalg, "torch.Tensor": torch.Tensor}[where]
    original = getattr(owner, attribute)

    def raising(*args, **kwargs):
        calls.append(1)
        if len(calls) == at:
            raise error("injected")
        return original(*args, **kwargs)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(owner, attribute, raising)
        try:
            optim.step(trial(policy, optim))
        except error:
            assert everything(optim) == before
        else:
            assert len(calls) < at


@each_search
def test_where_all_fail_nothing_changes(name):
    for asked in (False, True):
        policy, optim = prepared(name, "tell" if asked else "step", "TrajectorySpace", "nominal")
        before = everything(optim)
        with pytest.raises(AllRolloutsFailedError):
            optim.step(lambda policy=policy, optim=optim: trial(policy, optim)() * torch.nan)
        assert everything(optim) == before


class Wrong(Exploration):
    """Gives something that is no noise."""

    def __init__(self, noise):
        self.noise = noise

    def __call__(self, parameters, normals):
        return self.noise(normals)


@pytest.mark.parametrize(
    ("noise", "message"),
    [
        (lambda z: z[:1], "has to give noise of shapes"),
        (lambda z: [e[:-1] for e in z], "has to give noise of shapes"),
        (lambda z: [None for _ in z], "has to give noise of shapes"),
        (lambda z: [e * torch.nan for e in z], "is not finite; explore less"),
        (lambda z: [e + torch.inf for e in z], "is not finite; explore less"),
    ],
)
def test_noise_that_is_none_is_refused(noise, message):
    policy = make_policy()
    optim = PIBB(policy.parameters(), Wrong(noise), n_rollouts=N)
    before = everything(optim)
    for call in (optim.ask, lambda: optim.step(trial(policy, optim))):
        with pytest.raises(InvalidArgumentError, match=message):
            call()
        assert everything(optim) == before


# ------------------------------------------------------------------ random costs and options

SPECIAL = [0.0, -0.0, 1.0, -3.5, 1e-320, 1e300, -1e300, 1.7e308, -1.7e308, math.inf, -math.inf, math.nan]


@fuzz(
    usual=40,
    name=st.sampled_from(list(SEARCHES)),
    dtype=st.sampled_from([torch.float32, torch.float64]),
    cost_dtype=st.sampled_from([torch.float16, torch.float32, torch.float64, torch.int64, torch.bool]),
    shape=st.sampled_from([(N,), (N, T), (N, 1), (N + 1,), (), (0,), (N, 0), (1, N)]),
    values=st.lists(st.sampled_from(SPECIAL), min_size=N * T, max_size=N * T),
    temperature=st.sampled_from(["range", "median", "capped"]),
    elite=st.sampled_from(["none", "nominal", "best"]),
)
@pytest.mark.slow
def test_any_costs_lead_to_finite_parameters_or_are_refused(name, dtype, cost_dtype, shape, values, temperature, elite):
    elite = "nominal" if name == "PI2CMA" and elite == "best" else elite
    policy, optim = make(name, make_policy(dtype), temperature=temperature, elite=elite)
    optim.step(trial(policy, optim))
    size = math.prod(shape)
    whole = cost_dtype in (torch.int64, torch.bool)
    costs = torch.tensor([float(np.clip(np.nan_to_num(v), -1e9, 1e9)) if whole else v for v in values[:size]])
    costs = costs.to(cost_dtype).reshape(shape)
    for _ in range(3):
        before = everything(optim)
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", EqualCostsWarning)
                mean = optim.step(lambda: torchds.rollout(policy, start(policy), T, DT) and costs)
        except TorchdsError:
            assert everything(optim) == before
        else:
            assert policy.pack().isfinite().all() and mean.isfinite().all()
            assert policy.pack().dtype == mean.dtype == dtype
            assert all(v.dtype == dtype for entries in optim.state.values() for v in entries.values())


OPTIONS = {
    "lr": [math.nan, math.inf, -1.0, None, "1", torch.tensor([1.0, 2.0]), {}],
    "eliteness": [-1, 0, math.nan, math.inf, None, "h", []],
    "temperature": [None, "mean", 1.0, ["range"], {}],
    "control_weight": [-1e-9, math.nan, math.inf, None, "r"],
}
OWN = {
    "n_rollouts": [0, -3, 2.5, None, "10", math.nan, math.inf, []],
    "elite": [None, "worst", 3, []],
    "batched": [None, "yes", 2, []],
    "control_reference": [None, "here", []],
    "generator": [42, "seed", np.random.default_rng(0)],
}


@pytest.mark.parametrize(("option", "value"), [(o, v) for o, values in OPTIONS.items() for v in values], ids=str)
@pytest.mark.parametrize("where", ["made", "group", "used"])
def test_options_out_of_range_are_refused_where_they_are_made_and_used(option, value, where):
    policy, optim = make("PIBB")
    before = everything(optim)
    with pytest.raises(InvalidArgumentError, match=f"{option} has to be"):
        if where == "made":
            make("PIBB", **{option: value})
        elif where == "group":
            optim.add_param_group({"params": [nn.Parameter(torch.zeros(1))], option: value})
        else:
            good = optim.param_groups[0][option]
            optim.param_groups[0][option] = value
            try:
                optim.step(trial(policy, optim))
            finally:
                optim.param_groups[0][option] = good
    assert everything(optim) == before


@pytest.mark.parametrize(("option", "value"), [(o, v) for o, values in OWN.items() for v in values], ids=str)
@pytest.mark.parametrize("where", ["made", "used"])
def test_options_of_the_search_are_refused_where_they_are_made_and_used(option, value, where):
    policy, optim = make("PIBB")
    with pytest.raises(InvalidArgumentError, match=f"{option} has to be"):
        if where == "made":
            PIBB(policy.parameters(), Gaussian(0.1), **{option: value})
        else:
            setattr(optim, option, value)
            optim.step(trial(policy, optim))


@pytest.mark.parametrize("call", ["ask", "step"])
def test_an_option_that_was_deleted_is_missed(call):
    policy, optim = make("PI2")
    del optim.param_groups[0]["eliteness"]
    with pytest.raises(InvalidArgumentError, match=r"a group needs the options \['eliteness'\]"):
        optim.ask() if call == "ask" else optim.step(trial(policy, optim))


def test_whole_numbers_of_any_type_are_taken():
    for n in (10.0, np.int64(10), np.float32(10), torch.tensor(10)):
        optim = PIBB([nn.Parameter(torch.zeros(1))], Gaussian(0.1), n_rollouts=n, lr=np.float32(0.5))
        assert type(optim.n_rollouts) is int and optim.ask()[0].shape == (10, 1)


def test_a_generator_is_asked_for_by_its_call():
    with pytest.raises(InvalidArgumentError, match=r"got 42; use torch.Generator\(\).manual_seed\(42\)"):
        PIBB([nn.Parameter(torch.zeros(1))], Gaussian(0.1), generator=42)


@pytest.mark.parametrize("closure", [torch.zeros(N), [1.0], {"cost": 1}, 3.0])
def test_what_cannot_be_called_is_no_closure(closure):
    _, optim = make("PIBB")
    with pytest.raises(InvalidArgumentError, match=r"step needs a closure.*use ask\(\) and tell\(costs\)"):
        optim.step(closure)


@pytest.mark.parametrize(
    "given", [[None], [("policy", torch.zeros(3))], [3], [(make_policy(), None)], [(make_policy(), torch.zeros(3), 1)]]
)
def test_visits_of_another_kind_are_refused(given):
    _, optim = make("PIBB")
    optim.ask()
    with pytest.raises(InvalidArgumentError, match="a visit is"):
        optim.tell(torch.arange(4.0), given)


@pytest.mark.parametrize("shape", [(N, T, 5), (N + 1, T, 6), (6,), (T, 6), (T, N, 6)])
def test_features_of_another_shape_are_refused(shape):
    policy, optim = make("PIBB")
    optim.ask()
    noise = {p: optim.state[p]["noise"] for p in policy.parameters()}
    with pytest.raises(InvalidArgumentError, match="features of a visit have to be"):
        controls([(policy, torch.zeros(shape))], noise, dict.fromkeys(noise, 1.0), "zero")


# ------------------------------------------------------------------ state


@each_search
@pytest.mark.parametrize("exploration", EXPLORATIONS)
@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("asked", [False, True])
@pytest.mark.slow
def test_state_comes_back_bit_for_bit_in_its_own_dtype(name, exploration, dtype, asked, tmp_path):
    elite = "nominal" if name in ("PI2CMA", "SurrogatePIBB") else "best"
    policy, optim = make(name, make_policy(dtype), exploration, elite=elite)
    closure = trial(policy, optim)
    for _ in range(3):
        optim.step(lambda: closure().double() + math.pi * 1e-9)
    if asked:
        optim.ask()
    torch.save({"policy": policy.state_dict(), "optim": optim.state_dict()}, tmp_path / "state.pt")
    saved = torch.load(tmp_path / "state.pt", weights_only=True)
    again, other = make(name, make_policy(dtype), exploration, seed=9, elite=elite)
    again.load_state_dict(saved["policy"])
    other.load_state_dict(saved["optim"])
    assert bits(other.state_dict()) == bits(optim.state_dict())
    for p, o in ((policy, optim), (again, other)):
        for _ in range(2):
            o.step(trial(p, o))
    assert everything(optim) == everything(other)


class Counting(PIBB):
    """Keeps numbers of many types."""

    @torch.no_grad()
    def step(self, closure=None):
        for p in self.parameters:
            own = {
                "cost": torch.tensor(math.pi, dtype=torch.float64),
                "n": torch.tensor(2**60 + 1),
                "i": 3,
                "t": (1, 2.5),
            }
            own |= {"bits": torch.Generator().manual_seed(3).get_state(), "deep": {"x": torch.tensor(0.1).double()}}
            self.state[p].update(own)
        return self._step(closure)


def test_the_state_of_your_own_search_keeps_its_types():
    pair = []
    for _ in range(2):
        theta = nn.Parameter(torch.zeros(2))
        pair.append(Counting([theta], Gaussian(0.1), n_rollouts=N))
    pair[0].step(lambda: torch.arange(4.0))
    pair[1].load_state_dict(pair[0].state_dict())
    assert bits(pair[1].state_dict()) == bits(pair[0].state_dict())


@each_search
@pytest.mark.parametrize("other", [*SEARCHES, "Adam", "SGD"])
def test_the_state_of_another_optimizer_is_refused(name, other):
    if other == name:
        return
    _, optim = make(name)
    foreign = make(other)[1] if other in SEARCHES else getattr(torch.optim, other)(make_policy().parameters(), lr=0.1)
    before = everything(optim)
    message = (
        f"this is a state of '{other}' and cannot be continued by {name}" if other in SEARCHES else "are not in it"
    )
    with pytest.raises(InvalidArgumentError, match=message):
        optim.load_state_dict(foreign.state_dict())
    assert everything(optim) == before


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (lambda: make("PIBB", make_policy(batch=(3,)), elite="best")[1], "'best' of parameter 0 with the shape"),
        (lambda: make("PIBB", make_policy(Q=1), elite="best")[1], "has to have the parameters 0 to 1"),
        (
            lambda: make("PIBB", make_policy(torch.float32), elite="best")[1],
            "has to be torch.float64, got torch.float32",
        ),
        (lambda: make("PIBB", exploration="TrajectorySpace", elite="best")[1], "Gaussian keeps no state"),
    ],
)
def test_the_state_of_other_parameters_is_refused(other, message):
    foreign = other()
    policy = foreign.explorations[0].policy if hasattr(foreign.explorations[0], "policy") else None
    shape = foreign.param_groups[0]["params"][0].shape
    foreign.step(
        lambda: torch.arange(N * 3.0).reshape(N, 3)[:, : shape[0]] if len(shape) == 4 else torch.arange(4.0)
    ) if (policy is None and foreign.param_groups[0].update(control_weight=0.0) is None) else foreign.ask()
    _, optim = make("PIBB", elite="best")
    before = everything(optim)
    with pytest.raises(InvalidArgumentError, match=message):
        optim.load_state_dict(foreign.state_dict())
    assert everything(optim) == before


JUNK = [
    None,
    -1,
    7,
    math.nan,
    "text",
    [],
    {},
    torch.tensor(math.nan),
    torch.zeros(3),
    torch.zeros(2, 2, dtype=torch.int64),
]


def places(value, path=()):
    """All places of a nested value."""
    found = [path]
    if isinstance(value, dict):
        found += [p for name, entry in value.items() for p in places(entry, (*path, name))]
    if isinstance(value, list):
        found += [p for i, entry in enumerate(value) for p in places(entry, (*path, i))]
    return found


def edited(state, path, edit, junk):
    state = copy.deepcopy(state)
    if not path:
        return junk
    holder = state
    for name in path[:-1]:
        holder = holder[name]
    name, value = path[-1], holder[path[-1]]
    if edit == "delete":
        del holder[name]
    elif edit == "add" and isinstance(holder, dict):
        holder["more" if isinstance(name, str) else 99] = junk
    elif edit == "add":
        holder.append(junk)
    elif edit == "nan" and isinstance(value, torch.Tensor) and value.is_floating_point():
        holder[name] = torch.where(torch.arange(value.numel()).reshape(value.shape) == 0, math.nan, value)
    elif edit == "cut" and isinstance(value, torch.Tensor) and value.ndim:
        holder[name] = value[:-1]
    elif edit == "cast" and isinstance(value, torch.Tensor):
        holder[name] = value.float() if value.dtype == torch.float64 else value.double()
    else:
        holder[name] = junk
    return state


@fuzz(
    usual=60,
    name=st.sampled_from(list(SEARCHES)),
    exploration=st.sampled_from(["Gaussian", "TrajectorySpace"]),
    asked=st.booleans(),
    which=st.floats(0, 1, exclude_max=True),
    edit=st.sampled_from(["delete", "add", "replace", "nan", "cut", "cast"]),
    junk=st.sampled_from(range(len(JUNK))),
)
@pytest.mark.slow
def test_an_edited_state_is_refused_whole_or_continues(name, exploration, asked, which, edit, junk):
    elite = "nominal" if name in ("PI2CMA", "SurrogatePIBB") else "best"
    source_policy, source = make(name, None, exploration, elite=elite)
    for _ in range(2):
        source.step(trial(source_policy, source))
    if asked:
        source.ask()
    policy, optim = make(name, None, exploration, seed=5, elite=elite)
    optim.step(trial(policy, optim))
    state = source.state_dict()
    all_places = places(state)
    path = all_places[int(which * len(all_places))]
    before = everything(optim)
    try:
        optim.load_state_dict(edited(state, path, edit, copy.deepcopy(JUNK[junk])))
    except InvalidArgumentError as refused:
        assert "\n" not in str(refused) and everything(optim) == before
        return
    for _ in range(2):
        before = everything(optim)
        try:
            optim.step(trial(policy, optim))
        except TorchdsError:
            assert everything(optim) == before
        assert policy.pack().isfinite().all()


# ------------------------------------------------------------------ policies and roll-outs


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("kind", [list, np.array, torch.Tensor.float, torch.Tensor.double], ids=str)
def test_states_of_any_type_are_taken_in_the_dtype_of_the_policy(kind, dtype):
    policy = make_policy(dtype, Q=1)
    x0 = torch.tensor([-1.0, 0.5], dtype=torch.float64)
    given = kind(x0.tolist()) if kind in (list, np.array) else kind(x0)
    for f in (policy, policy.gating, policy.features, policy.stiffness, policy.basis, policy.jacobian):
        assert torch.equal(f(given), f(x0.to(dtype)))
    box = torchds.Bounds([-9.0, -9.0], np.array([9.0, 9.0]))
    path = torchds.rollout(policy, given, 5.0, np.float32(0.125), stop=box, shift=[0.1, 0.2])
    same = torchds.rollout(
        policy, x0.to(dtype), 5, 0.125, stop=torchds.Bounds(-9, 9), shift=torch.tensor([0.1, 0.2]).to(dtype)
    )
    torch.testing.assert_close(path.x, same.x, rtol=1e-6, atol=1e-6)
    assert path.x.dtype == path.v.dtype == path.features.dtype == dtype


@pytest.mark.parametrize(
    "x0", [None, "start", {"x": 1.0}, [[1.0], [2.0, 3.0]], [1j, 0], torch.zeros(2, dtype=torch.cfloat)]
)
def test_starts_of_another_kind_are_refused(x0):
    policy = make_policy()
    for call in (lambda: torchds.rollout(policy, x0, 5, 0.1), lambda: policy(x0)):
        with pytest.raises(InvalidArgumentError, match="has to be a tensor or an array of real numbers"):
            call()


@pytest.mark.parametrize(("n_steps", "dt"), [(2.5, 0.1), ("5", 0.1), (None, 0.1), (5, None), (5, "0.1"), (5, math.nan)])
def test_steps_of_another_kind_are_refused(n_steps, dt):
    with pytest.raises(InvalidArgumentError, match=r"(n_steps|dt) has to be"):
        torchds.rollout(make_policy(), torch.zeros(2), n_steps, dt)


def test_autocast_does_not_change_a_rollout():
    policy = make_policy(torch.float32, Q=1)
    path = torchds.rollout(policy, start(policy), 20, DT)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        again = torchds.rollout(policy, start(policy), 20, DT)
    assert torch.equal(path.x, again.x) and torch.equal(path.stiffness, again.stiffness)


GATE = {"priors": torch.ones(1), "means": torch.zeros(1, 2), "covariances": torch.eye(2)[None]}


@pytest.mark.parametrize("name", ["A", "b", "stiffness_A", "stiffness_b"])
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_experts_that_are_not_finite_are_refused(name, value):
    experts = {"A": torch.eye(2)[None], "b": torch.zeros(1, 2), "stiffness_A": torch.zeros(1, 1, 2)}
    experts |= {"stiffness_b": torch.zeros(1, 1)}
    experts[name].view(-1)[0] = value
    with pytest.raises(InvalidArgumentError, match=f"{name} has to be finite"):
        torchds.GMRPolicy(**GATE, **experts)


def test_integers_and_mixed_dtypes_make_one_policy():
    for A, dtype in (
        (torch.tensor([[[-1, 2], [-2, -1]]]), torch.float32),
        (torch.tensor([[[-1.0, 2], [-2, -1]]]).double(), torch.float64),
        ([[[-1, 2], [-2, -1]]], torch.float32),
    ):
        policy = torchds.GMRPolicy(**GATE, A=A, b=np.zeros((1, 2)))
        assert {p.dtype for p in [*policy.parameters(), *policy.buffers()]} == {dtype}
        assert policy([1, 2]).tolist() == [3.0, -4.0]


def test_an_empty_batch_keeps_its_stiffness():
    policy = make_policy(Q=1).expand(0)
    again = copy.deepcopy(policy)
    made = torchds.GMRPolicy(
        policy.priors, policy.means, policy.covariances, *(p.detach() for p in policy.parameters())
    )
    for some in (policy, again, made):
        path = torchds.rollout(some, start(some), 3, DT)
        assert path.x.shape == (0, 4, 2) and path.stiffness.shape == (0, 3, 1)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_the_gating_is_right_up_to_the_largest_number(dtype):
    policy = make_policy(dtype)
    policy = torchds.GMRPolicy(
        policy.priors, policy.means, torch.stack([torch.eye(2), torch.tensor([[9.0, 8.0], [8.0, 9.0]])]).to(dtype),
        policy.A.detach(), policy.b.detach(),
    )  # fmt: skip
    top = torch.finfo(dtype).max
    for direction in ([1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [1.0, 0.0]):
        u = torch.tensor(direction, dtype=dtype)
        assert torch.equal(policy.gating(u * top).round(), policy.gating(u * 1e4).round())
