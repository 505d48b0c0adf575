"""What is measured of the via-point tasks."""

import pytest
import torch

from train.paper.measured.via_points import asymmetry


def test_mirror_images_have_no_asymmetry_and_a_shift_has_its_length(randn):
    right = randn(4, 9, 2)
    left = right * torch.tensor([-1.0, 1.0], dtype=torch.float64)
    pair = torch.stack([left, right], -3)  # (4, 2, 9, 2)
    assert asymmetry(pair).shape == (4,) and float(asymmetry(pair).abs().max()) == 0.0
    pair[:, 1] += torch.tensor([3.0, 4.0], dtype=torch.float64)
    assert asymmetry(pair).tolist() == pytest.approx([5.0] * 4)
