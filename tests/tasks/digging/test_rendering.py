"""Pictures of a trial, where the machine can make them."""

import numpy as np
import pytest

import tasks

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tasks.digging.rendering import NoRendererError


@pytest.mark.slow
def test_the_film_shows_the_arm_move():
    task = tasks.make("lwr_digging", grains="coarse", seconds=1.0)
    path = task.rollout(task.policy())
    try:
        film = task.film(path, 2)
    except NoRendererError as error:
        assert "MUJOCO_GL" in str(error)
        return
    assert film.shape == (2, 480, 640, 3)
    assert film.dtype == np.uint8
    orange = (film[..., 0] > 150) & (film[..., 2] < 90)  # the links
    assert (orange.sum((1, 2)) > 5000).all()
    assert (orange[0] != orange[1]).sum() > 500
