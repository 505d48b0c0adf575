import sys

import numpy as np
import pytest
import torch
from torch.testing import assert_close

from torchds.errors import InvalidArgumentError, MissingPackageError
from torchds.metrics import direction_error, dtwd, swept_area, velocity_rmse


def tensor(*rows):
    return torch.tensor(rows, dtype=torch.float64)


def test_the_velocity_error_is_a_mean_of_roots_not_the_root_of_a_mean():
    v = tensor([0.0, 0.0], [1.0, 1.0])
    predicted = tensor([3.0, 4.0], [1.0, 1.0])  # errors of length 5 and 0
    assert float(velocity_rmse(v, predicted)) == pytest.approx(5 / np.sqrt(2) / 2)
    assert velocity_rmse(torch.zeros(4, 3, 10, 2), torch.ones(4, 3, 10, 2)).shape == (4, 3)


def test_the_direction_error_depends_on_angles_only():
    v = tensor([1.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 0.0])
    predicted = tensor([5.0, 0.0], [0.0, 1e-8], [-2.0, 0.0], [1.0, 1.0])
    assert float(direction_error(v, predicted)) == pytest.approx((0 + 1 + 2 + 1 - np.sqrt(0.5)) / 4)


def test_the_swept_area_between_parallel_lines_is_that_of_the_rectangle():
    low, high = tensor([0.0, 0.0], [4.0, 0.0]), tensor([0.0, 3.0], [1.0, 3.0], [4.0, 3.0])
    assert float(swept_area(low, high)) == pytest.approx(12.0)
    assert float(swept_area(low, low)) == pytest.approx(0.0, abs=1e-12)


def test_the_swept_area_of_concentric_arcs_is_that_of_the_sector_and_speed_does_not_enter():
    s = torch.linspace(0, 1, 2000, dtype=torch.float64)
    angle = np.pi * s[:, None]
    inner, fast = (r * torch.cat([a.cos(), a.sin()], -1) for r, a in ((1.0, angle), (2.0, np.pi * s[:, None] ** 3)))
    assert float(swept_area(inner, fast)) == pytest.approx(np.pi / 2 * (4 - 1), rel=1e-3)


def test_the_swept_area_does_not_depend_on_the_dimension_of_the_space(randn):
    x, y = randn(30, 2).cumsum(0), randn(40, 2).cumsum(0)
    turn = torch.linalg.qr(randn(5, 5))[0][:, :2]
    assert_close(swept_area(x @ turn.T, y @ turn.T), swept_area(x, y), rtol=1e-9, atol=1e-9)


def test_a_path_that_pauses_sweeps_the_same_area():
    path, paused = tensor([0.0, 0.0], [1.0, 0.0], [2.0, 0.0]), tensor([0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0])
    other = path + tensor([0.0, 1.0])
    assert float(swept_area(paused, other)) == pytest.approx(float(swept_area(path, other)))


def test_a_single_point_is_no_path():
    with pytest.raises(
        InvalidArgumentError, match=r"a path has to be \(\*batch, T, D\) with T ≥ 2, got shape \(1, 2\)"
    ):
        swept_area(torch.zeros(1, 2), torch.zeros(3, 2))


def warping(a, b):
    """The recursion as textbooks print it."""
    distance = np.linalg.norm(a[:, None] - b[None], axis=-1)
    total = np.full((len(a) + 1, len(b) + 1), np.inf)
    total[0, 0] = 0.0
    for i in range(len(a)):
        for j in range(len(b)):
            total[i + 1, j + 1] = distance[i, j] + min(total[i, j], total[i, j + 1], total[i + 1, j])
    return total[-1, -1]


@pytest.mark.parametrize(("n", "m", "D"), [(1, 1, 2), (1, 7, 2), (30, 45, 2), (40, 20, 3)])
def test_dtwd_is_the_recursion(randn, n, m, D):
    a, b = randn(n, D).cumsum(0), randn(m, D).cumsum(0)
    assert dtwd(a, b) == pytest.approx(warping(a.numpy(), b.numpy()), rel=1e-12)


def test_a_batch_of_paths_is_measured_as_each_alone(randn):
    x, one, each = randn(2, 3, 20, 2), randn(15, 2), randn(2, 3, 15, 2)
    for measure in (dtwd, swept_area):
        for other in (one, each):
            batch = measure(x, other)
            alone = [[measure(x[i, j], other if other is one else other[i, j]) for j in range(3)] for i in range(2)]
            assert_close(batch, torch.tensor(alone, dtype=x.dtype), rtol=1e-13, atol=0)


def test_dtwd_by_hand():
    line, late = tensor([0.0, 0.0], [1.0, 0.0], [2.0, 0.0]), tensor([0.0, 0.0], [0.0, 0.0], [1.0, 0.0], [2.0, 0.0])
    assert dtwd(line, late) == 0.0
    assert dtwd(line, late + tensor([0.0, 2.0])) == pytest.approx(4 * 2.0)
    assert dtwd(line.float(), late.requires_grad_()) == 0.0


def test_without_its_package_dtwd_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "dtaidistance", None)
    with pytest.raises(MissingPackageError, match=r"'dtaidistance'.*pip install 'torchds\[metrics\]'"):
        dtwd(torch.zeros(2, 2), torch.zeros(2, 2))
