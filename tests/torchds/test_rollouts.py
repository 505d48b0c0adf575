import copy
import re

import numpy as np
import pytest
import torch
from torch import nn
from torch.func import functional_call
from torch.testing import assert_close

import torchds
from torchds import Bounds, GMRPolicy, rollout
from torchds.errors import InvalidArgumentError
from torchds.sensitivity import sensitivity

CLOSE = {"rtol": 1e-12, "atol": 1e-12}


def linear(A, b):
    """The linear policy A x + b."""
    A, b = torch.tensor(A, dtype=torch.float64), torch.tensor(b, dtype=torch.float64)
    D = A.shape[-1]
    gate = torch.ones(1), torch.zeros(1, D), torch.eye(D)[None]
    return GMRPolicy(*(value.double() for value in gate), A.unsqueeze(-3), b.unsqueeze(-2))


def tensor(*values):
    return torch.tensor(values, dtype=torch.float64)


# ---------------------------------------------------------------------- Eq. 4


@pytest.mark.parametrize(("D", "O"), [(1, 1), (2, 2), (2, 3)])
def test_a_roll_out_is_equation_4(random_mixture, gmr_as_printed, randn, D, O):
    mixture, x0 = random_mixture(K=3, F=D + O), randn(D)
    path = rollout(GMRPolicy.from_mixture(mixture, D), x0, n_steps=40, dt=0.05)
    x, states, velocities, gating = x0.numpy(), [x0.numpy()], [], []
    for _ in range(40):
        h, _, _, v = gmr_as_printed(mixture, x)
        x = x + v[:D] * 0.05
        states.append(x)
        velocities.append(v)
        gating.append(h)
    assert_close(path.x.detach().numpy(), np.stack(states), rtol=1e-11, atol=1e-11)
    assert_close(path.v.detach().numpy(), np.stack(velocities), rtol=1e-11, atol=1e-11)
    assert_close(path.gating.detach().numpy(), np.stack(gating), rtol=1e-11, atol=1e-11)
    assert path.dt == 0.05
    assert path.resting is None
    assert not path.stopped


def test_a_linear_roll_out_is_a_power_of_its_matrix():
    A = [[-0.5, 1.0], [-1.0, -0.3]]
    x = rollout(linear(A, [0.0, 0.0]), tensor(1.0, 2.0), n_steps=50, dt=0.1).x[-1]
    power = np.linalg.matrix_power(np.eye(2) + 0.1 * np.array(A), 50)
    assert_close(x.detach().numpy(), power @ [1.0, 2.0], **CLOSE)


def test_stiffness_does_not_move_the_state(random_mixture, randn):
    mixture, x0 = random_mixture(F=4), randn(2)
    bare = rollout(GMRPolicy.from_mixture(mixture, 2), x0, n_steps=10, dt=0.1)
    stiff = rollout(GMRPolicy.from_mixture(mixture, 2, stiffness_dim=1, stiffness=20.0), x0, n_steps=10, dt=0.1)
    assert_close((stiff.x, stiff.v), (bare.x, bare.v), **CLOSE)


# ---------------------------------------------------------------------- batches


@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
@pytest.mark.parametrize("points", [(), (5,), (5, 2)])
@pytest.mark.parametrize("starts", ["shared", "per_policy"])
@pytest.mark.slow
def test_a_batch_equals_a_loop_of_single_roll_outs(random_policy, randn, batch, points, starts):
    policy = random_policy(O=3, Q=1, batch=batch, moved=True)
    x0 = randn(*(batch if starts == "per_policy" else ()), *points, 2)
    path = rollout(policy, x0, n_steps=15, dt=0.05, starts=starts)
    assert path.x.shape == (*batch, *points, 16, 2)
    assert path.v.shape == (*batch, *points, 15, 3)
    assert path.features.shape == (*batch, *points, 15, 9)
    assert path.gating.shape == (*batch, *points, 15, 3)
    assert path.stopped.shape == (*batch, *points)
    for i in np.ndindex(batch):
        single = copy.deepcopy(policy).unpack(policy.pack()[i])
        for j in np.ndindex(points):
            alone = rollout(single, x0[i + j] if starts == "per_policy" else x0[j], n_steps=15, dt=0.05)
            together = (path.x[i + j], path.v[i + j], path.features[i + j])
            assert_close(together, (alone.x, alone.v, alone.features), **CLOSE)


@pytest.mark.slow
def test_twenty_policies_from_ten_starts_equal_two_hundred_single_roll_outs(random_policy, randn):
    policy, x0 = random_policy(K=4, batch=(20,)), randn(10, 2)
    together = rollout(policy, x0, n_steps=10, dt=0.1).x
    alone = [rollout(policy[i], x0[j], n_steps=10, dt=0.1).x for i in range(20) for j in range(10)]
    assert_close(together, torch.stack(alone).unflatten(0, (20, 10)), **CLOSE)


@pytest.mark.parametrize("batch", [(), (3,)])
def test_gating_is_that_of_the_visited_states(random_policy, randn, batch):
    policy = random_policy(batch=batch)
    path = rollout(policy, randn(4, 2), n_steps=12, dt=0.1)
    assert_close(path.gating, policy.gating(path.x[..., :-1, :]), **CLOSE)
    assert_close(path.features, policy.features(path.x[..., :-1, :]), **CLOSE)


# ---------------------------------------------------------------------- derivatives, dtype


@pytest.mark.slow
def test_a_roll_out_differentiates(random_policy, randn):
    class Path(nn.Module):
        def __init__(self, policy):
            super().__init__()
            self.policy = policy

        def forward(self, x0):
            path = rollout(self.policy, x0, n_steps=4, dt=0.1)
            return path.x, path.v

    path = Path(random_policy(K=2, batch=(2,)))
    inputs = [value.detach().clone().requires_grad_() for value in (randn(2, 2), path.policy.A, path.policy.b)]
    torch.autograd.gradcheck(
        lambda x0, A, b: functional_call(path, {"policy.A": A, "policy.b": b}, (x0,)), tuple(inputs)
    )


def test_gradients_stay_finite_where_a_roll_out_rests(random_policy):
    policy = linear([[3.0, 0.0], [0.0, 3.0]], [0.0, 0.0])
    path = rollout(policy, tensor([1.0, 1.0], [0.0, 0.001]), n_steps=60, dt=0.5, stop=Bounds(-10.0, 10.0))
    path.x.square().sum().backward()
    assert policy.A.grad.isfinite().all()
    assert policy.A.grad.any()


def test_float32_stays_float32_and_close(random_policy, randn):
    policy, x0 = random_policy(batch=(3,)), randn(4, 2)
    path = rollout(policy, x0, n_steps=20, dt=0.05, stop=Bounds(-50.0, 50.0))
    single = rollout(copy.deepcopy(policy).float(), x0.float(), n_steps=20, dt=0.05, stop=Bounds(-50.0, 50.0))
    assert {value.dtype for value in (single.x, single.v, single.features, single.gating)} == {torch.float32}
    assert_close(single.x.double(), path.x, rtol=1e-4, atol=1e-4)


# ---------------------------------------------------------------------- stopping, diverging


def test_a_roll_out_that_would_leave_the_box_rests_and_the_others_do_not_notice():
    policy = linear([[0.0, 0.0], [0.0, 0.0]], [1.0, 0.5])
    x0 = tensor([8.0, 0.0], [0.0, 0.0], [0.0, 9.0])
    path = rollout(policy, x0, n_steps=5, dt=1.0, stop=Bounds(-10.0, 10.0))
    free = rollout(policy, x0, n_steps=5, dt=1.0)
    assert path.x[0].tolist() == [[8, 0], [9, 0.5], [10, 1], [10, 1], [10, 1], [10, 1]]
    assert path.v[0].tolist() == [[1, 0.5], [1, 0.5], [0, 0], [0, 0], [0, 0]]
    assert path.x[2, -1].tolist() == [2, 10]
    assert path.resting.tolist() == [[False, False, True, True, True], [False] * 5, [False, False, True, True, True]]
    assert path.stopped.tolist() == [True, False, True]
    assert torch.equal(path.x[1], free.x[1])
    assert torch.equal(path.v[1], free.v[1])
    assert not free.stopped.any()


def test_the_box_may_have_a_side_per_dimension():
    policy = linear([[0.0, 0.0], [0.0, 0.0]], [1.0, -1.0])
    stop = Bounds(tensor(-9.0, -2.0), tensor(10.0, 3.0))
    assert rollout(policy, tensor(0.0, 0.0), n_steps=5, dt=1.0, stop=stop).x[-1].tolist() == [2, -2]


def test_a_roll_out_that_came_to_rest_never_moves_again():
    policy = linear([[0.0]], [1.0])
    answers = iter([False, True, False, False])
    path = rollout(policy, tensor(0.0), n_steps=4, dt=1.0, stop=lambda x, x_next: torch.tensor(next(answers)))
    assert path.x[:, 0].tolist() == [0, 1, 1, 1, 1]
    assert path.resting.tolist() == [False, True, True, True]


def test_a_stop_condition_sees_both_ends_of_the_step():
    seen = []
    policy = linear([[[0.0]], [[0.0]]], [[1.0], [2.0]])  # a batch of two
    path = rollout(
        policy, tensor(3.0), n_steps=1, dt=0.5, stop=lambda x, x_next: seen.append((x, x_next)) or x_next[..., 0] > 3.7
    )
    assert seen[0][0].tolist() == [[3.0], [3.0]]
    assert seen[0][1].tolist() == [[3.5], [4.0]]
    assert path.x[..., -1, 0].tolist() == [3.5, 3.0]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_a_diverging_roll_out_is_data_and_with_bounds_it_stays_finite(random_mixture, dtype):
    policy = GMRPolicy.from_mixture(random_mixture(), 2).expand(2)
    with torch.no_grad():
        policy.A[0] = 1e6 * torch.eye(2)
        policy.A[1] = -torch.eye(2)
    policy, x0 = policy.to(dtype), torch.ones(2, dtype=dtype)
    free = rollout(policy, x0, n_steps=100, dt=0.1)
    assert not free.x[0].isfinite().all()
    assert free.x[1].isfinite().all()  # its neighbour in the batch is not spoilt
    box = rollout(policy, x0, n_steps=100, dt=0.1, stop=Bounds(-1e3, 1e3))
    assert box.x.isfinite().all()
    assert box.v.isfinite().all()
    assert box.stopped.tolist() == [True, False]
    assert torch.equal(box.x[1], free.x[1])


def test_a_start_that_is_not_a_number_rests_at_once():
    path = rollout(linear([[0.0]], [1.0]), tensor([torch.nan], [0.0]), n_steps=3, dt=1.0, stop=Bounds(-9.0, 9.0))
    assert path.stopped.tolist() == [True, False]
    assert path.x[1, :, 0].tolist() == [0, 1, 2, 3]


# ---------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x0": torch.zeros(3)}, "x0 has to end with the policy's 2 inputs, got shape (3,)"),
        ({"x0": torch.zeros(())}, "x0 has to end with the policy's 2 inputs, got shape ()"),
        (
            {"x0": torch.zeros(3, 2), "starts": "per_policy"},
            "x0 (3, 2) has to begin with batch_shape (4,) for starts='per_policy'",
        ),
        ({"starts": "each"}, "starts has to be 'shared' or 'per_policy', got 'each'"),
        ({"n_steps": 0}, "n_steps has to be at least 1, got 0"),
        ({"dt": 0.0}, "dt has to be positive and finite, got 0.0"),
        ({"dt": -0.1}, "dt has to be positive and finite, got -0.1"),
        ({"dt": float("nan")}, "dt has to be positive and finite, got nan"),
        ({"dt": float("inf")}, "dt has to be positive and finite, got inf"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(random_policy, change, message):
    valid = {"x0": torch.zeros(2, dtype=torch.float64), "n_steps": 3, "dt": 0.1}
    policy = random_policy(batch=(4,))
    rollout(policy, **valid)
    with pytest.raises(InvalidArgumentError, match=re.escape(message)):
        rollout(policy, **valid | change)


def test_fewer_velocities_than_inputs_are_refused(random_policy):
    with pytest.raises(
        InvalidArgumentError, match="a policy of 2 inputs has to have as many velocities or more, got 1"
    ):
        rollout(random_policy(D=2, O=1), torch.zeros(2, dtype=torch.float64), n_steps=3, dt=0.1)


# ---------------------------------------------------------------------- a field that moves


@pytest.mark.parametrize("batch", [(), (3,)])
def test_a_shifted_roll_out_is_the_same_motion_elsewhere(random_policy, randn, batch):
    policy, x0, shift = random_policy(Q=1, batch=batch), randn(4, 2), randn(2)
    here = rollout(policy, x0, n_steps=12, dt=0.1)
    there = rollout(policy, x0 + shift, n_steps=12, dt=0.1, shift=shift)
    assert_close(there.x, here.x + shift, **CLOSE)
    assert_close((there.v, there.features, there.stiffness), (here.v, here.features, here.stiffness), **CLOSE)
    assert_close(there.inputs, here.x[..., :-1, :], **CLOSE)
    assert_close(here.inputs, here.x[..., :-1, :], rtol=0, atol=0)


def test_each_start_may_have_a_shift_of_its_own(random_policy, randn):
    policy, x0, shift = random_policy(batch=(3,)), randn(4, 2), randn(4, 2)
    together = rollout(policy, x0, n_steps=12, dt=0.1, shift=shift)
    for j in range(4):
        alone = rollout(policy, x0[j], n_steps=12, dt=0.1, shift=shift[j])
        assert_close(together.x[:, j], alone.x, **CLOSE)


@pytest.mark.slow
def test_a_motion_follows_its_moving_target():
    """ẋ = −(x − c t) lags c behind c t: x = c (t − 1 + e^{−t})."""
    policy, c, times = linear([[-1.0, 0.0], [0.0, -1.0]], [0.0, 0.0]), tensor(0.5, -0.2), []

    def target(t):
        times.append(t)
        return c * t

    path = rollout(policy, tensor(0.0, 0.0), n_steps=5000, dt=0.001, shift=target)
    assert_close(path.x[-1], c * (5.0 - 1.0 + np.exp(-5.0)), rtol=0, atol=1e-3)
    assert times[:3] == [0.0, 0.001, 0.002]
    assert len(times) == 5000


def test_the_sensitivity_of_a_shifted_roll_out_is_that_of_the_motion_elsewhere(random_policy, randn):
    policy, x0, shift = random_policy(), randn(4, 2), randn(2)
    here = sensitivity(policy, rollout(policy, x0, n_steps=8, dt=0.1))
    there = sensitivity(policy, rollout(policy, x0 + shift, n_steps=8, dt=0.1, shift=shift))
    assert_close(there, here, **CLOSE)


@pytest.mark.slow
def test_a_motion_that_ends_at_its_goal_ends_at_the_shifted_one():
    policy = linear([[-1.0, 2.0], [-2.0, -1.0]], [0.0, 0.0])
    jump = rollout(policy, tensor(1.0, 1.0), 400, 0.05, shift=lambda t: tensor(0.0, 0.0) if t < 5 else tensor(3.0, 1.0))
    assert_close(jump.x[99], tensor(0.0, 0.0), rtol=0, atol=0.05)
    assert_close(jump.x[-1], tensor(3.0, 1.0), rtol=0, atol=1e-5)


@pytest.mark.parametrize("shift", [torch.zeros(3), torch.zeros(5, 2), torch.zeros(1, 1, 4, 2)])
def test_a_shift_that_does_not_fit_is_refused(random_policy, shift):
    with pytest.raises(InvalidArgumentError, match=re.escape(f"fit (4, 2), got shape {tuple(shift.shape)}")):
        rollout(random_policy(), torch.zeros(4, 2, dtype=torch.float64), n_steps=3, dt=0.1, shift=shift)


# ---------------------------------------------------------------------- feedback


def test_with_feedback_the_policy_sees_the_plant(random_policy, randn):
    policy = random_policy(batch=(3,), moved=True)
    plant = torchds.impedance.ImpedanceControlled(torchds.plants.PointMass(), stiffness=20.0)
    path = rollout(policy, randn(4, 2), 6, 0.1, plant=plant, feedback=True, shift=torch.ones(2))
    assert_close(path.inputs, path.x[..., :-1, :] - 1.0, rtol=0, atol=1e-12)
    assert_close(path.features, policy.features(path.inputs), rtol=0, atol=1e-12)
    commanded = path.x[..., :-1, :] + 0.1 * policy(path.inputs)
    assert_close(path.reference[..., 1:, :], commanded, rtol=0, atol=1e-12)


def test_with_feedback_a_stiff_plant_without_a_push_follows_the_motion(random_policy, randn):
    policy, x0 = random_policy(), randn(2)
    plant = torchds.impedance.ImpedanceControlled(torchds.plants.PointMass(damping=0.0), stiffness=1e8)
    closed = rollout(policy, x0, 50, 0.01, plant=plant, feedback=True)
    assert_close(closed.x, rollout(policy, x0, 50, 0.01).x, rtol=1e-3, atol=1e-3)


def test_feedback_without_a_plant_changes_nothing(random_policy, randn):
    policy, x0 = random_policy(), randn(2)
    assert torch.equal(rollout(policy, x0, 9, 0.1, feedback=True).x, rollout(policy, x0, 9, 0.1).x)


def test_compiled_code_says_that_it_has_no_feedback(random_policy, randn):
    if not torchds.kernels.available()["cpu"]:
        pytest.skip("no numba here")
    plant = torchds.impedance.ImpedanceControlled(torchds.plants.PointMass(), stiffness=20.0)
    with pytest.raises(InvalidArgumentError, match="feedback from a plant needs the eager loop"):
        rollout(random_policy(), randn(2), 9, 0.1, plant=plant, feedback=True, backend="fused")
