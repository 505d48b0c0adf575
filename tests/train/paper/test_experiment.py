"""`python -m train digging` with a tiny experiment: all is made, and the next call finds it; kills are in tests/faults."""

import pytest

from torchds.errors import InvalidArgumentError
from train.folder import RESULTS
from train.learning import run
from train.paper.experiment import Digging
from train.paper.measured import digging


@pytest.mark.parametrize(("name", "low"), [("runs", 1), ("updates", 0), ("rollouts", 1)])
def test_numbers_out_of_range_are_refused(name, low):
    with pytest.raises(InvalidArgumentError, match=f"--{name} has to be at least {low}, got {low - 1}"):
        Digging(**{name: low - 1}).main()


@pytest.mark.slow
def test_a_tiny_experiment_is_made_once(tmp_path, monkeypatch, capsys):
    pytest.importorskip("mujoco")
    pytest.importorskip("pytorch_kinematics")
    from tasks.digging.task import LwrDigging

    monkeypatch.setattr(digging, "STARTS", (150.0,))
    monkeypatch.setattr(digging, "SEARCHES", {digging.PAPER: digging.SEARCHES[digging.PAPER]})
    monkeypatch.setattr(digging, "UNIFORM", (150.0,))
    monkeypatch.setattr(digging, "TRIALS", 2)
    monkeypatch.setattr(LwrDigging, "film", lambda task, path, frames: None)
    monkeypatch.setattr(run.figures, "of_run", lambda learner: {})
    fitted, fit = [], LwrDigging.fit  # once, it takes longer than all the rest
    monkeypatch.setattr(
        LwrDigging, "fit", lambda task, demos: fitted[0] if fitted else fitted.append(fit(task, demos)) or fitted[0]
    )
    tiny = Digging(runs=1, grains="coarse", seconds=0.6, updates=1, rollouts=2, logdir=tmp_path)
    tiny.main()
    experiment = digging.Experiment(tmp_path / "lwr_digging" / "experiment-0", 0, runs=1)
    assert experiment.run_folder(digging.PAPER, 150.0).has(RESULTS)
    first = capsys.readouterr().out
    monkeypatch.setattr(digging.Experiment, "measure", lambda *_: pytest.fail("measured again"))
    tiny.threads = 1
    tiny.main()
    assert "2 of 2 policies are" in first and "0 of 2 policies are" in capsys.readouterr().out
