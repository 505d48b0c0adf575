"""The arguments that all readers share."""

import pytest

from tests.motions import refuses
from tests.recorded import MOTION, STEP, TIMES, X, table
from torchds import load
from torchds.errors import InvalidArgumentError, UnknownNameError


def test_arguments_that_there_are_not_are_refused(file, mat):
    path = file(table("time,x,y", TIMES, *X.T))
    with refuses(UnknownNameError, "argument of this reader 'time_column'", "Known: ", "time"):
        load(path, time_column="time")
    with refuses(UnknownNameError, "argument of this reader 'variable'"):
        load(path, variable="x")
    for options in ({"resample": "yes"}, {"resample": -1.0}, {"duplicates": "keep"}):
        with pytest.raises(InvalidArgumentError, match=next(iter(options))):
            load(path, **options)
    with refuses(InvalidArgumentError, "time_axis has to be", "got 5"):
        load(mat(x=MOTION, dt=STEP), time_axis=5)
