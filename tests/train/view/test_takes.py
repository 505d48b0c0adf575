"""Trials as the page takes them: the motions, forces and stiffnesses of the roll-outs they come from."""

import numpy as np
import pytest
import torch

import tasks
from tests.tasks.sketch.drawn import FULL
from train.view.takes import of_digging, of_motion


def test_a_motion_in_the_plane_lies_on_the_floor_and_has_a_take_for_each_start():
    task = tasks.make("two_starts")
    policy = task.policy()
    made = of_motion(task, {"before": policy, "after": policy})
    assert [(take.policy, take.trial) for take in made] == [
        (p, f"start {i}") for p in ("before", "after") for i in (1, 2)
    ]
    path = task.rollout(policy).reference.detach()
    for take, x in zip(made, path, strict=False):
        assert np.all(take.paths["motion"][:, 2] == 0.0)
        np.testing.assert_allclose(take.paths["motion"][[0, -1], :2], x[[0, -1]])
        assert take.qpos is None and len(take.times) == len(take.series["speed"]) == len(take.paths["motion"])


def test_what_the_plant_did_is_the_motion_beside_its_reference(tmp_path):
    FULL.write(tmp_path / "a.json")
    task = tasks.make(str(tmp_path / "a.json"))
    (take,) = of_motion(task, {"before": task.policy()})
    path = task.rollout(task.policy())
    for name, x in (("reference", path.reference), ("motion", path.x)):
        np.testing.assert_allclose(take.paths[name][[0, -1], :2], x.detach().reshape(-1, 2)[[0, -1]], atol=1e-12)
    assert np.abs(take.paths["motion"] - take.paths["reference"]).max() > 0.01
    way = np.linalg.norm(np.diff(take.paths["motion"], axis=0), axis=-1)
    np.testing.assert_allclose(take.series["speed"][:-1] * np.diff(take.times), way, rtol=0.3, atol=0.01)


@pytest.mark.slow
def test_digging_meets_the_same_beds_before_and_after():
    pytest.importorskip("mujoco")
    pytest.importorskip("pytorch_kinematics")
    task = tasks.make("lwr_digging", grains="coarse", seconds=1.0)
    before, after = of_digging(task, {"before": task.policy(), "after": task.policy()}, 1)
    np.testing.assert_array_equal(before.qpos, after.qpos)
    assert before.qpos.shape[0] == 11 and before.times[-1] == pytest.approx(1.0)
    assert before.series["stiffness [N/m]"] == pytest.approx(150.0)
    np.testing.assert_allclose(before.paths["tool"][:, 2], before.series["height of the blade [m]"])
    assert torch.as_tensor(before.series["force [N]"]).isfinite().all()
