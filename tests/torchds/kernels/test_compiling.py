"""What a roll-out gives does not depend on the company, and no process compiles what another one has compiled."""

import itertools

import numpy as np
import pytest
import torch

from tests.torchds.kernels.comparison import needs_numba
from torchds import Bounds, rollout
from torchds.forces import DivergentForce
from torchds.impedance import ImpedanceControlled
from torchds.plants import PointMass

pytestmark = needs_numba
FIELDS = ("x", "v", "features", "resting", "stiffness", "reference")


@pytest.mark.slow
@torch.no_grad()
def test_the_bits_do_not_depend_on_the_company(random_policy, randn):
    policy, x0 = random_policy(4, 2, 2, 2, batch=(200,)), 0.5 * randn(3, 2)
    plant = ImpedanceControlled(PointMass(force=DivergentForce(torch.eye(2, dtype=torch.float64), 3.0)), low=0.1)
    options = {"n_steps": 200, "dt": 0.02, "stop": Bounds(-3.0, 3.0), "plant": plant, "backend": "fused"}
    together = rollout(policy, x0, **options)
    threads = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        in_two = rollout(policy, x0, **options)
    finally:
        torch.set_num_threads(threads)
    for name in FIELDS:
        a = getattr(together, name)
        assert torch.equal(a, getattr(in_two, name)), name
        for i, point in itertools.product((0, 57, 199), range(3)):
            alone = rollout(policy[i], x0[point], **options)
            assert torch.equal(a[i, point], getattr(alone, name)), name


@torch.no_grad()
@pytest.mark.slow
def test_code_for_one_size_gives_the_bits_of_code_for_all(random_policy, randn, monkeypatch):
    from torchds.kernels import compiling

    policy, x0 = random_policy(3, 2, 3, 1, batch=(7,)), 0.5 * randn(2)
    monkeypatch.setattr(compiling, "_kernels", {})  # whatever other tests have compiled
    paths, loops = [], []
    for many in (10**9, 0):
        monkeypatch.setattr(compiling, "MANY", many)
        paths.append(rollout(policy, x0, 100, 0.03, stop=Bounds(-2.0, 2.0), backend="fused"))
        loops.append(len(compiling._kernels))
    assert loops[1] == loops[0] + 1  # another one was taken
    for name in FIELDS:
        assert torch.equal(getattr(paths[0], name), getattr(paths[1], name)), name


def doubled(first, last, x):
    for i in range(first, last):
        x[i] *= 2.0


@pytest.mark.slow
def test_compiled_code_is_kept_in_a_file_for_each_form(tmp_path, monkeypatch):
    import numba

    from torchds.kernels import compiling

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    x = np.ones(3)
    first = compiling.kept(doubled, ("float64",), (0, 3, x))
    assert sum(first.stats.cache_misses.values()) == 1
    again = compiling.kept(doubled, ("float64",), (0, 3, x))
    assert sum(again.stats.cache_hits.values()) == 1 and not again.stats.cache_misses
    again(0, 2, x)
    assert x.tolist() == [2.0, 2.0, 1.0]
    compiling.kept(doubled, ("float32",), (0, 3, x.astype(np.float32)))
    indices = sorted(tmp_path.rglob("*.nbi"))
    assert len(indices) == len(list(tmp_path.rglob("*.nbc"))) == 2  # an index of one entry cannot mix up its entries
    monkeypatch.setattr(compiling, "SOURCES", "changed")
    assert compiling.kept(doubled, ("float64",), (0, 3, x)).stats.cache_misses  # where any of the files has changed


@pytest.mark.parametrize("damage", [b"", b"no code", None])
@pytest.mark.slow
def test_damaged_code_is_compiled_again(tmp_path, monkeypatch, damage):
    import numba

    from torchds.kernels import compiling

    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path))
    x = np.ones(3)
    compiling.kept(doubled, ("float64",), (0, 3, x))
    for path in [*tmp_path.rglob("*.nbi"), *tmp_path.rglob("*.nbc")]:
        whole = path.read_bytes()
        path.write_bytes(whole[: len(whole) // 2] if damage is None else damage)
        compiling.kept(doubled, ("float64",), (0, 3, x))(0, 3, x)
        path.write_bytes(whole)
    assert x.tolist() == [4.0] * 3


def test_what_is_made_anew_of_the_same_code_is_compiled_once():
    from torchds.kernels.compiling import jitted

    def scaled(factor):
        return lambda x: factor * x

    assert jitted(scaled(2.0)) is jitted(scaled(2.0))
    assert jitted(scaled(2.0)) is not jitted(scaled(3.0))
    assert jitted(jitted(scaled(2.0))) is jitted(scaled(2.0))
    assert jitted(scaled(2.0))(3.0) == 6.0


def test_a_cell_of_a_notebook_that_is_run_again_is_compiled_again_where_a_number_in_it_has_changed():
    from torchds.kernels.compiling import jitted

    cell, notebook = compile("def force(x):\n    return GAIN * x\n", "<cell>", "exec"), {}
    found = []
    for gain in (1.0, 1.0, 2.0):
        notebook["GAIN"] = gain
        exec(cell, notebook)
        found.append(jitted(notebook["force"]))
        assert found[-1](3.0) == notebook["force"](3.0)
    assert found[0] is found[1] is not found[2]
