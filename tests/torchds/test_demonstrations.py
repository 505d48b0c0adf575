import copy
import doctest
import operator
import pickle

import numpy as np
import pytest
import torch

import torchds.demonstrations
from tests.motions import equal, refuses, sine, two
from torchds.demonstrations import Demonstrations
from torchds.errors import (
    InvalidArgumentError,
    InvalidDemonstrationsError,
)

# -- the sequence


def test_the_examples_run():
    assert doctest.testmod(torchds.demonstrations).failed == 0


def test_is_a_sequence():
    demos = two()
    assert len(demos) == 2 and [len(d.x) for d in demos] == [101, 61]
    assert demos.dim == 2 and demos.names == ("x1", "x2") and demos.units == ("", "") and demos.dt == (0.02, 0.05)
    x, v, dt, stiffness = demos[-1]
    assert x.shape == v.shape == (61, 2) and dt == 0.05 and stiffness is None and x.dtype == torch.float64
    assert isinstance(demos[1:], Demonstrations) and equal(demos[1:] + demos[:1], demos[::-1])
    with pytest.raises(IndexError):
        demos[2]
    assert repr(demos) == "Demonstrations(2 of 61 to 101 samples, dimensions x1, x2, dt 0.02 to 0.05 s)"
    named = two(stiffness=True, names=["a", "b"], units="m")
    assert "a [m], b [m], dt 0.02 to 0.05 s, stiffness 1)" in repr(named)


def test_is_immutable():
    x, v, dt = sine()
    demos = Demonstrations([x], [v], dt)
    x[:] = 0
    assert demos[0].x.abs().max() > 0
    for attribute in ("names", "dt", "anything"):
        with pytest.raises(AttributeError):
            setattr(demos, attribute, 1)
    with pytest.raises(TypeError):
        demos[0] = demos[0]


def test_copies_and_pickles_are_equal():
    demos = two(stiffness=True, names="ab", units=("m", "rad"))
    assert equal(copy.deepcopy(demos), demos) and equal(pickle.loads(pickle.dumps(demos)), demos)


def test_dtype_follows_float_data_and_is_float64_otherwise():
    x = torch.arange(6.0).reshape(3, 2)
    for data, dtype in [
        (x, torch.float32),
        (x.numpy(), torch.float32),
        (x.double(), torch.float64),
        (x.tolist(), torch.float64),
        (x.int(), torch.float64),
        (x.half(), torch.float64),
        (x.numpy().astype(">f8")[::-1], torch.float64),
    ]:
        demos = Demonstrations([data], dt=0.5).with_stiffness(3).resample(5).smooth(3, 1).shift_to_goal().mirror(0)
        demos = demos.scale(2.0).retime(1.0).every(2).differentiate().forward_differences()
        assert {t.dtype for t in demos.stacked()} == {dtype}
    assert Demonstrations([x, x.double()], dt=1.0)[0].v.dtype == torch.float64


def test_a_tensor_of_equal_demonstrations_is_taken_apart():
    x = torch.rand(4, 10, 3, generator=torch.Generator().manual_seed(0))
    demos = Demonstrations(x, dt=0.1)
    assert len(demos) == 4 and torch.equal(demos[2].x, x[2])


def test_add_keeps_names_and_known_units():
    a, b = two(names="ab"), two(units="m")
    both = a + b
    assert len(both) == 4 and both.names == ("a", "b") and both.units == ("m", "m")
    with refuses(InvalidArgumentError, "have to be in ('m', 'm'), got ('mm', 'mm')", "scale()"):
        b + two(units="mm")
    with refuses(InvalidArgumentError, "have to have 2 dimensions, got 1"):
        a + Demonstrations([[[0], [1]]], dt=1)
    with refuses(InvalidArgumentError, "a stiffness both or neither", "with_stiffness()"):
        a + two(stiffness=True)
    with pytest.raises(TypeError):
        operator.add(a, [1])


def test_stacked_is_all_samples():
    demos = two(stiffness=True)
    x, v, stiffness = demos.stacked()
    assert x.shape == v.shape == (162, 2) and stiffness.shape == (162, 1)
    assert torch.equal(x[101:], demos[1].x) and torch.equal(stiffness[:101], demos[0].stiffness)
    assert two().stacked().stiffness is None


# -- refused


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"x": [], "dt": 1}, ["x has to be at least one array (T, D), got none"]),
        ({"x": [[[0, 0]]], "dt": 1}, ["demonstration 0 has to have at least two samples, got 1", "leave it out"]),
        (
            {"x": [np.zeros((5, 2)), np.zeros((0, 2))], "dt": 1},
            ["demonstration 1 has to have at least two samples, got 0"],
        ),
        ({"x": np.zeros((5, 2)), "dt": 1}, ["x of demonstration 0 has to be (T, D)", "got shape (2,)", "[x]"]),
        ({"x": [np.zeros((5, 0))], "dt": 1}, ["shape (5, 0)"]),
        (
            {"x": [np.zeros((5, 2)), np.zeros((5, 3))], "dt": 1},
            ["demonstration 1 has to have the 2 columns of demonstration 0, got 3"],
        ),
        (
            {"x": [[[0, 1], [2]]], "dt": 1},
            ["x of demonstration 0 has to be an array of real numbers", "got [[0, 1], [2]]"],
        ),
        ({"x": [[["a"], ["b"]]], "dt": 1}, ["has to be an array of real numbers", "got [['a'], ['b']]"]),
        (
            {"x": [torch.zeros(5, 2, dtype=torch.complex64)], "dt": 1},
            ["has to be an array of real numbers", "got tensor(["],
        ),
        ({"x": [np.zeros((5, 2))]}, ["dt has to be the time step in seconds, got none", "pass dt="]),
        (
            {"x": [np.zeros((5, 2))], "v": [np.zeros((4, 2))], "dt": 1},
            ["demonstration 0: v has to have the 5 rows of x, got shape (4, 2)"],
        ),
        (
            {"x": [np.zeros((5, 2))], "v": [np.zeros((5, 1))], "dt": 1},
            ["v has to have the shape (5, 2) of x, got (5, 1)", "leave v out"],
        ),
        (
            {"x": [np.zeros((5, 2))] * 2, "v": [np.zeros((5, 2))], "dt": 1},
            ["v has to be one array for each of the 2 demonstrations, got 1"],
        ),
        (
            {"x": [np.zeros((5, 2))], "stiffness": [np.zeros((4, 2))], "dt": 1},
            ["stiffness has to have the 5 rows of x, got shape (4, 2)"],
        ),
    ],
)
def test_unusable_data_are_refused(arguments, words):
    with refuses(InvalidDemonstrationsError, *words):
        Demonstrations(**arguments)


@pytest.mark.parametrize("dt", [0, -0.1, float("nan"), float("inf"), [0.1, 0]])
def test_bad_time_steps_are_refused(dt):
    with refuses(InvalidDemonstrationsError, "dt of demonstration", "positive and finite"):
        Demonstrations([np.zeros((3, 1))] * 2, dt=dt)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"dt": [1, 1, 1]}, ["dt has to be one value for all or one for each of the 2 demonstrations, got 3"]),
        ({"dt": "fast"}, ["dt has to be a number [s]", "got 'fast'"]),
        ({"names": ["a"]}, ["names has to be one for each of the 2 dimensions, got ('a',)"]),
        ({"names": ["a", "a"]}, ["a different one for each dimension, got ('a', 'a')"]),
        ({"units": ["m"]}, ["units has to be one for each of the 2 dimensions, got ('m',)"]),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, words):
    with refuses(InvalidArgumentError, *words):
        Demonstrations([np.zeros((3, 2))] * 2, **({"dt": 1} | arguments))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_values_that_are_not_finite_are_found(value):
    good, bad = np.zeros((5, 2)), np.zeros((5, 2))
    bad[3, 1] = value
    where = "demonstration 1, row 3 (counted from 0), column '"
    with refuses(InvalidDemonstrationsError, where + f"b': all values have to be finite, got {value}"):
        Demonstrations([good, bad], dt=1, names="ab")
    with refuses(InvalidDemonstrationsError, where + "velocity of x2'"):
        Demonstrations([good, good], [good, bad], dt=1)
    with refuses(InvalidDemonstrationsError, where + "stiffness 1'"):
        Demonstrations([good, good], stiffness=[good, bad], dt=1)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda d: d[2:], ["at least one of the 2 demonstrations, got slice(2, None, None)"]),
        (lambda d: d.save_npz("demos.txt"), ["path has to end in .npz, got demos.txt", "demos.npz"]),
    ],
)
def test_methods_refuse_bad_arguments(call, words):
    with refuses(InvalidArgumentError, *words):
        call(two())
