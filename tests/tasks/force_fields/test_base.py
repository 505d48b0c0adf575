"""The arch that both force fields share: its curve, and three motions that pass beside it."""

import numpy as np
import torch

from tasks.force_fields.base import arch, arch_demonstrations


def test_the_arch_leads_from_its_start_to_the_origin_in_one_bow():
    s = torch.linspace(0, 1, 101, dtype=torch.float64)
    x = arch(s).numpy()
    np.testing.assert_allclose(x[[0, -1]], [[-12, 0], [0, 0]], atol=1e-12)
    assert (np.diff(x[:, 0]) > 0).all() and (x[1:-1, 1] > 0).all()
    np.testing.assert_allclose(x[50], [-6, 4], atol=1e-12)


def test_the_demonstrations_pass_beside_the_arch_by_the_bias_half_way_and_end_slowly():
    for bias in (0.0, 0.6):
        demos = arch_demonstrations(bias)
        assert len(demos) == 3 and all((len(d.x) - 1) * d.dt == 14.0 for d in demos)
        mean = torch.stack([d.x for d in demos]).mean(0).numpy()
        curve = arch(torch.linspace(0, 1, 4001, dtype=torch.float64)).numpy()
        away = np.linalg.norm(mean[:, None] - curve, axis=-1).min(1)
        assert abs(away.max() - bias) < 0.05
        for d in demos:
            assert float(d.x[-1].norm()) < 1e-6
            assert float(d.v[-1].norm()) < 0.2 * float(d.v[0].norm())
