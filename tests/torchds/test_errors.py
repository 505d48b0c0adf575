"""Each error is one of this library's and one of Python's; messages name what is near and what to install."""

import inspect

import pytest

from torchds import errors

KINDS = [kind for _, kind in inspect.getmembers(errors, inspect.isclass) if issubclass(kind, Exception)]


@pytest.mark.parametrize("kind", [kind for kind in KINDS if not issubclass(kind, Warning)])
def test_every_error_is_caught_by_the_root_and_by_what_python_calls_it(kind):
    assert issubclass(kind, errors.TorchdsError)
    assert kind is errors.TorchdsError or issubclass(kind, (ValueError, RuntimeError, ImportError))


@pytest.mark.parametrize(
    ("received", "hint"),
    [
        ("cosy", " Did you mean 'cozy'?"),
        ("COZY", " Did you mean 'cozy'?"),
        ("Warm", " Did you mean 'warm'?"),
        ("x", ""),
    ],
)
def test_an_unknown_name_is_told_the_nearest_and_all(received, hint):
    error = errors.UnknownNameError("room", received, ["warm", "cozy"])
    assert str(error) == f"unknown room {received!r}.{hint} Known: cozy, warm."


def test_several_near_names_are_all_told():
    assert "Did you mean 'pi2' or 'pi2cma'" in str(
        errors.UnknownNameError("optimizer", "pi2c", ["pi2", "pi2cma", "adam"])
    )


def test_a_missing_package_names_its_extra_and_can_be_caught_as_an_import_error():
    with pytest.raises(ImportError, match=r"drawing needs the package 'matplotlib'\. .* pip install 'torchds\[plot\]'"):
        raise errors.MissingPackageError("matplotlib", "plot", "drawing")
