"""What the arm does with a reference: threads that change nothing, a tool that follows, stiffness that digs."""

import pytest
import torch

from torchds.errors import InvalidArgumentError

pytest.importorskip("mujoco")
pytest.importorskip("pytorch_kinematics")

from tasks.digging import lwr
from tasks.digging.simulation import dig, scoop
from tasks.digging.worlds import COARSE, Worlds


@pytest.mark.slow
def test_the_number_of_threads_changes_no_bit_and_neither_does_a_second_use():
    """Beds that sleep and wake keep a state of their own, which a reset has to take back."""
    reference = scoop(2.4)[:300]
    s = torch.tensor([75.0, 300.0, 450.0])
    worlds = Worlds(COARSE, 3, 1)
    dig(worlds, reference[:240], s.flip(0), [7, 8, 9])
    one, two = (dig(each, reference, s, [5, 6, 7]) for each in (worlds, Worlds(COARSE, 3, 2)))
    alone = dig(Worlds(COARSE, 1), reference, s[1:2], [6])
    assert one.force[..., 2].abs().max() > 1.0  # it has touched the gravel
    for name in ("pose", "force", "torque", "load"):
        assert torch.equal(getattr(one, name), getattr(two, name)), name
    torch.testing.assert_close(alone.pose[0, :50], one.pose[1, :50], rtol=0, atol=1e-9)


@pytest.mark.slow
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


def test_bad_references_are_refused():
    worlds = Worlds(COARSE, 2)
    with pytest.raises(InvalidArgumentError, match="reference has to be"):
        dig(worlds, torch.zeros(3, 5, 3), torch.tensor(100.0), [0, 1])
    with pytest.raises(InvalidArgumentError, match="stiffness has to be"):
        dig(worlds, scoop(1.0), torch.zeros(3), [0, 1])
