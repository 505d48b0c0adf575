"""The reference of the site has every public name, and every page and figure is reached."""

import importlib
import inspect
import re
import types
from pathlib import Path

import pytest

import torchds
from tests.project.site import faults

DOCS = Path(__file__).parents[2] / "docs"


def own(module):
    """Public classes and functions that a module defines."""
    for name, value in vars(module).items():
        kind = inspect.isclass(value) or inspect.isfunction(value)
        if kind and not name.startswith("_") and value.__module__ == module.__name__:
            yield value


def documented():
    """What the directives of the pages name."""
    found = []
    for page in (DOCS / "reference").glob("*.md"):
        module = "torchds"
        for directive, name in re.findall(r"^\.\. (\w+):: (\S+)$", page.read_text(), re.M):
            if directive == "currentmodule":
                module = name
            elif directive == "automodule":
                found += own(importlib.import_module(name))
            else:
                found.append(getattr(importlib.import_module(module), name))
    return found


def public(name):
    """What a name of `torchds.__all__` stands for: a class, a function, or all that a module lists or else defines."""
    thing = getattr(torchds, name)
    if not isinstance(thing, types.ModuleType):
        return [thing]
    listed = [getattr(thing, name) for name in getattr(thing, "__all__", ())]
    return [*own(thing), *(value for value in listed if not isinstance(value, types.ModuleType))]


def test_every_public_name_is_there_once():
    pages = documented()
    names = [f"{thing.__module__}.{thing.__qualname__}" for thing in pages]
    assert len(set(names)) == len(names) > 150
    for name in torchds.__all__:
        for thing in public(name):
            assert thing in pages, (name, thing)


@pytest.mark.parametrize("page", sorted(DOCS.rglob("[a-z0-9]*.md")), ids=lambda page: str(page.relative_to(DOCS)))
def test_every_page_is_in_a_list_of_contents(page):
    if "_build" in page.parts or page == DOCS / "index.md":
        return
    for contents in DOCS.rglob("*.md"):
        for listing in re.findall(r"```\{toctree\}\n(.*?)```", contents.read_text(), re.DOTALL):
            for entry in listing.split():
                if (contents.parent / f"{entry}.md").resolve() == page.resolve():
                    return
    pytest.fail(f"{page} is in no toctree")


def test_links_that_lead_nowhere_are_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a id="x" href="b.html#there">b</a><a href="#x">here</a><a href="https://elsewhere">e</a>'
    )
    (tmp_path / "b.html").write_text('<p id="there"></p><a href="a.html">a</a>')
    assert not list(faults(tmp_path))
    (tmp_path / "c.html").write_text(
        '<a href="b.html#nowhere">b</a><img src="no.png"><script src="https://cdn/x.js"></script><a href="d.html">d</a>'
    )
    assert len(list(faults(tmp_path))) == 4
