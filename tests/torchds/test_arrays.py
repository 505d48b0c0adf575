"""What users may give as arrays, against what numpy makes of it, and what is refused."""

import numpy as np
import pytest
import torch

from tests.motions import refuses
from torchds import arrays
from torchds.errors import FileError, InvalidArgumentError, InvalidDemonstrationsError


@pytest.mark.parametrize(
    ("value", "dtype"),
    [
        ([[1, 2], [3, 4]], torch.float64),
        (((1.5, 2.5),), torch.float64),
        (np.arange(6).reshape(3, 2), torch.float64),
        (np.arange(6, dtype=np.float32).reshape(3, 2), torch.float32),
        (np.ones((2, 2), dtype=np.float16), torch.float64),
        (np.array([[True, False]]), torch.float64),
        (np.asfortranarray(np.random.default_rng(0).normal(size=(4, 3)))[::-1], torch.float64),
        (torch.ones(2, 2, dtype=torch.float32), torch.float32),
        (torch.ones(2, 2, dtype=torch.bfloat16), torch.float64),
        (torch.ones(2, 2, dtype=torch.int32), torch.float64),
    ],
)
def test_numbers_in_any_form_become_a_tensor_of_the_same_values(value, dtype):
    made = arrays.tensor("x", value)
    assert made.dtype == dtype
    assert np.array_equal(made.numpy(), np.asarray(value.float() if isinstance(value, torch.Tensor) else value))


@pytest.mark.parametrize("value", [np.ones((3, 2)), torch.ones(3, 2, requires_grad=True)])
def test_a_tensor_is_a_copy_without_a_graph(value):
    made = arrays.tensor("x", value)
    made += 1
    assert not made.requires_grad and np.array_equal(torch.as_tensor(value).detach().numpy(), np.ones((3, 2)))


@pytest.mark.parametrize(
    "value", ["abc", None, [[1, 2], [3]], [["a"]], np.array([1j]), torch.ones(2, dtype=torch.complex64), object()]
)
def test_what_is_no_array_of_numbers_is_refused(value):
    with refuses(InvalidDemonstrationsError, "x has to be an array of real numbers with rows of equal length, got"):
        arrays.tensor("x", value)


def test_arrays_of_several_demonstrations_share_their_widest_type():
    made = arrays.tensors("x", [np.ones((3, 2), dtype=np.float32), np.zeros((5, 2))])
    assert [part.dtype for part in made] == [torch.float64] * 2 and [len(part) for part in made] == [3, 5]
    assert arrays.tensors("x", np.ones((3, 2, 1), dtype=np.float32))[2].dtype == torch.float32
    for value, words in (
        ([], ["x has to be at least one array (T, D), got none"]),
        ([[1.0, 2.0]], ["x of demonstration 0 has to be (T, D)", "got shape (2,)", "passed in a list, [x]"]),
        ([np.ones((3, 0))], ["got shape (3, 0)"]),
        ([np.ones((3, 2)), np.ones((3, 1))], ["demonstration 1 has to have the 2 columns of demonstration 0, got 1"]),
    ):
        with refuses(InvalidDemonstrationsError, *words):
            arrays.tensors("x", value)


def test_what_belongs_to_positions_has_their_rows_and_type():
    positions = arrays.tensors("x", [np.ones((3, 2)), np.ones((4, 2))])
    made = arrays.matching("v", [np.zeros((3, 1), dtype=np.float32), np.zeros((4, 1), dtype=np.float32)], positions)
    assert all(part.dtype == torch.float64 for part in made)
    with refuses(InvalidDemonstrationsError, "v has to be one array for each of the 2 demonstrations, got 1"):
        arrays.matching("v", [np.zeros((3, 2))], positions)
    with refuses(InvalidDemonstrationsError, "demonstration 1: v has to have the 4 rows of x, got shape (3, 2)"):
        arrays.matching("v", [np.zeros((3, 2)), np.zeros((3, 2))], positions)


def test_labels_are_one_for_each_dimension_and_names_differ():
    arrays.check_labels(2, ("a", "b"), ("m", "m"))
    for names, units, words in (
        ("a", ("m", "m"), "names has to be one for each of the 2 dimensions"),
        ("ab", ("m",), "units has to be one for each of the 2 dimensions"),
        ("aa", ("m", "m"), "names has to be a different one for each dimension, got aa"),
    ):
        with refuses(InvalidArgumentError, words):
            arrays.check_labels(2, names, units)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_the_first_value_that_is_not_finite_is_named(value):
    good, bad = torch.zeros(4, 2), torch.zeros(4, 2)
    arrays.check_finite([good, good], "ab")
    bad[2, 1] = bad[3, 0] = value
    with refuses(InvalidDemonstrationsError, "demonstration 1, row 2", "column 'b'", f"got {value}; remove the row"):
        arrays.check_finite([good, bad], "ab")


def test_counts_and_sizes():
    for value in (2, 3, np.int64(2), torch.tensor(2)):
        arrays.check_count("n", value, 2)
    for value in (1, 2.0, "2", None, np.float64(2)):
        with refuses(InvalidArgumentError, f"n has to be an integer of at least 2, got {value!r}"):
            arrays.check_count("n", value, 2)
    arrays.check_positive("dt", 1e-300)
    for value in (0, -1.0, float("nan"), float("inf")):
        with refuses(InvalidArgumentError, f"dt has to be positive and finite, got {value!r}"):
            arrays.check_positive("dt", value)


def test_a_vector_may_be_one_number():
    assert arrays.vector("goal", 3).tolist() == [3.0] and arrays.vector("goal", [1, 2]).tolist() == [1.0, 2.0]
    for value in ([[1.0]], [], [1.0, float("nan")]):
        with refuses(InvalidArgumentError, "goal has to be one row of finite numbers, got"):
            arrays.vector("goal", value)


def test_one_number_for_all_or_one_for_each():
    assert arrays.per_demonstration("dt", 0.5, 3) == [0.5] * 3
    assert arrays.per_demonstration("dt", [1, 2, 3], 3) == arrays.per_demonstration("dt", np.array([[1, 2, 3]]), 3)
    with refuses(FileError, "dt has to be one value for all or one for each of the 3 demonstrations, got 2 values"):
        arrays.per_demonstration("dt", [1, 2], 3, FileError)
    with refuses(InvalidArgumentError, "dt has to be a number [s], or one for each demonstration, got 'fast'"):
        arrays.per_demonstration("dt", "fast", 3)


@pytest.mark.parametrize(
    "shapes",
    [((),), ((5, 1), (3,)), ((), (2, 0), (1, 1)), ((4, 1, 3), (2, 1)), ((2,), (3,)), ((0,), (2,)), ((1, 2), (3, 4))],
)
def test_shapes_broadcast_as_those_of_torch(shapes):
    try:
        expected = tuple(torch.broadcast_shapes(*shapes))
    except RuntimeError:
        with pytest.raises(RuntimeError, match="do not broadcast"):
            arrays.broadcast_shape(*shapes)
    else:
        assert arrays.broadcast_shape(*shapes) == expected
