"""Which columns are positions is told by names or asked for, and never guessed."""

import numpy as np
import pytest

from tests.motions import refuses
from tests.recorded import COUNT, DT, TIMES, N, X, is_motion, table
from torchds import load
from torchds.errors import DemonstrationWarning, FileError


def test_means_and_spreads_beside_each_other_are_asked_for(file):
    path = file(table("time,m_x,m_y,s_x,s_y", TIMES, *X.T, *X.T))
    with refuses(
        FileError, "cannot tell which columns are positions", "positions=('m_x', 'm_y')", "ignore=('s_x', 's_y')"
    ):
        load(path)
    for chosen in ({"positions": ("m_x", "m_y")}, {"ignore": ("s_x", "s_y")}):  # both of which the error names
        demos = load(path, **chosen)
        assert is_motion(demos)
        assert demos[0].stiffness is None


def test_a_column_of_unknown_name_is_asked_for(file):
    path = file(table("time,foo,bar", TIMES, *X.T))
    with refuses(
        FileError, "cannot tell which columns are positions: foo, bar", "positions=('foo',)", "ignore=('bar',)"
    ):
        load(path)
    assert is_motion(load(path, positions=("foo", "bar")))


def test_units_in_the_header_are_kept(file):
    speeds = np.gradient(X, DT, axis=0)
    header = "time [s],x [m],y [m],v_x [m/s],v_y [m/s],stiffness [N/m]"
    demos = load(file(table(header, TIMES, *X.T, *speeds.T, 0 * TIMES + 150)))
    assert is_motion(demos)
    assert (demos.names, demos.units) == (("x", "y"), ("m", "m"))
    assert demos[0].stiffness.tolist() == [[150.0]] * N
    np.testing.assert_allclose(demos[0].v.numpy(), speeds, atol=1e-5)


def test_words_and_empty_columns_are_ignored(file):
    demos = load(file(table("time,x,phase,y,note", TIMES, X[:, 0], ["reach"] * N, X[:, 1], [""] * N)))
    assert is_motion(demos)
    assert demos.names == ("x", "y")


def test_a_word_among_the_numbers_of_a_position_is_no_reason_to_ignore_it(file):
    path = file(table("time,x,y", TIMES, X[:, 0], ["1.0"] * 3 + ["bad"] * (N - 3)))
    with refuses(FileError, "line 5, column 'y': 'bad' is not a finite number", "ignore='y'"):
        load(path)
    assert is_motion(load(path, ignore="y"), x=X[:, :1])


@pytest.mark.parametrize(
    "names",
    ["vx,vy", "v_x,v_y", "dx,dy", "x_dot,y_dot", "xdot,ydot", "vel_x,vel_y", "x_vel,y_vel", "velocity_x,velocity_y",
     "dx/dt,dy/dt", "twist.linear.x,twist.linear.y", "vx [m/s],vy [m/s]"],
)  # fmt: skip
def test_velocities_are_recognised(file, names):
    speeds = np.stack([np.cos(0.1 * COUNT) * 10, 0 * COUNT + 2.0], -1)
    demos = load(file(table(f"time,x,y,{names}", TIMES, *X.T, *speeds.T)))
    assert is_motion(demos)
    np.testing.assert_allclose(demos[0].v.numpy(), speeds, atol=1e-6)


def test_velocities_are_compared_with_the_derivative(file):
    path = file(table("time,x,y,vx,vy", TIMES, *X.T, *-np.gradient(X, DT, axis=0).T))
    with pytest.warns(DemonstrationWarning, match="velocity sign"):
        load(path)
    assert float(load(path, velocities=())[0].v[0, 0]) > 0
    path = file(table("time,x,y,vx", TIMES, *X.T, X[:, 0]))
    with refuses(FileError, "the velocities are vx but the positions x, y", "velocities=()"):
        load(path)
    assert is_motion(load(path, velocities=()))


def test_forces_and_accelerations_are_left_out_aloud(file):
    path = file(table("time,x,y,fx,torque_z,ax", TIMES, *X.T, *X.T, TIMES))
    with pytest.warns(DemonstrationWarning, match=r"fx \(force\), torque_z \(force\), ax \(acceleration\)"):
        assert is_motion(load(path))


def test_a_quaternion_is_recognised(file):
    half = 0.05 * COUNT
    path = file(table("time,x,y,z,qx,qy,qz,qw", TIMES, *X.T, 0 * half, 0 * half, 0 * half, np.sin(half), np.cos(half)))
    with refuses(FileError, "qx, qy, qz, qw are a quaternion", "positions=('x', 'y', 'z')", "torchds.poses.from_poses"):
        load(path)
    assert load(path, positions=("x", "y", "z")).names == ("x", "y", "z")
    with pytest.warns(DemonstrationWarning, match="unit quaternion"):
        assert load(path, positions=("x", "y", "z", "qx", "qy", "qz", "qw")).dim == 7


def test_the_projects_own_tables_are_read(file):
    pose = [*X.T, TIMES]
    header = "time [s],x [m],z [m],angle [rad]"
    rollout = file(table(f"{header},v_x [m/s],v_z [m/s],v_angle [rad/s],stiffness [N/m]", TIMES, *pose, *pose, TIMES))
    assert load(rollout).units == ("m", "m", "rad")
    forces = [TIMES] * 3
    recording = file(table(f"{header},force_x [N],force_y [N],force_z [N]", TIMES, *pose, *forces), "b.csv")
    demos = load(recording)
    assert (demos.names, demos.units) == (("x", "z", "angle"), ("m", "m", "rad"))
