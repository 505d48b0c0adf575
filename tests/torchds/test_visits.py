import pytest
import torch

from torchds import rollout, visits


def test_roll_outs_report_their_policy_and_features(random_policy, randn):
    first, second = random_policy(), random_policy(batch=(3,))
    with visits.listen() as heard:
        paths = [rollout(first, randn(2), n_steps=4, dt=0.1), rollout(second, randn(5, 2), n_steps=6, dt=0.1)]
    assert [visit.policy for visit in heard] == [first, second]
    assert all(visit.visited is path.visited for visit, path in zip(heard, paths, strict=True))
    assert heard[1].features.shape == (3, 5, 6, 9)


def test_a_foreign_simulator_reports_too(random_policy, randn):
    policy = random_policy()
    features = policy.features(randn(7, 2))
    with visits.listen() as heard:
        visits.report(policy, features)
    assert heard[0].policy is policy
    assert heard[0].features is features


def test_an_inner_listener_hides_visits_from_the_outer_one(random_policy, randn):
    before, inside, after = (random_policy() for _ in range(3))
    with visits.listen() as outer:
        rollout(before, randn(2), n_steps=1, dt=0.1)
        with visits.listen() as inner:
            rollout(inside, randn(2), n_steps=1, dt=0.1)
        rollout(after, randn(2), n_steps=1, dt=0.1)
    assert [visit.policy for visit in inner] == [inside]
    assert [visit.policy for visit in outer] == [before, after]


def test_outside_nothing_is_recorded(random_policy, randn):
    policy = random_policy()
    rollout(policy, randn(2), n_steps=1, dt=0.1)
    with visits.listen() as heard:
        assert heard == []
    rollout(policy, randn(2), n_steps=1, dt=0.1)
    assert heard == []


def test_a_listener_that_fails_stops_listening(random_policy):
    with pytest.raises(RuntimeError, match="closure"), visits.listen() as heard:
        raise RuntimeError("closure")
    rollout(random_policy(), torch.zeros(2, dtype=torch.float64), n_steps=1, dt=0.1)
    assert heard == []
