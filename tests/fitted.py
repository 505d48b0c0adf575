"""The mixtures of the tasks, fitted once in a process: equal samples give equal mixtures, as tests/torchds/test_em.py holds."""

import copy

import pytest

import tasks.constrained_reaching
from torchds import em


def once(function, key):
    """`function`, called once for each `key(*arguments)`; whoever calls it again gets a copy."""
    made = {}

    def kept(*arguments, **named):
        asked = key(*arguments, **named)
        if asked not in made:
            made[asked] = function(*arguments, **named)
        return copy.deepcopy(made[asked])

    return kept


def of_samples(y, K, options):
    return y.shape, y.tobytes(), K, options


def of_motions(demonstrations, K, condition, objective, goal):
    motions = tuple((d.x.numpy().tobytes(), d.v.numpy().tobytes(), d.dt) for d in demonstrations)
    return motions, K, condition, objective, goal.numpy().tobytes()


FIT = once(em.fit, of_samples)
FIT_STABLE = once(tasks.constrained_reaching.fit_stable, of_motions)


@pytest.fixture(autouse=True, scope="module")
def fitted_once():
    """For the modules and folders of tests that import it, those of tasks and of commands."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(em, "fit", FIT)
        patch.setattr(tasks.constrained_reaching, "fit_stable", FIT_STABLE)
        yield
