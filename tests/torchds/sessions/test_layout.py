"""Columns and their units."""

import pytest

import torchds
from torchds.errors import InvalidArgumentError
from torchds.sessions import Layout


def test_velocities_and_levers_follow_from_the_positions():
    layout = Layout(("x [m]", "angle [rad]"), stiffness=("s [N/m]",), measured=("f [N]",))
    assert layout.velocity == ("v_x [m/s]", "v_angle [rad/s]") and layout.lever == (1.0, 1.0)
    assert layout.reference == ("time [s]", "x [m]", "angle [rad]", "v_x [m/s]", "v_angle [rad/s]", "s [N/m]")
    assert layout.recording == ("time [s]", "x [m]", "angle [rad]", "f [N]")
    assert layout.units == ("m", "rad")


def test_names_and_units_are_those_of_demonstrations():
    demos = torchds.poses.from_poses([[[0.0, 0, 0]] * 9], [[[1.0, 0, 0, 0]] * 9], 0.1)
    layout = Layout.of(demos, measured=["force [N]"])
    assert layout.position == ("x [m]", "y [m]", "z [m]", "rx [rad]", "ry [rad]", "rz [rad]")
    bare = torchds.Demonstrations([[[0.0, 1], [1, 2], [2, 4]]], dt=0.1)
    assert Layout.of(bare).position == tuple(f"{name} [1]" for name in bare.names)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"position": ()}, "at least one position"),
        ({"position": ("x",)}, "different names with units, as 'x \\[m\\]'.*got 'x'"),
        ({"position": ("x [m]", "x [m]")}, "different names"),
        ({"position": ("x, y [m]",)}, "different names"),
        ({"position": ("x [m]",), "optional": ("f [N]",)}, "optional ones among the measured"),
        (
            {"position": ("x [m]",), "lever": (1.0, 2.0)},
            r"lever has to have one for each of the 1 positions, got \(1.0, 2.0\)",
        ),
        ({"position": ("x [m]",), "start": (-1.0,)}, "start has to have one"),
        ({"position": ("x [m]",), "velocity": ("v [m/s]", "w [m/s]")}, "velocity has to have one"),
        ({"position": ("x [m]",), "max_gap": 0.0}, "max_gap has to be positive"),
    ],
)
def test_what_is_no_layout_is_refused(options, words):
    with pytest.raises(InvalidArgumentError, match=words):
        Layout(**options)
