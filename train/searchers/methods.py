"""Other searchers on the same trials and the same budget: gradients, evolution strategies, trust regions."""

from train.searchers.coordinates import CoordinateSearch as CoordinateSearch
from train.searchers.coordinates import Method as Method
from train.searchers.coordinates import Setting as Setting
from train.searchers.descent import adam, finite_differences, nes, sgd
from train.searchers.libraries import cma, cobyqa, lbfgs

METHODS = {
    "adam": Method(adam, gradient=True, random=False),
    "sgd": Method(sgd, gradient=True, random=False),
    "lbfgs": Method(lbfgs, gradient=True, random=False),
    "finite_differences": Method(finite_differences, gradient=False, random=False),
    "nes": Method(nes, gradient=False, random=True),
    "cma": Method(cma, gradient=False, random=True),
    "cobyqa": Method(cobyqa, gradient=False, random=False),
}
"""By the names of `--optimizer`."""

__all__ = ["METHODS", "CoordinateSearch", "Method", "Setting"]
