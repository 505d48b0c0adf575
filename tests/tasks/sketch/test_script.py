import os
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from tasks.sketch import Problem
from tasks.sketch.script import CHECKOUT, script
from tests.tasks.sketch.drawn import FULL
from torchds import load_policy
from torchds.errors import FileError, InvalidArgumentError
from train.learning.learner import Learner
from train.options import options_for


@pytest.mark.slow
def test_the_script_gives_bit_for_bit_the_policy_of_the_learner(tmp_path):
    replace(FULL, body=None).write(tmp_path / "Full.json")
    (tmp_path / "it.py").write_text(script(tmp_path / "Full.json", {"runs": 2, "seed": 5}))
    (tmp_path / "elsewhere").mkdir()
    command = [sys.executable, "-W", "error", str(tmp_path / "it.py")]
    ran = subprocess.run(
        command, cwd=tmp_path / "elsewhere", capture_output=True, text=True, env={**os.environ, "PYTHONPATH": ""}
    )
    assert ran.returncode == 0, ran.stderr
    learner = Learner(options_for(str(tmp_path / "Full.json"), runs=2, seed=5)).learn()
    saved = load_policy(tmp_path / "elsewhere" / "full.pt")
    assert saved.batch_shape == (2,) and saved.info.units == "m" and learner.done == 3
    for name, value in learner.policy.state_dict().items():
        assert torch.equal(saved.state_dict()[name], value), name
    assert "update 3 of 3: median cost" in ran.stdout and "via_points" in ran.stdout


@pytest.mark.slow
def test_a_script_makes_one_run_where_nothing_is_random(tmp_path, monkeypatch):
    replace(FULL, body=None, learners=[{"optimizer": "finite_differences", "runs": 3, "updates": 0}]).write(
        tmp_path / "a.json"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    exec(compile(script("a.json"), "it.py", "exec"), {})
    assert load_policy(tmp_path / "a.pt").batch_shape == (1,)


@pytest.mark.parametrize("condition", ["none", "seds"])
@pytest.mark.parametrize("body", [None, {}])
def test_a_script_explains_what_its_problem_has(condition, body, tmp_path):
    replace(FULL, condition=condition, body=body).write(tmp_path / "a.json")
    text = script(tmp_path / "a.json")
    compile(text, "it.py", "exec")
    assert ("certificate" in text) == (condition == "seds") and ("policy.stiffness" in text) == (body is not None)
    assert str(CHECKOUT) in text and "options_for('" in text


@pytest.mark.parametrize("name", ['"""\'; import os #', "{name} {0}", "\\"])
def test_no_name_gets_out_of_its_comment(name, tmp_path):
    Problem(name=name).write(tmp_path / "a.json")
    text = script(tmp_path / "a.json")
    compile(text, "it.py", "exec")
    assert text.splitlines()[0] == f"# {name}: a drawn motion becomes a dynamical system, and learns by trial."


def test_what_cannot_be_written_down_is_refused(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        script(tmp_path / "a.json")
    Problem().write(tmp_path / "a.json")
    for options in ({"a b": 1}, {"logdir": tmp_path}):
        with pytest.raises(InvalidArgumentError, match="plain values by name"):
            script(tmp_path / "a.json", options)
