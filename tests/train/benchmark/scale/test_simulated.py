"""Many simulated workers, against what is known of order statistics, and trials that are late or old."""

import sys

import numpy as np
import pytest
import torch

from tests.forked import forked
from tests.motions import Short
from torchds.errors import InvalidArgumentError, TorchdsError, UnknownNameError
from train.benchmark.programs import printed
from train.benchmark.scale import command, simulated
from train.benchmark.scale.command import SHARES, Scale, draw
from train.benchmark.scale.measured import CASES, Timing, learn
from train.benchmark.scale.simulated import Times, gather_seconds, lossy, stale, update_seconds
from train.learning.learner import Learner
from train.options import RunOptions, options_for


def rng():
    return np.random.default_rng(0)


def waits(times, workers, share, patience=1e9, updates=400):
    return update_seconds(times, workers, share, patience, updates, rng())


def test_roll_outs_that_all_take_as_long_are_waited_for_as_long():
    assert waits(Times(3.0, 0.0, 0.0), 50, 1.0) == pytest.approx(np.full(400, 3.0))


def test_half_of_many_workers_have_come_at_the_median():
    times = Times(2.0, 0.5, 0.0)
    assert waits(times, 2001, 0.5).mean() == pytest.approx(2.0 * np.exp(-0.125), rel=0.01)
    assert waits(times, 1, 1.0, updates=10_000).mean() == pytest.approx(2.0, rel=0.02)
    by_share = [waits(times, 100, share).mean() for share in (0.5, 0.9, 1.0)]
    assert by_share == sorted(by_share)


def test_failures_cost_patience_where_all_are_waited_for():
    times, n = Times(1.0, 0.0, 0.01), 100
    late = waits(times, n, 1.0, patience=60.0, updates=4000) == 60.0
    assert late.mean() == pytest.approx(1 - 0.99**n, abs=0.03)
    assert (waits(times, n, 0.9, patience=60.0) == 1.0).all()


def test_measured_times_give_their_mean_and_spread():
    times = Times.of(rng().lognormal(1.0, 0.3, 20_000), 0.2)
    assert times.mean == pytest.approx(np.exp(1.045), rel=0.01) and times.spread == pytest.approx(0.3, rel=0.02)
    drawn = times.draw((100_000,), rng())
    assert np.isinf(drawn).mean() == pytest.approx(0.2, abs=0.01)
    assert drawn[np.isfinite(drawn)].mean() == pytest.approx(times.mean, rel=0.01)


def test_a_ring_passes_everything_on():
    assert gather_seconds(1, 1e6, 1.0, 1.0) == 0.0
    assert gather_seconds(5, 1e6, 1e-4, 1e9) == pytest.approx(4 * (1e-4 + 1e-3))


@pytest.fixture(scope="module")
def task():
    return Short()


OPTIONS = {"runs": 2, "updates": 4, "rollouts": 6}


def costs(task, wrap=None):
    return Learner(options_for("via_point", **OPTIONS), task, wrap=wrap).learn().history.cost


@pytest.mark.slow
def test_all_in_time_and_no_age_change_nothing(task):
    plain = costs(task)
    assert costs(task, lossy(1.0, 0)) == plain
    assert costs(task, stale(0)) == plain
    assert costs(task, stale(1))[:2] == plain[:2] and costs(task, stale(1))[2:] != plain[2:]


def test_of_the_trials_a_share_comes_in_time():
    closure = lossy(0.5, 0)(lambda: torch.zeros(6, 1000, dtype=torch.float64), None)
    came = closure().isfinite()
    assert (came.sum(0) == 3).all()
    assert came.double().mean(1).sub(0.5).abs().max() < 0.06  # none more often than others


@pytest.mark.slow
def test_old_trials_are_around_old_parameters(task):
    tried, centers = [], []

    def wrap(closure, learner):
        def watched():
            noise = learner.searcher.optim.state[learner.policy.A]["noise"]
            tried.append(learner.policy.A.data - noise)
            return closure()

        def first():
            centers.append(learner.policy.A.data - learner.searcher.optim.state[learner.policy.A]["noise"])
            return old()

        old = stale(2)(watched, learner)
        return first

    costs(task, wrap)
    for update, center in enumerate(tried):
        torch.testing.assert_close(center, centers[max(update - 2, 0)], rtol=0, atol=1e-12)


def test_any_number_of_workers_is_drawn():
    learned = {
        f"by {what}": (x, {"pibb": [np.ones(2)] * len(x)}) for what, x in (("min_share", SHARES), ("age", (0, 1)))
    }
    figure = draw({("an hour", n): [1.0] * len(SHARES) for n in range(1, 9)}, learned)
    assert figure.axes[0].get_legend_handles_labels()[1][:8] == [f"{n} workers" for n in range(1, 9)]


@pytest.mark.slow
def test_the_simulation_leaves_tables_and_a_figure(task, monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(simulated, "made", lambda options: task)
    scale = Scale("simulate", workers=(2, 50), runs=2, updates=2, rollout=(1.0, 0.2), logdir=tmp_path)
    folder = scale.main()
    said = capsys.readouterr().out
    assert "| 50 | an hour |" in said and "Final cost on N, by updates old" in said
    assert (folder / "simulated.png").stat().st_size > 10_000
    assert (folder / "simulate.md").read_text() in said
    monkeypatch.setattr(Scale, "simulate", lambda scale: ("computed", lambda: 1 / 0))
    with pytest.raises(ZeroDivisionError):  # a figure that cannot be drawn takes nothing away
        scale.main()
    assert "computed" in [path.read_text() for path in (tmp_path / "scale").glob("*/simulate.md")]
    monkeypatch.setattr(simulated, "rollout_seconds", lambda options, trials: [2.0] * trials)
    assert Scale("simulate").times() == pytest.approx(Times(2.0, 0.0, 0.0))


@pytest.mark.slow
def test_trials_are_timed_one_by_one(monkeypatch, task):
    monkeypatch.setattr(RunOptions, "make_task", lambda options: task)
    tried, rollout = [], Short.rollout
    monkeypatch.setattr(Short, "rollout", lambda task, policy: tried.append(policy.pack()) or rollout(task, policy))
    assert min(simulated.rollout_seconds(options_for("via_point", rollouts=3), 5)) > 0
    assert all(theta.shape[0] == 1 for theta in tried) and len({float(theta.detach().sum()) for theta in tried}) == 6


def test_wrong_numbers_and_names_are_refused(tmp_path):
    for wrong in ({"processes": (0,)}, {"workers": (0, 1)}, {"patience": 0.0}, {"runs": 0}):
        with pytest.raises(InvalidArgumentError, match="have to be at least 1 and --patience positive"):
            Scale("measure", **wrong, logdir=tmp_path).main()
    with pytest.raises(UnknownNameError, match="unknown case 'nothing'"):
        Scale("measure", only="nothing", logdir=tmp_path).main()


def test_what_a_machine_cannot_run_is_said_and_takes_nothing_away(monkeypatch, tmp_path):
    def timed(name, n):
        said = "import sys; sys.exit('Traceback\\na.MissingPackageError: no mujoco\\nlater\\n====')"
        if "digging" in name:
            printed([sys.executable, "-c", said])
        return Timing(0.5, 0.4, 0.0, 0.0, 0, 0)

    monkeypatch.setattr(command, "timed", timed)
    folder = Scale("measure", only="di", processes=(1,), repeats=2, logdir=tmp_path).main()
    text = (folder / "measure.md").read_text()
    assert "| divergent field, 10 roll-outs | 1 | 500 [500, 500] |" in text and "| digging" not in text
    assert text.count("digging of 3 s, 10 roll-outs, 1 process(es) cannot be had: ") == 1
    assert text.endswith("ended with exit code 1: a.MissingPackageError: no mujoco\n")


@pytest.mark.parametrize(("said", "why"), [("one\nlast\n", "last"), ("", "it says nothing")])
def test_a_program_that_fails_says_why(said, why):
    with pytest.raises(TorchdsError, match=f"ended with exit code 3: {why}$"):
        printed([sys.executable, "-c", f"import sys; sys.stderr.write({said!r}); sys.exit(3)"])


@pytest.mark.slow
def test_one_process_sends_nothing(monkeypatch):
    monkeypatch.delenv("WORLD_SIZE", raising=False)
    timing = learn(CASES["N, 10 roll-outs"], 1)
    assert timing.update > 0 and timing.busy > 0 and timing[2:] == (0.0, 0.0, 0, 0)


@pytest.mark.slow
def test_two_processes_send_their_costs_once(task, monkeypatch, tmp_path):
    monkeypatch.setattr(RunOptions, "make_task", lambda options: task)

    def work(rank):
        timing = learn(CASES["N, 10 roll-outs, PI²"], 2)
        assert timing.messages == 2 and 0 < timing.gather < 1 and timing.together > 0 and timing.busy < 5
        numbers = 5 * 12 * (1 + 4 + 2)  # costs, gating and inputs of five roll-outs of twelve steps, four Gaussians
        assert 8 * numbers < timing.bytes < 8 * numbers + 4000  # and what pickle says about three tensors

    for code, said in forked(2, work):
        assert code == 0, said


def test_a_line_has_ratios_of_what_was_measured_one_after_the_other():
    one, two = Timing(1.0, 0.8, 0.0, 0.0, 0, 0), Timing(0.5, 0.6, 0.2, 0.1, 2, 99)
    found = {("case", 1): [one, one], ("case", 2): [two, two._replace(update=0.7)]}
    line = Scale("measure").line("case", 2, found)
    assert line[2:4] == ["600 [550, 650]", "0.6 [0.55, 0.65]"] and line[5] == "0.75 [0.75, 0.75]"
    assert line[6:] == ["200", "100", "2", "99"]
    assert Scale("measure").line("case", 1, found)[3] == ""
