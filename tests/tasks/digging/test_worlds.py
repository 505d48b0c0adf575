"""The copies of the world: beds at rest, what the wrist weighs, and roll-outs that fail."""

import pytest
import torch

from torchds.errors import InvalidArgumentError

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

import numpy as np  # noqa: E402

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


@pytest.mark.slow
def test_a_bed_stays_at_rest_after_the_perturbation(worlds, start):
    worlds.reset(start, [3, 4])
    held(worlds, start, 250)
    assert (worlds.kinetic_energy < 2e-4).all()
    assert not worlds.failed.any() and not worlds.batch.warning.any()
    settled = np.stack([gravel.bed(COARSE, packing) for packing in (3, 4)])
    moved = worlds.grains[..., :2] - torch.from_numpy(settled[..., :2])
    assert float(moved.norm(dim=-1).mean()) < 0.005


@pytest.mark.slow
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
    seeds = [7, 7 + COARSE.packings]  # of one packing
    worlds.reset(start, seeds)
    first = worlds.grains
    worlds.reset(start, seeds[::-1])
    assert torch.equal(first, worlds.grains.flip(0))
    difference = (first[0] - first[1])[:, :2]
    assert 1e-4 < float(difference.std()) < 2e-4
    worlds.reset(start, [7, 8])
    assert torch.equal(first[0], worlds.grains[0])
    assert float((worlds.grains[0] - worlds.grains[1])[:, :2].std()) > 2e-3  # of another


@pytest.mark.slow
def test_a_bed_that_nothing_touches_sleeps_until_the_blade_comes(worlds, start):
    worlds.reset(start, [0, 1])
    held(worlds, start, 500)
    awake = worlds.batch.bind("tree_asleep") < 0
    assert awake[:, 0].all() and not awake[:, 1:].any()  # the arm never sleeps
    below = lwr.posture(*torch.tensor([0.70, 0.07, -0.6], dtype=torch.float64))
    held(worlds, below, 250)
    assert (worlds.batch.bind("tree_asleep") < 0).sum() > COARSE.n_grains


@pytest.mark.slow
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


def test_each_roll_out_needs_a_seed():
    with pytest.raises(InvalidArgumentError, match="seeds have to be 2, one for each roll-out, got 1"):
        Worlds(COARSE, 2).reset(torch.zeros(7, dtype=torch.float64), [1])


def test_no_roll_outs_or_threads_are_refused():
    with pytest.raises(InvalidArgumentError, match="n and n_threads have to be at least 1, got 0 and 1"):
        Worlds(COARSE, 0)
