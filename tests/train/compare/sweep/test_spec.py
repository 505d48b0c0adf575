"""Sweeps as they are written: what is multiplied, what is refused."""

import pytest

from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from train.compare.sweep import spec


def jobs(tmp_path, text):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    return spec.read(path)


def test_lists_are_multiplied_and_tables_go_together(tmp_path):
    found = jobs(
        tmp_path,
        """
        task = ["two_starts", {task = "via_point", shape = "P"}]
        learner = [{optimizer = "pibb"}, {optimizer = "surrogate", exploration = "trajectory"}]
        seeds = 3
        updates = 5
        """,
    )
    said = [(job.options.name, job.options.optimizer, job.options.exploration, job.options.seed) for job in found]
    assert said == [
        (task, optimizer, exploration, seed)
        for task in ("two_starts", "via_point")
        for optimizer, exploration in (("pibb", "homogeneous"), ("surrogate", "trajectory"))
        for seed in range(3)
    ]
    assert {job.options.updates for job in found} == {5}
    assert found[-1].options.shape == "P"
    assert len({job.name for job in found}) == 12


def test_a_job_has_its_name_by_its_options_alone(tmp_path):
    (alone,) = jobs(tmp_path, 'task = "via_point"\nseed = 2\nscale = 1.0')
    twice = jobs(tmp_path, 'task = ["via_point", "via_point"]\nseed = [1, 2]')
    assert [job.name for job in twice][1] == alone.name and len(twice) == 2


@pytest.mark.parametrize(
    "text, kind, words",
    [
        ("task = ", FileError, "no readable file of a sweep"),
        ("seed = 3", InvalidArgumentError, "each job needs a task"),
        ('task = "via_pont"', UnknownNameError, "Did you mean 'via_point'"),
        ('task = "via_point"\nsead = 1', UnknownNameError, "unknown option of via_point 'sead'"),
        ('task = "via_point"\nseed = "one"', InvalidArgumentError, "the option seed cannot be 'one'"),
        ('task = "via_point"\noptimizer = "adm"', UnknownNameError, "unknown optimizer 'adm'"),
        (
            'task = "via_point"\nupdates = [5, -3]',
            InvalidArgumentError,
            "mine.toml: --updates has to be at least 0, got -3",
        ),
        ('task = "via_point"\nruns = 0', InvalidArgumentError, "mine.toml: --runs has to be at least 1, got 0"),
        ('task = "via_point"\nscale = -1.0', InvalidArgumentError, "mine.toml: --scale has to be positive"),
        ('task = "via_point"\ncost_noise = -0.1', InvalidArgumentError, "--cost-noise at least 0, got 1.0 and -0.1"),
        ('task = "via_point"\nlogdir = "here"', InvalidArgumentError, "logdir belongs to the command"),
        ('task = "via_point"\nseeds = 0', InvalidArgumentError, "seeds has to be a number of seeds"),
        ('task = "via_point"\nseed = 1\nown = [{seed = 2}]', InvalidArgumentError, "seed is said twice"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(tmp_path, text, kind, words):
    with pytest.raises(kind, match=words):
        jobs(tmp_path, text)


def test_a_file_that_is_not_there(tmp_path):
    with pytest.raises(FileError, match=r"nowhere.toml is no readable file"):
        spec.read(tmp_path / "nowhere.toml")
