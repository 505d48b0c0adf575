"""Shared by all tests: one thread, and random objects in float64 from one seed."""

from pathlib import Path

import numpy as np
import pytest
import threadpoolctl
import torch

import torchds

HERE = Path(__file__).parent
WAITING = {"test_layout.py", "test_own_task.py", "test_runs.py", "test_worker.py"}
UNTRACED, TRACED = (HERE / "tasks", HERE / "train"), HERE / "train" / "hardware"


def pytest_configure(config):
    # Tests of these warnings ask for them. Named in pyproject.toml, torchds would be imported before coverage looks.
    config.addinivalue_line("filterwarnings", "ignore::torchds.errors.DemonstrationWarning")


def pytest_collection_modifyitems(items):
    """Tests that are slow where coverage looks are marked no_cover: those in which torch or Triton traces a program, which it
    takes twice as long, and those of tasks and commands, which reach hardly a line of torchds that its own tests leave out;
    those of sessions with a robot do.
    """
    # What waits most for other processes begins first: at the end there would be nothing to do beside it.
    items.sort(key=lambda item: item.path.name not in WAITING)
    for item in items:
        if any(map(item.path.is_relative_to, UNTRACED)) and not item.path.is_relative_to(TRACED):
            item.add_marker("no_cover")


def pytest_runtest_setup(item):
    if item.get_closest_marker("gpu") and not torch.cuda.is_available():
        pytest.skip("needs a GPU")


@pytest.fixture(autouse=True, scope="session")
def one_thread():
    """Sums are made in one order, and tests that run side by side do not fight for cores."""
    torch.set_num_threads(1)
    with threadpoolctl.threadpool_limits(1):  # numpy and scikit-learn
        yield


@pytest.fixture
def randn():
    """Unit normals from a generator of the test's own."""
    generator = torch.Generator().manual_seed(0)
    return lambda *shape: torch.randn(*shape, generator=generator, dtype=torch.float64)


@pytest.fixture
def random_mixture(randn):
    """Mixtures of overlapping Gaussians: standard deviations around one, means a few of them apart."""

    def make(K=3, F=4, batch=()):
        root = 0.5 * randn(*batch, K, F, F)
        covariances = root @ root.mT + 0.3 * torch.eye(F, dtype=torch.float64)
        return torchds.GaussianMixture(randn(*batch, K).softmax(-1), 1.5 * randn(*batch, K, F), covariances)

    return make


@pytest.fixture
def random_policy(random_mixture, randn):
    """Conditioned random mixtures; the policies of a batch, and one policy if moved, differ from the initial one."""

    def make(K=3, D=2, O=2, Q=0, batch=(), moved=False):
        policy = torchds.GMRPolicy.from_mixture(random_mixture(K, D + O + Q), D, stiffness_dim=Q)
        if batch or moved:
            theta = policy.pack().detach()
            policy.unpack(theta + 0.3 * randn(*batch, *theta.shape))
        return policy

    return make


@pytest.fixture
def gmr_as_printed():
    """Eq. 1-3 for one x, symbol by symbol in numpy: h (K,), A (K, O, D), b (K, O) and E[y | x] (O,)."""

    def gmr(mixture, x):
        priors, means, covariances = (m.numpy() for m in (mixture.priors, mixture.means, mixture.covariances))
        x, D = np.asarray(x), len(x)
        density, A, b = [], [], []
        for pi, mu, Sigma in zip(priors, means, covariances, strict=True):
            inverse = np.linalg.inv(Sigma[:D, :D])
            distance = (x - mu[:D]) @ inverse @ (x - mu[:D])
            scale = np.sqrt((2 * np.pi) ** D * np.linalg.det(Sigma[:D, :D]))
            density.append(pi * np.exp(-0.5 * distance) / scale)
            A.append(Sigma[D:, :D] @ inverse)
            b.append(mu[D:] - A[-1] @ mu[:D])
        h = np.array(density) / sum(density)
        y = sum(h_k * (A_k @ x + b_k) for h_k, A_k, b_k in zip(h, A, b, strict=True))
        return h, np.array(A), np.array(b), y

    return gmr
