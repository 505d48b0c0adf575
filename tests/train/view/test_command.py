"""python -m train view: refuses early, and plays the snapshots of a trial at their pace until the window is closed."""

import json
from types import SimpleNamespace

import pytest
import torch

from tests.motions import Short
from torchds.errors import InvalidArgumentError, MissingPackageError
from train.folder import RunFolder
from train.options import options_for
from train.view import command as view
from train.view.command import NoDisplayError, View


@pytest.fixture
def folder(tmp_path):
    """The folder of a finished run that never was."""
    (tmp_path / "policy.pt").touch()
    options = options_for("lwr_digging", runs=2, seconds=3.0)
    (tmp_path / "options.json").write_text(json.dumps({"task": "lwr_digging", "options": options.to_json()}))
    return tmp_path


def test_the_options_are_those_of_the_run(folder):
    assert View("lwr_digging", folder, run=1).options(folder).seconds == 3.0


@pytest.mark.parametrize("name", ["policy.pt", "options.json"])
def test_a_folder_without_a_finished_run_is_refused(folder, name):
    (folder / name).unlink()
    with pytest.raises(InvalidArgumentError, match=f"no {name} there; give the folder of a finished run"):
        View("lwr_digging", folder).main()


def test_which_finished_runs_leave_no_policy_is_said(folder):
    (folder / "policy.pt").unlink()
    (folder / "results.json").touch()
    with pytest.raises(
        InvalidArgumentError, match=r"no policy\.pt there, which runs of primitives \(--system dmp\), of"
    ):
        View("lwr_digging", folder).main()


@pytest.mark.parametrize("run", [-1, 2])
def test_a_policy_that_the_run_does_not_have_is_refused(folder, run):
    with pytest.raises(InvalidArgumentError, match=f"with 2 policies; needed is one .* that has policy {run}"):
        View("lwr_digging", folder, run=run).main()


def test_a_run_of_another_task_is_refused(folder):
    options = options_for("via_point", runs=2)
    (folder / "options.json").write_text(json.dumps({"task": "via_point", "options": options.to_json()}))
    with pytest.raises(InvalidArgumentError, match="a run of 'via_point' with 2 policies"):
        View("lwr_digging", folder).main()


def test_without_a_screen_it_says_where_the_film_is(folder, monkeypatch):
    monkeypatch.setattr(view.sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NoDisplayError, match=r"neither DISPLAY nor WAYLAND_DISPLAY is set.*film\.gif"):
        View("lwr_digging", folder).main()


@pytest.mark.slow
def test_the_snapshots_are_played_in_order_until_the_window_is_closed(monkeypatch):
    mujoco = pytest.importorskip("mujoco")
    import mujoco.viewer  # noqa: F811

    from tasks.digging.rendering import picture_model
    from tasks.digging.task import BEDS

    shown = []

    class Window:
        """Is closed after 70 pictures."""

        def __init__(self, model, data, **_):
            self.data = data

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return None

        def is_running(self):
            return len(shown) < 70

        def sync(self):
            shown.append(float(self.data.qpos[0]))

    monkeypatch.setattr(mujoco.viewer, "launch_passive", Window)
    monkeypatch.setattr(view.time, "sleep", lambda seconds: None)
    n = picture_model(BEDS["coarse"]).nq
    snapshots = torch.zeros(3, n, dtype=torch.float64)
    snapshots[:, 0] = torch.tensor([0.0, 1.0, 3.0])
    view.show(BEDS["coarse"], SimpleNamespace(plant=SimpleNamespace(snapshots=snapshots)))
    assert len(shown) == 70
    again = shown.index(0.0, 1)  # the trial begins again
    trial = shown[:again]
    assert trial == sorted(trial) and 1.0 in trial and max(trial) < 3.0
    assert shown[again : 2 * again] == trial[: 70 - again]


def test_a_window_is_for_a_learned_digging_motion_alone(folder):
    for refused in (View("lwr_digging"), View("via_point", folder)):
        with pytest.raises(
            InvalidArgumentError, match="a window needs the task lwr_digging and --policy; with --browser a page"
        ):
            refused.main()
    with pytest.raises(InvalidArgumentError, match="--trials has to be at least 1, got 0"):
        View("lwr_digging", trials=0).main()


@pytest.mark.slow
def test_the_page_of_any_task_has_the_policy_before_learning(monkeypatch):
    made = []
    monkeypatch.setattr(view, "Page", lambda title, takes, **options: made.append((title, takes, options)))
    View("via_point", browser=1, port=1234).page()
    ((title, takes, options),) = made
    assert title == "via_point" and options == {"port": 1234}
    assert {take.policy for take in takes} == {"before learning"}


def test_the_page_needs_no_gpu_where_the_run_had_one(monkeypatch, tmp_path):
    policy = Short().policy()
    options = options_for("tests.motions:Short", device="cuda")
    RunFolder(tmp_path).begin(options.task, options.to_json())
    policy.expand(1).save(tmp_path / "policy.pt")
    monkeypatch.setattr(view, "Page", lambda title, takes, port: [take.policy for take in takes])
    assert View(options.task, tmp_path, browser=1).page() == ["before learning", "after learning"]


def test_a_page_without_its_package_says_which_extra_brings_it(monkeypatch):
    from train.view import page

    monkeypatch.setattr(page.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(MissingPackageError, match=r"torchds\[view\]"):
        page.Page("nothing", [])
