"""The figures of the bed: against the formula by hand, heights that are known, and what must be so of any gravel."""

import math
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tasks.digging import checks
from tasks.digging.gravel import COARSE, Gravel


def test_the_bearing_capacity_is_that_of_the_textbook():
    """N_q = 18.4 at 30° and 64.2 at 40° (any table of bearing capacity factors)."""
    gravel = Gravel(density=1000.0 / 0.83)
    for angle, factor in ((30.0, 18.4), (40.0, 64.2)):
        assert checks.published(gravel, angle, 0.04) == pytest.approx(9810 * 0.04 * factor * 0.006 * 0.1, rel=2e-3)


def test_the_surface_of_a_ramp_is_its_slope():
    gravel = replace(COARSE, n_grains=2000)
    x = np.linspace(*gravel.box, gravel.n_grains)
    places = np.stack([x, 0.05 + 0.3 * (x - x[0]) - gravel.radii(), np.zeros_like(x)], -1)
    middles, tops = checks._surface(gravel, places)
    assert np.polyfit(middles, tops, 1)[0] == pytest.approx(math.tan(math.atan(0.3)), rel=0.02)


@pytest.mark.slow
def test_a_plate_meets_more_resistance_the_deeper_it_is_and_a_tilted_bed_slides_to_a_slope():
    forces = np.mean([checks.penetration(COARSE, packing) for packing in range(4)], 0)
    assert forces[0] > 0.0 and forces[0] < forces[-1] < 60.0
    assert 5.0 < checks.repose(COARSE) < 38.0
