"""Quartiles against numpy's, and failed runs among them."""

import numpy as np

from torchds.quartiles import of_costs, quartiles


def test_quartiles_of_five_values_are_the_second_third_and_fourth(randn):
    assert quartiles([5.0, 1.0, 4.0, 2.0, 3.0]).tolist() == [2.0, 3.0, 4.0]
    table = randn(4, 7).numpy()
    by_row = quartiles(table, axis=1)
    assert by_row.shape == (3, 4)
    for row, found in zip(table, by_row.T, strict=True):
        np.testing.assert_allclose(found, np.percentile(row, [25, 50, 75]), rtol=1e-14)
    np.testing.assert_allclose(quartiles(table), np.percentile(table, [25, 50, 75]), rtol=1e-14)
    assert quartiles(table.tolist(), axis=0).shape == (3, 7)
    assert np.array_equal(of_costs(table), quartiles(table))


def test_infinite_values_and_failed_runs_are_the_largest():
    inf, nan = np.inf, np.nan
    assert quartiles([1.0, inf, 2.0, inf, inf]).tolist() == [2.0, inf, inf]
    assert np.isnan(quartiles([1.0, nan])).all()
    assert of_costs([1.0, nan, 2.0, -inf, 3.0]).tolist() == [2.0, 3.0, inf]
    assert of_costs([[1.0, nan], [1.0, 3.0]], axis=1)[1].tolist() == [inf, 2.0]
