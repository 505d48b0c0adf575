"""The shared options: declared once, known by all searches, and strangers refused."""

import inspect
import re
from typing import get_type_hints

import pytest
import torch
from torch import nn

from torchds.errors import UnknownNameError
from torchds.exploration import Gaussian
from torchds.optim import PI2, PI2CMA, PIBB, SurrogatePIBB
from torchds.optim.options import DEFAULTS, SharedOptions

SEARCHES = [PIBB, PI2, PI2CMA, SurrogatePIBB]
OTHERS = {
    "eliteness": 3.0,
    "temperature": "median",
    "control_weight": 0.2,
    "control_reference": "zero",
    "elite": "nominal",
    "batched": False,
    "generator": torch.Generator().manual_seed(7),
}


def make(search, **options):
    return search([nn.Parameter(torch.zeros(2))], Gaussian(0.1), **options)


def read(optim, name):
    return optim.param_groups[0][name] if name in optim.param_groups[0] else getattr(optim, name)


def test_every_shared_option_has_a_default_and_a_line_of_help():
    names = set(get_type_hints(SharedOptions))
    assert names == set(DEFAULTS) == set(OTHERS)
    described = re.findall(r"^        (\w+):", SharedOptions.__doc__, re.M)
    assert set(described) == names
    assert len(described) == len(names)


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize("name", OTHERS)
def test_every_search_takes_every_shared_option(search, name):
    assert read(make(search, **{name: OTHERS[name]}), name) == OTHERS[name]
    if name != "generator":
        assert read(make(search), name) == search.shared_defaults[name]


@pytest.mark.parametrize("search", SEARCHES)
def test_the_defaults_differ_only_where_a_search_says_so(search):
    differing = {name: value for name, value in search.shared_defaults.items() if value != DEFAULTS[name]}
    assert differing == ({"temperature": "capped", "elite": "nominal"} if search is SurrogatePIBB else {})


@pytest.mark.parametrize("search", SEARCHES)
def test_help_tells_all_options_and_their_defaults(search):
    text = inspect.getdoc(search)
    own = [p.name for p in inspect.signature(search).parameters.values() if p.kind is not p.VAR_KEYWORD]
    for name in [*own, *DEFAULTS]:
        assert len(re.findall(rf"^ +{name}: ", text, re.M)) == 1, name
    assert f"temperature={search.shared_defaults['temperature']!r}" in text


@pytest.mark.parametrize("search", SEARCHES)
@pytest.mark.parametrize(
    ("stranger", "hint"),
    [
        ("elitness", "Did you mean 'eliteness'"),
        ("n_rolouts", "Did you mean 'n_rollouts'"),
        ("control_wieght", "Did you mean 'control_weight'"),
        ("xyz", r"Known: batched, "),
    ],
)
def test_an_unknown_option_is_refused_with_those_that_there_are(search, stranger, hint):
    with pytest.raises(UnknownNameError, match=f"unknown option of {search.__name__} '{stranger}'.*{hint}") as caught:
        make(search, **{stranger: 1.0})
    for name in [*DEFAULTS, "lr", "exploration"]:
        assert name in str(caught.value)


def test_the_own_options_of_a_search_are_among_those_that_it_names():
    with pytest.raises(UnknownNameError, match="Did you mean 'n_candidates'"):
        make(SurrogatePIBB, candidates=5)
    with pytest.raises(UnknownNameError) as caught:
        make(PIBB, candidates=5)
    assert "n_candidates" not in str(caught.value)
