import numpy as np
import pytest
import torch

import torchds
from torchds.errors import InvalidArgumentError
from torchds.monitor import of_costs, of_search


def test_costs_are_medians_with_quartiles_of_their_sum():
    goal, control = torch.tensor([1.0, 2.0, 3.0, 10.0]), torch.tensor([0.0, 4.0, 0.0, 0.0])
    q1, median, q3 = np.percentile([1.0, 6.0, 3.0, 10.0], [25, 50, 75])
    assert of_costs({"goal": goal, "control": control}) == {
        "cost/total": median,
        "cost/total_q1": q1,
        "cost/total_q3": q3,
        "cost/goal": 2.5,
        "cost/control": 0.0,
    }


def test_a_run_that_failed_is_worse_than_all_others():
    seen = of_costs({"goal": [1.0, float("nan"), 3.0, 2.0, 4.0], "control": [0.5] * 5})
    assert [seen[f"cost/{name}"] for name in ("total_q1", "total", "total_q3", "goal")] == [2.5, 3.5, 4.5, 3.0]
    assert of_costs({"goal": [1.0, float("nan"), float("inf")]})["cost/total"] == float("inf")


def test_a_sum_beside_its_terms_is_refused():
    with pytest.raises(
        InvalidArgumentError, match="without 'total', which is their sum, got goal, total; leave it out"
    ):
        of_costs({"goal": [1.0], "total": [1.0]})


def test_one_policy_has_no_width():
    assert of_costs({"goal": torch.tensor(3.0)}) == {
        **dict.fromkeys(("cost/total", "cost/total_q1", "cost/total_q3"), 3.0),
        "cost/goal": 3.0,
    }


def test_a_search_tells_what_it_tried_and_how_much_of_it_failed():
    theta = torch.nn.Parameter(torch.zeros(1, dtype=torch.float64))
    optim = torchds.optim.PIBB([theta], torchds.exploration.Gaussian(0.1), n_rollouts=5)
    assert of_search(optim) == optim.scalars()
    optim.step(lambda: torch.tensor([4.0, float("nan"), 1.0, 2.0, 3.0], dtype=torch.float64))
    seen = of_search(optim)
    assert (seen["cost/tried_q1"], seen["cost/tried"], seen["cost/tried_q3"]) == (1.75, 2.5, 3.25)
    assert seen["rollouts/failed"] == 1 and seen.keys() >= optim.scalars().keys()


def test_other_optimizers_have_a_rate():
    assert of_search(torch.optim.SGD([torch.nn.Parameter(torch.zeros(1))], lr=0.25)) == {"exploration/lr": 0.25}


@pytest.mark.parametrize("made", [list, np.array, torch.tensor])
def test_costs_may_be_lists_arrays_or_tensors(made):
    assert of_costs({"goal": made([1.0, 3.0])})["cost/total"] == 2.0
