import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError
from torchds.parameters import arrange, cat_broadcast


def in_rows(A, b):
    """[A_1 row o, b_1[o], A_2 row o, ...] for each output o, entry by entry."""
    K, O, D = A.shape
    return np.array([[([*A[k, o], b[k, o]])[d] for k in range(K) for d in range(D + 1)] for o in range(O)])


@pytest.mark.parametrize("Q", [0, 2])
def test_rows_are_laid_out_as_printed(random_policy, Q):
    policy = random_policy(K=3, D=2, O=2, Q=Q)
    A, b = (p.detach().numpy() for p in (policy.A, policy.b))
    expected = in_rows(A, b)
    if Q:
        expected = np.concatenate([expected, in_rows(policy.stiffness_A.detach(), policy.stiffness_b.detach())])
    assert_close(policy.rows().detach(), torch.from_numpy(expected), rtol=0, atol=0)


@pytest.mark.parametrize("Q", [0, 1])
@pytest.mark.parametrize("batch", [(), (4,), (2, 3)])
def test_rows_and_theta_are_taken_apart_by_the_same_names(random_policy, Q, batch):
    policy = random_policy(K=3, D=2, O=3, Q=Q, batch=batch)
    named = dict(policy.named_parameters())
    assert dict(policy.row_parameters) == named
    for parts in (policy.from_rows(policy.rows()), policy.split(policy.pack())):
        assert parts.keys() == named.keys()
        for name, value in parts.items():
            assert torch.equal(value, named[name])
    assert torch.equal(policy.join(named), policy.pack())


def test_what_is_arranged_may_carry_a_batch_that_the_parameters_do_not_have(random_policy, randn):
    policy = random_policy(K=2, D=2, O=2, Q=1)
    noise = {p: randn(5, *p.shape) for p in policy.parameters()}
    rows, theta = policy.rows(noise.get), policy.pack(noise.get)
    for n in range(5):
        assert torch.equal(rows[n], policy.rows(lambda p, n=n: noise[p][n]))
        assert torch.equal(theta[n], policy.pack(lambda p, n=n: noise[p][n]))


def test_a_vector_of_another_length_is_refused(random_policy):
    with pytest.raises(InvalidArgumentError, match=r"theta has to be \(\*batch, 12\) for this policy, got \(11,\)"):
        random_policy(K=2, D=2, O=2, Q=0).split(torch.zeros(11))


def test_leading_dimensions_broadcast_before_they_are_put_side_by_side(randn):
    a, b = randn(5, 2, 3), randn(2, 1)
    assert torch.equal(cat_broadcast([a, b], -1), torch.stack([torch.cat([part, b], -1) for part in a]))
    assert arrange(randn(4, 3, 2, 2), randn(3, 2)).shape == (4, 2, 9)
