"""Prepared demonstrations against numpy, scipy, and motions whose velocity is known."""

import numpy as np
import pytest
import scipy.interpolate
import scipy.signal
import torch

from tests.motions import equal, refuses, sine, two
from torchds.demonstrations import Demonstrations
from torchds.errors import InvalidArgumentError, InvalidDemonstrationsError, UnknownNameError
from torchds.preparation import gradient

# -- velocities and sampling


def test_differences_are_exact_for_a_parabola_and_second_order_for_a_sine():
    errors = []
    for n in (101, 201):
        x, v, dt = sine(n)
        d = Demonstrations([x], dt=dt)[0]
        assert np.allclose(d.v[:, 1], v[:, 1], atol=1e-12)  # the ends too
        errors.append(abs(d.v[:, 0].numpy() - v[:, 0]).max())
    assert errors[0] / errors[1] == pytest.approx(4, rel=0.05)


def test_differentiate_forgets_given_velocities():
    demos = two()
    assert equal(demos.differentiate(), Demonstrations([d.x for d in demos], dt=demos.dt))
    d = demos.differentiate()[1]
    assert np.allclose(d.v, np.gradient(d.x.numpy(), d.dt, axis=0, edge_order=2), atol=1e-12)
    assert Demonstrations([[[0.0], [3.0]]], dt=0.5)[0].v.tolist() == [[6.0], [6.0]]


@pytest.mark.parametrize("dtype", [torch.float64, torch.float32])
def test_positions_alone_are_known_whatever_was_rounded_since_and_other_velocities_are_not(dtype):
    *parts, dt = sine(26)
    x, v = (torch.from_numpy(part).to(dtype) for part in parts)
    alone, own = Demonstrations([x], dt=dt), Demonstrations([x], [v], dt)
    moved = [alone, alone.shift_to_goal([20.0, 3.0]), alone.scale(1e-3), alone.retime(7.0), alone.mirror(0)]
    assert all(demos.differentiated for demos in moved) and (alone + alone).differentiated
    others = [own, alone + own, alone.every(2), alone.smooth(5), alone.resample(40), alone.forward_differences()]
    assert not any(demos.differentiated for demos in others)


def test_forward_differences_are_euler_steps():
    demos = two(stiffness=True)
    for d, f in zip(demos, demos.forward_differences(), strict=True):
        assert len(f.x) == len(d.x) - 1 == len(f.stiffness) and f.dt == d.dt
        assert torch.allclose(f.x + f.dt * f.v, d.x[1:], atol=1e-14) and torch.equal(f.x, d.x[:-1])
    with refuses(InvalidDemonstrationsError, "demonstration 0 has to have at least two samples, got 1"):
        Demonstrations([[[0.0], [1.0]]], dt=1).forward_differences()


def test_linear_resampling_is_numpys():
    demos = two(stiffness=True)
    for d, r in zip(demos, demos.resample(77), strict=True):
        duration = d.dt * (len(d.x) - 1)
        t, query = np.linspace(0, duration, len(d.x)), np.linspace(0, duration, 77)
        assert r.dt == pytest.approx(duration / 76, rel=1e-14)
        for before, after in ((d.x, r.x), (d.v, r.v), (d.stiffness, r.stiffness)):
            for column in range(before.shape[1]):
                assert np.allclose(after[:, column], np.interp(query, t, before[:, column]), atol=1e-12)


def test_cubic_resampling_is_fourth_order_and_keeps_a_parabola():
    x, v, dt = sine(26)
    fine, exact, fine_dt = sine(251)
    d = Demonstrations([x], [v], dt).resample(251, "cubic")[0]
    assert d.dt == pytest.approx(fine_dt, rel=1e-14)
    assert np.allclose(d.x[:, 1], fine[:, 1], atol=1e-12)
    spline = scipy.interpolate.CubicSpline(np.linspace(0, 2, 26), x[:, 0])  # not-a-knot as well
    assert np.allclose(d.x[:, 0], spline(np.linspace(0, 2, 251)), atol=1e-12)
    assert np.allclose(d.v, exact, atol=1e-5)


def test_resampling_to_the_same_count_changes_nothing():
    demos = two(stiffness=True)[:1]
    for a, b in zip(demos.stacked(), demos.resample(101).stacked(), strict=True):
        assert torch.allclose(a, b, atol=1e-14, rtol=0)


def test_every_nth_sample():
    demos = two(stiffness=True)
    for d, e in zip(demos, demos.every(3), strict=True):
        assert torch.equal(e.x, d.x[::3]) and torch.equal(e.v, d.v[::3]) and torch.equal(e.stiffness, d.stiffness[::3])
        assert e.dt == d.dt * 3
    assert equal(demos.every(1), demos)


def test_smoothing_is_savitzky_golay_and_keeps_its_polynomials():
    demos = two()
    noise = 0.01 * np.random.default_rng(0).normal(size=(101, 2))
    noisy = Demonstrations([demos[0].x + torch.from_numpy(noise)], dt=0.02)
    smooth = noisy.smooth(21)
    assert np.allclose(smooth[0].x, scipy.signal.savgol_filter(noisy[0].x, 21, 3, axis=0), atol=1e-14)
    assert (smooth[0].v - demos[0].v).abs().mean() < (noisy[0].v - demos[0].v).abs().mean() / 4
    parabola = demos.smooth(9, order=2)
    assert np.allclose(parabola[0].x[:, 1], demos[0].x[:, 1], atol=1e-12)
    assert np.allclose(parabola[0].v[:, 1], demos[0].v[:, 1], atol=1e-11)


# -- space, time and stiffness


def test_shift_to_goal_ends_there():
    demos = two(stiffness=True)
    for goal, end in ((None, [0.0, 0.0]), ([1, -2], [1.0, -2.0]), (torch.tensor([3.0, 4.0]), [3.0, 4.0])):
        shifted = demos.shift_to_goal(goal)
        for d, s in zip(demos, shifted, strict=True):
            assert s.x[-1].tolist() == end and torch.equal(s.v, d.v) and torch.equal(s.stiffness, d.stiffness)
            assert torch.allclose(s.x.diff(dim=0), d.x.diff(dim=0), atol=1e-14)


def test_scale_retime_and_mirror_keep_velocity_the_derivative_of_position():
    demos = two(stiffness=True, units="m").differentiate()
    changed = demos.scale(1e3, units="mm").retime(0.7).mirror(1)
    assert changed.units == ("mm", "mm") and demos.scale(2.0).units == ("m", "m")
    for d, c, derivative in zip(demos, changed, changed.differentiate(), strict=True):
        assert c.dt == pytest.approx(0.7 / (len(d.x) - 1), rel=1e-14)
        assert torch.equal(c.x, d.x * torch.tensor([1e3, -1e3], dtype=torch.float64))
        assert torch.allclose(c.v, derivative.v, rtol=1e-10, atol=1e-8)
        assert torch.equal(c.stiffness, d.stiffness)
    assert equal(demos.mirror(-1).mirror(1), demos)


def test_with_stiffness_is_a_constant_column_each():
    one, two_columns = two().with_stiffness(200), two(stiffness=True).with_stiffness([100, 50.0])
    assert one[1].stiffness.shape == (61, 1) and (one[1].stiffness == 200).all()
    assert two_columns[0].stiffness.shape == (101, 2) and two_columns[0].stiffness[7].tolist() == [100, 50]


def test_what_is_prepared_leaves_the_original_alone():
    demos, untouched = two(stiffness=True, names="ab", units="m"), two(stiffness=True, names="ab", units="m")
    prepared = demos.resample(50).smooth(9).shift_to_goal().mirror(0).retime(1.0).with_stiffness(1.0)
    assert equal(demos, untouched)
    assert isinstance(prepared, Demonstrations) and prepared.names == ("a", "b") and prepared.units == ("m", "m")


def test_a_gradient_of_two_samples_is_their_slope_and_of_three_exact_for_a_parabola():
    assert gradient(torch.tensor([[1.0], [2.0]]), 0.25).tolist() == [[4.0], [4.0]]
    assert gradient(torch.tensor([[0.0], [1.0], [4.0]]), 1.0).tolist() == [[0.0], [2.0], [4.0]]


# -- refused


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda d: d.resample(1), ["n_samples has to be an integer of at least 2, got 1"]),
        (lambda d: d.resample(10.5), ["n_samples", "got 10.5"]),
        (
            lambda d: Demonstrations([[[0], [1], [2]]], dt=1).resample(9, "cubic"),
            ["needs four samples, got 3 in demonstration 0", 'kind="linear"'],
        ),
        (lambda d: d.every(0), ["n has to be an integer of at least 1, got 0"]),
        (lambda d: d.every(61), ["n has to be below the 61 samples of demonstration 1, got 61"]),
        (lambda d: d.smooth(6), ["window has to be odd, got 6", "use 7"]),
        (lambda d: d.smooth(3), ["window", "at least 4, got 3"]),
        (lambda d: d.smooth(5, 0), ["order", "at least 1, got 0"]),
        (lambda d: d.smooth(99), ["at most the 61 samples of demonstration 1, got 99"]),
        (lambda d: d.shift_to_goal([0, 0, 0]), ["goal has to be (2,)", "got (3,)"]),
        (lambda d: d.shift_to_goal([0, float("nan")]), ["goal", "finite numbers, got [0, nan]"]),
        (lambda d: d.scale(0), ["factor has to be positive and finite, got 0"]),
        (lambda d: d.scale(1, units=["m"]), ["units has to be one for each of the 2 dimensions"]),
        (lambda d: d.retime(float("inf")), ["duration", "finite, got inf"]),
        (lambda d: d.mirror(2), ["dim has to be 0 to 1", "got 2"]),
        (lambda d: d.with_stiffness(float("nan")), ["stiffness", "finite numbers, got nan"]),
        (lambda d: d.with_stiffness([[1, 2]]), ["stiffness has to be one row", "got [[1, 2]]"]),
    ],
)
def test_methods_refuse_bad_arguments(call, words):
    with refuses(InvalidArgumentError, *words):
        call(two())


def test_unknown_interpolation_is_refused():
    with refuses(UnknownNameError, "'cubik'", "Did you mean 'cubic'"):
        two().resample(10, "cubik")
