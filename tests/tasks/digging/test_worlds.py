"""Gravel and worlds: beds at rest, what the wrist weighs, threads, and roll-outs that fail."""

import importlib.util

import pytest
import torch

from torchds.errors import InvalidArgumentError, MissingPackageError

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

import numpy as np  # noqa: E402

import tasks.digging  # noqa: E402
from tasks.digging import gravel, lwr  # noqa: E402
from tasks.digging.simulation import dig, scoop  # noqa: E402
from tasks.digging.worlds import COARSE, PREFIX, Worlds  # noqa: E402


@pytest.fixture(scope="module")
def start():
    return lwr.posture(*torch.tensor([0.59, 0.235, -0.65], dtype=torch.float64))


@pytest.fixture(scope="module")
def worlds():
    return Worlds(COARSE, 2)


def held(worlds, start, n_steps):
    """Advance with the arm held by a stiff spring at each joint."""
    for _ in range(n_steps):
        worlds.step(worlds.bias + 300 * (start - worlds.q) - 20 * worlds.v)


@pytest.mark.slow
def test_the_default_bed_is_at_rest_and_whole():
    worlds = Worlds(gravel.Gravel(), 1)
    q = lwr.posture(*torch.tensor([0.59, 0.30, -0.65], dtype=torch.float64))
    worlds.reset(q, [0])
    held(worlds, q, 100)
    assert worlds.kinetic_energy.item() < 1e-4  # J: as if all 8 kg moved at 5 mm/s
    assert not worlds.failed.any() and not worlds.batch.warning.any()
    top = worlds.grains[..., 1].max().item()
    assert 0.08 < top < 0.12


def test_a_bed_stays_at_rest_after_the_perturbation(worlds, start):
    worlds.reset(start, [3, 4])
    held(worlds, start, 250)
    assert (worlds.kinetic_energy < 2e-4).all()
    assert not worlds.failed.any() and not worlds.batch.warning.any()
    moved = worlds.grains[..., :2] - torch.from_numpy(worlds.settled[:, :2])
    assert float(moved.norm(dim=-1).mean()) < 0.005


def test_the_wrist_weighs_the_empty_shovel(worlds, start):
    worlds.reset(start, [0, 1])
    held(worlds, start, 250)
    expected = torch.tensor([[0.0, 0.0, 5.886]], dtype=torch.float64).expand(2, 3)
    torch.testing.assert_close(worlds.force(*worlds.reading), expected, atol=0.05, rtol=0)


def test_the_arm_comes_first_and_its_mass_matrix_is_gathered(worlds, start):
    model, data = worlds.model, mujoco.MjData(worlds.model)
    assert [model.joint(i).name for i in range(7)] == [PREFIX + name for name in lwr.JOINTS]
    worlds.reset(start, [0, 1])
    data.qpos[:] = worlds.batch.bind("qpos")[1]
    mujoco.mj_forward(model, data)
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    np.testing.assert_array_equal(worlds.mass[1], full[:7, :7])
    np.testing.assert_array_equal(worlds.bias[1], data.qfrc_bias[:7])


def test_of_the_arm_only_the_shovel_touches_anything(worlds):
    model = worlds.model
    touching = {model.body(model.geom(i).bodyid[0]).name for i in range(model.ngeom) if model.geom_contype[i]}
    grains = {f"grain{i}" for i in range(COARSE.n_grains)}
    assert touching == {"world", PREFIX + "shovel"} | grains
    floor_and_walls, shovel_boxes = 3, 5
    assert np.count_nonzero(model.geom_contype == 2) == floor_and_walls + shovel_boxes


def test_beds_differ_by_their_seed_alone(worlds, start):
    worlds.reset(start, [7, 8])
    first = worlds.grains
    worlds.reset(start, [8, 7])
    assert torch.equal(first, worlds.grains.flip(0))
    difference = (first[0] - first[1])[:, :2]
    assert 1e-4 < float(difference.std()) < 2e-4


def test_grains_are_numbered_by_their_place():
    x = gravel.bed(COARSE)[:, 0]
    assert np.corrcoef(x, np.arange(len(x)))[0, 1] > 0.99


def test_a_bed_is_settled_once(monkeypatch):
    bed = gravel.bed(COARSE)

    def settle(settings):
        raise AssertionError("settled again")

    monkeypatch.setattr(gravel, "settle", settle)
    np.testing.assert_array_equal(gravel.bed(COARSE), bed)
    with pytest.raises(AssertionError, match="settled again"):
        gravel.bed(gravel.Gravel(n_grains=100, radius=(0.009, 0.014), seed=1))
    assert [path.suffix for path in gravel.cache_folder().iterdir() if COARSE.key() in path.name] == [".npy"]


def test_a_broken_or_forbidden_cache_costs_only_time(tmp_path, monkeypatch):
    bed = gravel.bed(COARSE)
    (file,) = (path for path in gravel.cache_folder().iterdir() if COARSE.key() in path.name)
    file.write_bytes(b"half a file")
    np.testing.assert_array_equal(gravel.bed(COARSE), bed)
    np.testing.assert_array_equal(np.load(file), bed)
    (tmp_path / "torchds").write_text("a file where the folder should be")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    np.testing.assert_array_equal(gravel.bed(COARSE), bed)


@pytest.mark.parametrize("package", ["mujoco", "pytorch_kinematics"])
def test_a_missing_package_is_named_with_the_extra(package, monkeypatch):
    find_spec = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None if name == package else find_spec(name))
    with pytest.raises(MissingPackageError, match=r"torchds\[digging\]"):
        importlib.reload(tasks.digging)


def test_settings_without_a_bed_are_refused():
    with pytest.raises(InvalidArgumentError, match="a bed has to have grains"):
        gravel.Gravel(radius=(0.02, 0.01))
    with pytest.raises(InvalidArgumentError, match="have to be positive"):
        gravel.Gravel(density=0.0)
    with pytest.raises(gravel.SettlingError, match="still moves"):
        gravel.settle(gravel.Gravel(n_grains=20, seconds=0.02))
    with pytest.raises(InvalidArgumentError, match="seeds have to be 2, one for each roll-out, got 1"):
        Worlds(COARSE, 2).reset(torch.zeros(7, dtype=torch.float64), [1])


def test_a_roll_out_that_explodes_is_marked_and_leaves_the_others_alone(worlds, start):
    reference, s = scoop(0.2), torch.tensor(300.0)
    whole = dig(worlds, reference, s, [0, 1])
    assert not whole.failed.any()
    worlds.reset(start, [0, 1])
    worlds.batch.bind("qvel")[0, 20] = 1e12
    held(worlds, start, 5)
    assert worlds.failed.tolist() == [True, False]
    worlds.reset(start, [0, 1])
    assert not worlds.failed.any()
    worlds.batch.bind("qpos")[1, 7] = 2.0  # a grain outside
    assert worlds.failed.tolist() == [False, True]


@pytest.mark.slow
def test_the_number_of_threads_changes_no_bit():
    reference = scoop(4.0)[:500]
    s = torch.tensor([75.0, 300.0, 450.0])
    one, two = (dig(Worlds(COARSE, 3, threads), reference, s, [5, 6, 7]) for threads in (1, 2))
    alone = dig(Worlds(COARSE, 1), reference, s[1:2], [6])
    assert one.force[..., 2].abs().max() > 1.0  # it has touched the gravel
    for name in ("pose", "force", "torque", "load"):
        assert torch.equal(getattr(one, name), getattr(two, name)), name
    torch.testing.assert_close(alone.pose[0, :50], one.pose[1, :50], rtol=0, atol=1e-9)


def test_without_gravel_in_the_way_the_tool_follows():
    reference = scoop(5.0)
    reference = reference[:1].lerp(
        reference[:1] + torch.tensor([0.1, 0.05, 0.4]), torch.linspace(0, 1, 400)[:, None].double()
    )
    path = dig(Worlds(COARSE, 1), reference, torch.tensor(300.0), [0])
    error = path.pose[0, -1] - reference[-1]
    assert error.abs().max() < 0.01
    assert path.load.abs().max() < 0.2


@pytest.mark.slow
def test_a_soft_arm_loads_less_than_a_stiff_one():
    """The trade-off that the stiffness is learned for: 75 N/m lag behind and scrape, 300 N/m dig."""
    path = dig(Worlds(COARSE, 4), scoop(7.0), torch.tensor([75.0, 75.0, 300.0, 300.0]), [1, 2, 1, 2])
    assert not path.failed.any()
    soft, stiff = path.load[:2].mean(), path.load[2:].mean()
    assert soft + 1.0 < stiff
    depth = path.pose[..., 1].amin(1)
    assert (depth[:2] > depth[2:]).all()
    limit = torch.tensor(lwr.EFFORTS, dtype=torch.float64)
    assert (path.torque.abs() < 0.9 * limit).all()


def test_bad_references_are_refused(worlds):
    with pytest.raises(InvalidArgumentError, match="reference has to be"):
        dig(worlds, torch.zeros(3, 5, 3), torch.tensor(100.0), [0, 1])
    with pytest.raises(InvalidArgumentError, match="stiffness has to be"):
        dig(worlds, scoop(1.0), torch.zeros(3), [0, 1])
