"""What names of columns say."""

import pytest

from torchds.recordings.columns import base_names, named, rank, time_unit

KINDS = {
    "time": [
        "t",
        "time",
        "%time",
        "# time",
        "timestamp",
        "time [s]",
        "time_ms",
        "header.stamp",
        "rosbagTimestamp",
        "secs",
    ],
    "part of a second": ["nsecs", "header.stamp.nanosec"],
    "counter": ["seq", "field.header.seq", "sample", "index"],
    "demonstration": ["demo", "trial", "episode_id", "demo_nr", "id"],
    "position": ["x", "y [m]", "pos_x", "joint1", "q3", "pose.position.z", "theta", "tcp_x", "Joint_2", "angle [rad]"],
    "velocity": [
        "vx",
        "v_x",
        "dx",
        "x_dot",
        "dq1",
        "qdot2",
        "twist.linear.x",
        "velocity0",
        "speed",
        "x [m/s]",
        "omega_z",
    ],
    "acceleration": ["ax", "acc_y", "ddx", "x [m/s²]"],
    "force": ["fx", "force_x [N]", "wrench.torque.z", "tau1", "effort0"],
    "quaternion": ["qx", "qw", "orientation.w", "quat_1"],
    "stiffness": ["stiffness", "stiffness [N/m]", "s_1", "stiffness_x"],
    "unknown": [
        "foo",
        "phase",
        "joint_name",
        "",
        "m_2",
        "joint1_temperature",
        "position_error",
        "pos_std",
        "joint_mode",
        "angle_offset",
        "position_valid",
    ],
}


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind, names in KINDS.items() for name in names])
def test_kinds(kind, name):
    assert named(name).kind == kind


def test_units_are_taken_from_brackets_and_ends_of_names():
    assert named("v_x (mm/s)")[:2] == ("v_x", "mm/s")
    units = {"time [ms]": "ms", "time_us": "us", "time (µs)": "us", "t": None, "time": None, "secs": "s", "t_sec": "s"}
    assert {name: time_unit(named(name)) for name in units} == units


def test_the_clock_is_the_one_that_is_called_so():
    assert [rank(named(name)) for name in ("t", "time_ms", "timestamp", "header.stamp")] == [0, 0, 1, 2]


@pytest.mark.parametrize("name", ["vx", "v_x", "dx", "x_dot", "dx/dt", "vel_x", "x_velocity", "twist.linear.x"])
def test_velocities_know_their_positions(name):
    assert "x" in base_names(named(name).words)
    assert not base_names(named("x").words)
