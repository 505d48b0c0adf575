"""What `find` says about motions with one fault each, made by hand; and that sound motions get no finding."""

import math

import pytest
import torch

from torchds.findings import Recording, find, jumps, resting
from torchds.recordings import lasa_names, load_lasa

DT = 0.01


def reach(T=200, start=(0.0, 0.0), end=(1.0, 0.5)):
    """A minimum-jerk reach (T, 2) with a bow, and its exact velocity."""
    s = torch.linspace(0, 1, T, dtype=torch.float64)[:, None]
    a, b = torch.tensor([start, end], dtype=torch.float64)
    course, rate = 10 * s**3 - 15 * s**4 + 6 * s**5, (30 * s**2 - 60 * s**3 + 30 * s**4) / ((T - 1) * DT)
    bow = torch.tensor([0.0, 0.3], dtype=torch.float64)
    x = a + (b - a) * course + bow * torch.sin(math.pi * course)
    return x, rate * ((b - a) + bow * math.pi * torch.cos(math.pi * course))


def named(*recordings, names=None):
    D = recordings[0].x.shape[1]
    return find(recordings, names or [f"x{d + 1}" for d in range(D)])


def only(findings, name):
    assert [finding.name for finding in findings] == [name], str(findings)
    return findings[0]


def test_a_sound_reach_has_no_finding():
    x, v = reach()
    assert not named(Recording(x, v, DT))
    assert not named(Recording(x, None, DT))
    assert str(named(Recording(x, v, DT))) == "nothing suspicious was found"


@pytest.mark.parametrize("name", lasa_names())
def test_no_handwritten_motion_is_suspected(name):
    demos = load_lasa(name)
    assert not find([Recording(d.x, d.v, d.dt) for d in demos], demos.names)


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
def test_findings_do_not_depend_on_the_unit_of_length(scale):
    x, v = reach()
    assert not named(Recording(scale * x, scale * v, DT))
    assert only(named(Recording(scale * x, -scale * v, DT)), "velocity sign")


def test_velocities_in_another_unit_are_named_with_the_factor():
    x, v = reach()
    assert only(named(Recording(x, 1000 * v, DT)), "velocity unit").value == pytest.approx(1000, rel=1e-2)


def test_velocities_of_exchanged_axes_are_named_with_their_order():
    x, v = reach()
    assert "x2, x1" in only(named(Recording(x, v.flip(-1), DT)), "velocity axes").message


def test_velocities_of_something_else_are_named():
    x, v = reach()
    other = torch.randn(v.shape, generator=torch.Generator().manual_seed(0), dtype=v.dtype)
    only(named(Recording(x, other, DT)), "velocity")


def test_two_motions_in_one_are_found_at_their_seam():
    x, _ = reach()
    both = torch.cat([x, x + 0.02])
    finding = next(f for f in named(Recording(both, None, DT)) if f.name == "jump")
    assert finding.row == 199 and finding.call == "split()" and jumps(both) == [199]


def test_a_sensor_that_holds_its_last_value_does_not_jump():
    x, _ = reach()
    held = x.repeat_interleave(10, 0)
    assert not jumps(held)
    assert jumps(torch.cat([held, held + 0.02])) == [len(held) - 1]


@pytest.mark.parametrize("turn", [2 * math.pi, 360.0])
def test_an_angle_that_wraps_is_no_jump(turn):
    angle = torch.linspace(0, 1.2, 200, dtype=torch.float64)[:, None] * turn * 0.6
    wrapped = (angle + turn / 2) % turn - turn / 2
    finding = only(named(Recording(torch.cat([wrapped, angle**2 / turn], -1), None, DT)), "wrapped angle")
    assert finding.call == "unwrap([0])"


def test_rests_are_counted_at_both_ends():
    x, _ = reach()
    padded = torch.cat([x[:1].expand(100, -1), x, x[-1:].expand(100, -1)])
    found = named(Recording(padded, None, DT))
    assert [f.name for f in found] == ["rest", "rest"] and all(f.call == "trim_rests()" for f in found)
    begin, end = resting(padded)
    assert 100 <= begin < 130 and 100 <= end < 130


def test_a_motion_that_never_moves_is_a_rest_as_a_whole():
    x, v = reach()
    found = only(named(Recording(x, v, DT), Recording(x[-1:].expand(50, -1), None, DT)), "rest")
    assert (found.demonstration, found.row, found.value) == (1, None, 50)
    assert "it never moves: 50 samples of one place [rest]. Call demos[1:], or a slice that leaves it out" in str(found)


def test_a_unit_quaternion_among_the_columns_is_recognised():
    angle = torch.linspace(0, 1, 50, dtype=torch.float64)
    zero = torch.zeros_like(angle)
    q = torch.stack([torch.sin(angle / 2), zero, zero, torch.cos(angle / 2)], -1)
    x = torch.cat([torch.stack([angle, angle**2, angle**3], -1), q], -1)
    finding = only(named(Recording(x, None, DT), names=["x", "y", "z", "qx", "qy", "qz", "qw"]), "unit quaternion")
    assert "qx, qy, qz, qw" in finding.message and "torchds.poses.from_poses(position, [d.x[:, 3:7]" in finding.call


def test_motions_that_end_apart_are_asked_for_one_goal():
    a, b = reach()[0], reach(end=(1.0, 1.2))[0]
    assert only(named(Recording(a, None, DT), Recording(b, None, DT)), "goals apart").demonstration is None


def test_a_closed_curve_is_named_with_its_farthest_row():
    s = torch.linspace(0, 2 * math.pi, 201, dtype=torch.float64)
    finding = only(named(Recording(torch.stack([s.cos(), s.sin()], -1), None, DT)), "closed curve")
    assert finding.row == 100


@pytest.mark.parametrize("dt", [1e-7, 1e7])
def test_a_clock_in_another_unit_is_named(dt):
    x, _ = reach()
    only(named(Recording(x, None, dt)), "time unit")


def test_exchanged_rows_and_columns_are_named():
    x, _ = reach()
    assert "few samples" in [f.name for f in named(Recording(x.T[:, :30].contiguous(), None, DT))]


def test_an_offset_that_swallows_the_motion_is_named():
    x, _ = reach()
    assert not named(Recording(x + 1e6, None, DT))
    only(named(Recording((1e-3 * x).float() + 1e3, None, DT)), "offset")
