"""One node of a graph in place of a loop: the same numbers as the eager roll-out."""

import pytest
import torch
from torch.testing import assert_close

from torchds import Bounds, rollout, visits
from torchds.errors import InvalidArgumentError
from torchds.forces import ConstantForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

STEPS, DT = 6, 0.1


def compare(ours, theirs):
    for name in ("x", "v", "features", "stiffness", "reference", "inputs", "resting"):
        expected = getattr(theirs, name)
        if expected is None:
            assert getattr(ours, name) is None
        else:
            assert_close(getattr(ours, name), expected, rtol=1e-12, atol=1e-12)
    if theirs.plant is not None:
        for field, expected in theirs.plant._asdict().items():
            assert_close(getattr(ours.plant, field), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.slow
def test_a_scanned_rollout_is_the_eager_one_with_all_that_belongs_to_it(random_policy, randn):
    """Batch, points, stiffness, a plant in a force, a box that some leave, and a shift."""
    policy, x0 = random_policy(Q=2, batch=(3,)), 0.5 * randn(4, 2)
    plant = ImpedanceControlled(PointMass(force=ConstantForce(torch.tensor([0.0, 1.0]))), low=0.1)
    given = {"stop": Bounds(-0.6, 0.6), "plant": plant, "shift": torch.tensor([0.1, 0.0])}
    with torch.no_grad():
        rollout(
            policy, x0[:3], STEPS, DT, **given, backend="scan"
        )  # from the second number of starts on, sizes are symbols
        eager, scanned = (rollout(policy, x0, STEPS, DT, **given, backend=backend) for backend in ("eager", "scan"))
    assert 0 < scanned.stopped.sum() < scanned.stopped.numel()
    compare(scanned, eager)


@pytest.mark.slow
def test_its_gradients_are_those_of_the_loop(random_policy, randn):
    policy, x0, gradients = random_policy(), 0.5 * randn(2), []
    for backend in ("eager", "scan"):
        path = rollout(policy, x0, STEPS, DT, backend=backend)
        gradients.append(torch.autograd.grad((path.x.square().sum() + path.v.sum()), [policy.A, policy.b]))
    assert_close(gradients[1], gradients[0], rtol=1e-10, atol=1e-12)


@pytest.mark.slow
@pytest.mark.no_cover
def test_other_sizes_and_time_steps_may_follow(random_policy, randn):
    """What was traced first must not decide about what comes later: sizes become symbols, time steps must not."""
    force = ConstantForce(torch.tensor([0.3, -0.2], dtype=torch.float64))
    plant = ImpedanceControlled(PointMass(1.0, 1.0, force), stiffness=5.0)
    for batch, points, dt in (((), (), 0.02), ((4,), (3,), 0.02), ((5,), (2,), 0.03)):
        policy, x0 = random_policy(batch=batch), 0.5 * randn(*points, 2)
        with torch.no_grad():
            paths = [rollout(policy, x0, STEPS, dt, plant=plant, backend=backend) for backend in ("scan", "eager")]
        compare(*paths)
        gradients = []
        for backend in ("eager", "scan"):
            path = rollout(policy, x0, STEPS, dt, backend=backend)
            gradients.append(torch.autograd.grad(path.x.square().sum() + path.v.sum(), [policy.A, policy.b]))
        assert_close(gradients[1], gradients[0], rtol=1e-10, atol=1e-12)


def test_gradients_beside_a_box_are_refused(random_policy, randn):
    with pytest.raises(
        InvalidArgumentError, match=r"no gradients where there is a stop condition.*take backend='eager'"
    ):
        rollout(random_policy(), randn(2), STEPS, DT, stop=Bounds(-9.0, 9.0), backend="scan")


@pytest.mark.slow
def test_a_function_that_rolls_out_compiles_as_one_graph(random_policy, randn):
    """Nobody can listen to what a compiled program visits."""
    policy, x0 = random_policy(), 0.5 * randn(2)
    graphs = []

    def keep(graph, inputs):
        graphs.append(graph)
        return graph

    compiled = torch.compile(lambda x: rollout(policy, x, 200, 0.01).x, fullgraph=True, backend=keep)
    with torch.no_grad(), visits.listen() as seen:
        assert_close(compiled(x0), rollout(policy, x0, 200, 0.01, backend="eager").x, rtol=1e-10, atol=1e-10)
    assert len(seen) == 1  # the eager one
    (graph,) = graphs
    assert len(graph.graph.nodes) < 100  # however many steps
