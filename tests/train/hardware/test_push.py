"""python -m train push: what the three executions make of one push."""

import pytest
import torch

from torchds import GMRPolicy
from train.hardware import push
from train.hardware.push import Push, pushed, rows


@pytest.fixture
def policy():
    eye = torch.eye(2, dtype=torch.float64)[None]
    return GMRPolicy(torch.ones(1), torch.zeros(1, 2), 400 * eye, -0.5 * eye, torch.zeros(1, 2))


@pytest.mark.slow
def test_the_open_loop_returns_to_the_motion_and_the_others_go_on_from_where_they_are(policy, monkeypatch):
    monkeypatch.setattr(push, "DT", 0.02)
    paths = pushed(policy, torch.tensor([-20.0, 10.0], dtype=torch.float64))
    away = {name: (after, end) for name, after, end in rows(paths)}
    assert set(away) == {"open loop", "closed loop", "passive"}
    assert all(after > 1.0 and end < 0.1 for after, end in away.values())
    settled = round((push.END + 1.5) / 0.02)  # a second and a half later only the open loop is back
    planned = paths["open loop"].reference[settled]
    assert float((paths["open loop"].x[settled] - planned).norm()) < 0.2
    assert all(float((paths[name].x[settled] - planned).norm()) > 1.0 for name in ("closed loop", "passive"))


@pytest.mark.slow
def test_the_command_draws_and_prints(tmp_path, capsys, monkeypatch, policy):
    monkeypatch.setattr(push, "SECONDS", 3.0)
    monkeypatch.setattr(push, "fit_stable", lambda demos, n_components: type("Fit", (), {"policy": policy}))
    Push(path=tmp_path / "a" / "push.png").main()
    assert (tmp_path / "a" / "push.png").stat().st_size > 10_000
    assert capsys.readouterr().out.splitlines()[0].startswith("execution    away from the motion after the push")
