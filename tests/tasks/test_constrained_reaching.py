"""The box: its geometry and walls by other means, its costs in plain loops, and what learning in it comes to."""

import math
from fractions import Fraction

import numpy as np
import pytest
import scipy.stats
import torch

import tasks
from torchds import Walls
from torchds.errors import InvalidArgumentError
from torchds.exploration import Gaussian, Stable, TrajectorySpace
from torchds.optim import PIBB, ExponentialDecay, InverseIteration

RUNS = 20
LEVELS = (0.03, 0.05, 0.1)


@pytest.fixture(scope="module")
def task():
    return tasks.make("constrained_reaching")


# ------------------------------------------------------------------ geometry and walls


def test_the_shortest_path_around_the_box_is_8_815(task):
    """Over all ways along corners of the box: each leg must not cross a wall."""
    start, goal = task.start.numpy(), task.goal.numpy()
    corners = task.walls.segments.reshape(-1, 2).unique(dim=0).numpy()
    # A way may not touch a wall: it goes by points a hair above or below the corners.
    nodes = [start, *(c * (1.0, 1.0 + 1e-10) for c in corners), goal]
    distance = np.full((len(nodes), len(nodes)), np.inf)
    for i, p in enumerate(nodes):
        for j, q in enumerate(nodes):
            if not bool(task.walls(torch.from_numpy(p), torch.from_numpy(q))):
                distance[i, j] = np.linalg.norm(q - p)
    for k in range(len(nodes)):
        distance = np.minimum(distance, distance[:, k : k + 1] + distance[k : k + 1])
    assert distance[0, -1] == pytest.approx(8.815, abs=1e-9)
    assert np.linalg.norm(start - (-1, 1)) + math.sqrt(2) == pytest.approx(8.815, rel=1e-15)
    assert bool(task.walls(task.start, task.goal))  # the straight line is shorter and blocked


def meet(p, q, a, b):
    """Whether two segments have a point in common, in exact arithmetic: p + t (q − p) = a + u (b − a)."""
    p, q, a, b = ([Fraction(float(c)) for c in point] for point in (p, q, a, b))
    d, e, f = ([m - n for m, n in zip(s, t, strict=True)] for s, t in ((q, p), (b, a), (a, p)))
    determinant = d[0] * e[1] - d[1] * e[0]
    if determinant:
        t = (f[0] * e[1] - f[1] * e[0]) / determinant
        u = (f[0] * d[1] - f[1] * d[0]) / determinant
        return 0 <= t <= 1 and 0 <= u <= 1
    if d[0] * f[1] - d[1] * f[0] or e[0] * f[1] - e[1] * f[0]:
        return False  # parallel, apart
    return all(max(min(p[i], q[i]), min(a[i], b[i])) <= min(max(p[i], q[i]), max(a[i], b[i])) for i in (0, 1))


@pytest.mark.parametrize("kind", ["grid", "random"])
@pytest.mark.slow
def test_a_step_meets_a_wall_where_exact_arithmetic_says_so(kind):
    """On a coarse grid, where steps end on walls, run along them, or rest, and at random."""
    g = torch.Generator().manual_seed(0)
    n = 1500
    points = torch.randint(-2, 3, (n, 2, 2), generator=g).double()
    walls = torch.randint(-2, 3, (3, 2, 2), generator=g).double()
    if kind == "random":
        points, walls = points + torch.rand(n, 2, 2, generator=g), walls + torch.rand(3, 2, 2, generator=g)
    found = Walls(walls)(points[:, 0], points[:, 1])
    expected = [any(meet(*wall, *step) for wall in walls.tolist()) for step in points.tolist()]
    assert found.tolist() == expected
    assert 0.1 < np.mean(expected) < 0.9
    batched = Walls(walls)(points[:, 0].reshape(50, 30, 2), points[:, 1].reshape(50, 30, 2))
    assert torch.equal(batched.flatten(), found)


@pytest.mark.slow
def test_who_hits_a_wall_stays_there(task):
    """Straight at the box: the last state is before the wall, and the step after it would cross."""
    policy = task.policy()
    with torch.no_grad():
        policy.A.copy_(-0.3 * torch.eye(2).expand_as(policy.A))
        path = task.rollout(policy)
    assert bool(path.stopped)
    moving = (~path.resting).sum()
    x = path.x[moving]
    assert torch.equal(path.x[moving:], x.expand_as(path.x[moving:]))
    assert not path.v[moving:].any()
    assert x[0] < -1
    assert (x + 0.1 * policy(x))[0] >= -1
    terms = task.cost_terms(path)
    assert float(terms["goal"]) == pytest.approx(10 * float(x.square().sum()), rel=1e-12)


def test_a_step_to_nowhere_is_no_collision(task):
    x = task.start.expand(2, 2)
    assert not task.walls(x, torch.tensor([[math.nan, 0.0], [math.nan, math.nan]], dtype=torch.float64)).any()


# ------------------------------------------------------------------ costs


def test_cost_terms_are_those_of_equation_41(task):
    g = torch.Generator().manual_seed(1)
    policy = task.policy()
    policy.unpack(policy.pack() + 0.2 * torch.randn(20, policy.pack().shape[-1], generator=g, dtype=torch.float64))
    with torch.no_grad():
        path, terms = task.evaluate(policy)
        assert path.stopped.any()
        assert not path.stopped.all()
        for r in range(20):
            x, v = path.x[r].numpy(), path.v[r].numpy()
            assert len(v) == 150
            acceleration = sum(math.dist(v[j], v[j - 1]) for j in range(1, 150))
            length = sum(math.hypot(*v[j]) * 0.1 - 8.815 / 150 for j in range(150))
            deviation = policy.pack()[r] - task.policy().pack()
            assert float(terms["goal"][r]) == pytest.approx(10 * (x[-1] ** 2).sum(), rel=1e-12)
            assert float(terms["acceleration"][r]) == pytest.approx(0.01 * acceleration, rel=1e-12)
            assert float(terms["path_length"][r]) == pytest.approx(length, rel=1e-12)
            control = 0.5 * 1e-3 * 150 * float(deviation.square().sum())
            assert float(terms["control"][r]) == pytest.approx(control, rel=1e-12)
        total = task.cost(path)
        torch.testing.assert_close(task.step_costs(path).sum(-1), total, rtol=1e-12, atol=0)


# ------------------------------------------------------------------ the motion at the start


def test_the_imitated_motion_is_stable_and_a_detour(task):
    with torch.no_grad():
        path, terms = task.evaluate(task.policy())
    assert sum(terms.values()) == pytest.approx(3.7, abs=0.2)
    assert not path.stopped
    certificate = task.policy().certificate(task.goal)
    assert certificate.stable
    assert certificate.margin > 0.03
    assert len(task.demonstrations) == 4
    assert all(demo.dt * (len(demo.x) - 1) == pytest.approx(12.0) for demo in task.demonstrations)
    for demo in task.demonstrations:
        assert not task.walls(demo.x[:-1], demo.x[1:]).any()


@pytest.mark.slow
def test_with_a_learned_metric_the_policy_satisfies_that_condition():
    task = tasks.make("constrained_reaching", condition="p-qlf")
    assert task.policy().certificate(task.goal, task.P).stable
    assert not torch.allclose(task.P, torch.eye(2, dtype=torch.float64), atol=1e-2)


@pytest.mark.slow
def test_a_mixture_is_taken_as_it_is(task):
    given = tasks.make("constrained_reaching", mixture=task.mixture)
    assert given.P is None
    assert not given.policy().certificate(given.goal).stable


def test_policies_are_new_ones(task):
    with torch.no_grad():
        task.policy().A.zero_()
    assert task.policy().A.abs().max() > 0.1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"condition": "lyapunov"}, "condition has to be 'seds' or 'p-qlf', got 'lyapunov'"),
        ({"convention": "draft"}, "has to be 'paper' or 'released', got 'draft'"),
    ],
)
def test_wrong_options_are_refused(options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        tasks.make("constrained_reaching", **options)


# ------------------------------------------------------------------ learning


def learn(task, explore, batch, updates=100, **options):
    """Costs `(U+1, *batch)` of the noise-free policies, and the policies."""
    policy = task.policy().expand(*batch)
    decay = options.pop("decay", InverseIteration())
    optim = PIBB(
        policy.parameters(),
        explore(policy),
        n_rollouts=task.search.n_rollouts,
        control_weight=task.search.control_weight,
        generator=torch.Generator().manual_seed(0),
        **options,
    )
    schedule = torch.optim.lr_scheduler.LambdaLR(optim, decay)
    costs, violations = [], 0
    with torch.no_grad():
        costs.append(sum(task.evaluate(policy)[1].values()))
        for _ in range(updates):
            optim.step(lambda: task.cost(task.rollout(policy)))
            schedule.step()
            costs.append(sum(task.evaluate(policy)[1].values()))
            violations += int((~policy.certificate(task.goal).stable).sum())
    return torch.stack(costs), policy, violations


@pytest.fixture(scope="module")
def swept(task):
    """Stable exploration, and free A and b, 20 runs at three levels of noise in one batch each."""
    std = torch.tensor(LEVELS, dtype=torch.float64)[:, None, None, None, None].expand(-1, RUNS, 1, 1, 1)
    with torch.no_grad():
        x = task.rollout(task.policy()).x
    offset = std[..., 0] * x.square().sum(-1).mean().sqrt()
    explorations = {
        "stable": lambda p: Stable(p, Gaussian([std, 0.0]), task.goal),
        "free": lambda p: Gaussian([std, offset]),
    }
    return {name: learn(task, explore, (len(LEVELS), RUNS)) for name, explore in explorations.items()}


@pytest.mark.slow
def test_stable_exploration_never_leaves_the_set_and_no_final_policy_collides(task, swept):
    _, policy, violations = swept["stable"]
    assert violations == 0
    assert policy.certificate(task.goal).stable.sum() == len(LEVELS) * RUNS
    assert not task.rollout(policy).stopped.any()


def test_stable_exploration_ends_below_free_exploration_at_three_levels_of_noise(swept):
    stable, free = swept["stable"][0], swept["free"][0]
    for update in (10, 100):
        for i in range(len(LEVELS)):
            test = scipy.stats.mannwhitneyu(stable[update, i], free[update, i], alternative="less")
            assert test.pvalue < 0.05


def test_most_of_the_detour_is_gone_after_a_hundred_rollouts(swept):
    medians = swept["stable"][0].median(-1).values
    assert (medians[0] > 3.5).all()
    assert (medians[10, :2] < 0.7).all()
    assert (medians[100] < medians[10]).all()


@pytest.mark.slow
def test_stable_exploration_along_the_motion_reaches_a_third_after_a_thousand_rollouts(task):
    def explore(policy):
        space = TrajectorySpace.relative(policy, *task.motion(), goal=task.goal)
        return Stable(policy, space, task.goal)

    costs, policy, violations = learn(task, explore, (RUNS,), temperature="capped", decay=ExponentialDecay(100))
    assert violations == 0
    assert policy.certificate(task.goal).stable.all()
    assert costs[100].median() < 0.35
    assert not task.rollout(policy).stopped.any()
