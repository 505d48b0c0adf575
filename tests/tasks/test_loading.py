import sys
from pathlib import Path

import pytest
import torch

import tasks
from tasks.loading import absolute, is_problem, is_spec, load_object, short, told_apart
from torchds.errors import InvalidArgumentError, UnknownNameError
from torchds.optim import PIBB

FILE = """
import torch
from helper_of_mine import SIZE
from tasks import Task, ViaPoint
from torchds.optim import PIBB

class Mine(PIBB):
    size = SIZE

class Half(Task):
    def default_demonstrations(self): ...

class Letter(ViaPoint):
    pass

number = 3
"""


@pytest.fixture
def file(tmp_path):
    (tmp_path / "my_file.py").write_text(FILE)
    (tmp_path / "helper_of_mine.py").write_text("SIZE = 5")
    return tmp_path / "my_file.py"


def test_a_class_of_a_file_is_the_same_each_time_and_sees_the_files_beside_it(file, monkeypatch):
    mine = load_object(f"{file}:Mine", PIBB)
    assert issubclass(mine, PIBB) and mine.size == 5
    monkeypatch.chdir(file.parent)
    assert load_object("my_file.py:Mine", PIBB) is mine
    assert absolute("my_file.py:Mine") == f"{file}:Mine"


def test_a_class_of_a_module_is_found():
    assert load_object("torchds.optim:PIBB", torch.optim.Optimizer) is PIBB
    assert absolute("torchds.optim:PIBB") == "torchds.optim:PIBB"


def test_names_and_places_are_told_apart():
    assert is_spec("a.py:B") and is_spec("a.b:C") and is_spec("a.json") and not is_spec("pibb")
    assert is_problem("a.json") and not is_problem("a.py:B")
    assert short("a/b.py:C") == "C" and short("pibb") == "pibb" and absolute("pibb") == "pibb"
    assert short("a/b c-D.json") == "b_c_d" and short("/ä.json") == "ä" and short("--.json") == "problem"
    assert absolute("a/b.json") == str(Path("a/b.json").resolve())


@pytest.mark.parametrize(
    ("spec", "base", "error", "words"),
    [
        ("{}:Mime", PIBB, UnknownNameError, r"unknown PIBB in .*'Mime'. Did you mean 'Mine'\? Known: Mine\."),
        ("{}:number", PIBB, InvalidArgumentError, "has to be a subclass of torchds.optim.pibb.PIBB, got 3"),
        ("{}:Mine", tasks.Task, InvalidArgumentError, "has to be a subclass of tasks.base.Task"),
        ("{}:Half", tasks.Task, InvalidArgumentError, "is not complete: it has to define cost_terms"),
        ("{}x.py:Mine", PIBB, InvalidArgumentError, r"no file .*my_file.pyx.py"),
        ("no.such.module:Mine", PIBB, InvalidArgumentError, "module no.such.module cannot be imported"),
        ("{}:", PIBB, InvalidArgumentError, "has to be FILE.py:NAME"),
    ],
)
def test_what_cannot_be_loaded_is_explained(file, spec, base, error, words):
    with pytest.raises(error, match=words):
        load_object(spec.format(file), base)


def test_an_error_in_the_file_is_named_and_the_file_is_read_again(tmp_path):
    file = tmp_path / "broken.py"
    file.write_text("from torchds.optim import PIBB\n1 / 0")
    with pytest.raises(InvalidArgumentError, match=r"broken.py cannot be imported: ZeroDivisionError"):
        load_object(f"{file}:PIBB", PIBB)
    file.write_text("from torchds.optim import PIBB")
    assert load_object(f"{file}:PIBB", PIBB) is PIBB


def test_each_file_has_what_stands_beside_it_or_is_refused(tmp_path, monkeypatch):
    for name, modules in {
        "a": ("shared_one", "unused_one"),
        "b": ("unused_one",),
        "c": ("through_one", "shared_one"),
    }.items():
        (tmp_path / name).mkdir()
        for module in modules:
            text = "from shared_one import SIZE" if module == "through_one" else f"SIZE = {name!r}"
            (tmp_path / name / f"{module}.py").write_text(text)
        last = modules[0]
        (tmp_path / name / "opt.py").write_text(
            f"from {last} import SIZE\nfrom torchds.optim import PIBB\nclass W(PIBB): size = SIZE"
        )
    before = list(sys.path)
    assert [load_object(f"{tmp_path}/{name}/opt.py:W", PIBB).size for name in "ab"] == ["a", "b"]
    assert sys.path == [*before, f"{tmp_path}/a", f"{tmp_path}/b"]
    with pytest.raises(
        InvalidArgumentError, match=r"shared_one is known from .*a.shared_one\.py, so .*; rename one of them"
    ):
        load_object(f"{tmp_path}/c/opt.py:W", PIBB)
    monkeypatch.setattr(sys, "path", before)


def test_a_task_of_a_file_is_made_with_the_options_of_its_base(file):
    assert tasks.make(f"{file}:Letter", shape="P").start.tolist() == [-4.8, -4.9]
    assert tasks.make(f"{file}:Letter").name == "letter"


def test_what_has_one_short_name_is_shown_by_its_whole_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = told_apart(
        ["a/opt.py:W", f"{tmp_path}/a/opt.py:W", "b/opt.py:W", "c.d:V", "old/p.json", "new/p.json", "cma"]
    )
    assert names == {
        "a/opt.py:W": f"{tmp_path}/a/opt.py:W",
        f"{tmp_path}/a/opt.py:W": f"{tmp_path}/a/opt.py:W",
        "b/opt.py:W": f"{tmp_path}/b/opt.py:W",
        "c.d:V": "V",
        "old/p.json": f"{tmp_path}/old/p.json",
        "new/p.json": f"{tmp_path}/new/p.json",
        "cma": "cma",
    }
    assert told_apart(["a/opt.py:W", f"{tmp_path}/a/opt.py:W"]) == {"a/opt.py:W": "W", f"{tmp_path}/a/opt.py:W": "W"}
