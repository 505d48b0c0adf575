"""Mending recordings, against motions whose right form is known."""

import math

import numpy as np
import pytest
import torch

import torchds
from torchds import Demonstrations
from torchds.errors import DemonstrationWarning, InvalidArgumentError, InvalidDemonstrationsError

pytestmark = pytest.mark.filterwarnings("ignore::torchds.errors.DemonstrationWarning")


def circle(t):
    """(cos, sin) and its exact velocity."""
    return torch.stack([t.cos(), t.sin()], -1), torch.stack([-t.sin(), t.cos()], -1)


@pytest.mark.parametrize("clock", ["square", "jitter", "even"])
def test_an_uneven_clock_gives_the_motion_and_its_velocity(clock):
    even = torch.linspace(0, 2, 201, dtype=torch.float64)
    noise = torch.rand(201, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    t = {"square": even.square() / 2, "jitter": even + 0.004 * (noise - 0.5), "even": even}[clock]
    x, _ = circle(t)
    (d,) = Demonstrations.from_samples([t], [x], dt=0.01)
    at = t[0] + d.dt * torch.arange(len(d.x))
    exact, speed = circle(at)
    assert d.dt == pytest.approx(0.01, rel=0.01) and at[-1] == pytest.approx(float(t[-1]))
    assert (d.x - exact).abs().max() < 1e-5 and (d.v - speed).abs().max() < 2e-3


def test_what_was_resampled_is_said_with_its_gaps():
    t = torch.cat([torch.arange(50) * 0.01, 1.0 + torch.arange(50) * 0.01]).double()
    with pytest.warns(DemonstrationWarning, match=r"100 samples .* resampled to 150 .* gap.* of 0.51 s after row 49"):
        Demonstrations.from_samples([t], [circle(t)[0]])


def test_velocities_and_stiffness_are_resampled_too():
    t = torch.linspace(0, 1, 80, dtype=torch.float64).square()
    x, v = circle(t)
    (d,) = Demonstrations.from_samples([t], [x], [3 * v], stiffness=[100 * t[:, None]], dt=0.02, units="m")
    at = d.dt * torch.arange(len(d.x), dtype=torch.float64)
    assert (d.v - 3 * circle(at)[1]).abs().max() < 1e-3
    assert (d.stiffness[:, 0] - 100 * at).abs().max() < 1e-9


@pytest.mark.parametrize("n", [2, 77])
def test_lines_between_samples_are_read_off_at_as_many_times_as_asked_for_and_nothing_is_said(n):
    t = torch.tensor([5.0, 5.001, 6.0, 9.0], dtype=torch.float64)
    x = torch.tensor([[0.0, 1.0], [1.0, 1.0], [0.0, 2.0], [4.0, 2.0]], dtype=torch.float64)
    (d,) = Demonstrations.from_samples([t], [x], n_samples=n, kind="linear")
    at = np.linspace(5.0, 9.0, n)
    expected = np.stack([np.interp(at, t.numpy(), column) for column in x.T.numpy()], -1)
    assert d.dt == pytest.approx(4.0 / (n - 1)) and np.allclose(d.x, expected, rtol=0, atol=1e-12)
    assert np.allclose(d.v, np.gradient(expected, d.dt, axis=0, edge_order=min(2, n - 1)), rtol=0, atol=1e-9)


def test_a_number_of_samples_is_another_way_to_give_the_time_step():
    t = torch.linspace(0, 1, 80, dtype=torch.float64).square()
    (d,) = Demonstrations.from_samples([t], [circle(t)[0]], n_samples=51)
    (e,) = Demonstrations.from_samples([t], [circle(t)[0]], dt=0.02)
    assert d.dt == e.dt and torch.equal(d.x, e.x) and torch.equal(d.v, e.v)
    with pytest.raises(InvalidArgumentError, match=r"n_samples=51 and dt=0\.02 say the same"):
        Demonstrations.from_samples([t], [circle(t)[0]], n_samples=51, dt=0.02)
    with pytest.raises(InvalidArgumentError, match="kind has to be 'cubic' or 'linear', got 'square'"):
        Demonstrations.from_samples([t], [circle(t)[0]], kind="square")


@pytest.mark.parametrize("row, shift, what", [(4, 0.0, "stands still"), (7, -0.5, "goes back")])
def test_a_time_that_does_not_rise_is_refused_with_all_digits(row, shift, what):
    t = 1.7e9 + torch.arange(30, dtype=torch.float64) * 0.01
    t[row + 1] = t[row] + shift
    with pytest.raises(InvalidDemonstrationsError, match=rf"{what} from row {row}.*{float(t[row])!r}"):
        Demonstrations.from_samples([t], [circle(t)[0]])


def test_samples_at_one_time_are_dropped_on_request():
    t = torch.arange(30, dtype=torch.float64) * 0.01
    twice = torch.cat([t[:10], t[9:]])
    (d,) = Demonstrations.from_samples([twice], [circle(twice)[0]], duplicates="drop")
    assert len(d.x) == 30 and (d.x - circle(t)[0]).abs().max() < 1e-9
    back = torch.cat([t[:20], t[15:]])  # five samples after the twentieth are older than it
    (d,) = Demonstrations.from_samples([back], [circle(back)[0]], duplicates="drop")
    assert len(d.x) == 30 and (d.x - circle(t)[0]).abs().max() < 1e-9


@pytest.mark.parametrize(
    "times, positions, error",
    [
        ([torch.arange(5.0)], [torch.zeros(4, 2)], "4 positions, got 5 times"),
        ([torch.arange(3.0)], [torch.rand(3, 2)], 'at least four; pass kind="linear"'),
        ([torch.tensor([0.0, math.nan, 1.0, 2.0])], [torch.rand(4, 2)], "row 1 .* is not finite"),
        ([torch.arange(4.0)], [torch.rand(4, 2), torch.rand(4, 2)], "one array for each of the 2"),
    ],
)
def test_samples_that_do_not_fit_are_refused(times, positions, error):
    with pytest.raises(InvalidDemonstrationsError, match=error):
        Demonstrations.from_samples(times, positions)


def reach(T=200):
    s = torch.linspace(0, 1, T, dtype=torch.float64)[:, None]
    return torch.cat([10 * s**3 - 15 * s**4 + 6 * s**5, s * (1 - s)], -1)


def test_trimmed_rests_leave_the_motion_alone():
    x = reach()
    padded = torch.cat([x[:1].expand(100, -1), x, x[-1:].expand(100, -1)])
    (d,) = Demonstrations([padded], dt=0.01).trim_rests()
    assert 190 <= len(d.x) <= 202 and not torchds.Demonstrations([d.x], dt=0.01).check()
    assert (d.x[0] - x[0]).abs().max() < 1e-2 and (d.x[-1] - x[-1]).abs().max() < 1e-2


@pytest.mark.slow
def test_a_fit_to_a_trimmed_motion_stays_near_it():
    """A hundred still samples at both ends send the fitted motion far away."""
    x = reach()
    padded = torch.cat([x[:1].expand(100, -1), x, x[-1:].expand(100, -1)])
    demos = Demonstrations([padded], dt=0.01).trim_rests()
    policy = torchds.GMRPolicy.from_demonstrations(demos, 4)
    assert torchds.rollout(policy, x[0] + 0.01, 300, 0.01).x.norm(dim=-1).max() < 3


@pytest.mark.parametrize("period", [2 * math.pi, 360.0])
def test_a_wrapped_angle_goes_on(period):
    angle = period * torch.linspace(-0.3, 0.9, 300, dtype=torch.float64)
    wrapped = (angle + period / 2) % period - period / 2
    demos = Demonstrations([torch.stack([angle.square() / period, wrapped], -1)], dt=0.01)
    (d,) = demos.unwrap()
    assert (d.x[:, 1] - angle).abs().max() < 1e-9 * period
    assert (d.v[:, 1] - (angle[1] - angle[0]) / 0.01).abs().max() < 1e-6 * period
    assert torch.equal(demos.unwrap([1], period=period)[0].x, d.x)
    (later,) = demos.retime(7.0).unwrap()  # whose velocities are taken anew as well, though they were rounded
    assert (later.v[:, 1] - (angle[1] - angle[0]) / later.dt).abs().max() < 1e-6 * period
    with pytest.raises(InvalidArgumentError, match="0 to 1"):
        demos.unwrap([2])


def test_several_motions_in_one_are_split_at_their_seams():
    x = reach()
    demos = Demonstrations([torch.cat([x, x + 0.05, x - 0.05])], dt=0.01)
    parts = demos.split()
    assert [len(d.x) for d in parts] == [200, 200, 200] and torch.equal(parts[1].x, x + 0.05)
    assert parts[1].v.norm(dim=-1).max() < 2  # the jump is in no velocity
    assert [len(d.x) for d in demos.split([99])] == [100, 500]
    for wrong in ([600], [-1]):
        with pytest.raises(InvalidArgumentError, match="from 0 to 598"):
            demos.split(wrong)
    with pytest.raises(InvalidArgumentError, match="no demonstration has a jump"):
        Demonstrations([x], dt=0.01).split()


def test_splines_agree_with_those_of_numpy_polynomials():
    """A cubic is its own spline."""
    t = np.sort(np.random.default_rng(0).uniform(0, 2, 40))
    cubic = np.polynomial.Polynomial([1.0, -2.0, 0.5, 0.25])
    (d,) = Demonstrations.from_samples([t], [cubic(t)[:, None]], dt=0.05)
    at = t[0] + d.dt * np.arange(len(d.x))
    assert np.abs(d.x[:, 0].numpy() - cubic(at)).max() < 1e-9
    assert np.abs(d.v[:, 0].numpy() - cubic.deriv()(at)).max() < 1e-8


@pytest.mark.parametrize("duplicates", ["drop", "refuse"])
def test_no_samples_are_no_demonstration(duplicates):
    with pytest.raises(
        InvalidDemonstrationsError, match="demonstration 0 has 0 samples, a cubic spline needs at least four"
    ):
        Demonstrations.from_samples([np.zeros(0)], [np.zeros((0, 2))], duplicates=duplicates)
