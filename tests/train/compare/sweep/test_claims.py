"""Claims on one folder: one worker at a time, and another one only after a worker was silent."""

import os
import time

import pytest

from tests.forked import forked
from train.compare.sweep.claims import Claims, Seen, Superseded


def look(claims, name):
    return claims.newest().get(name, Seen())


def test_the_second_is_told_that_there_is_a_first(tmp_path):
    one, two = Claims(tmp_path, 0.05, 0.5), Claims(tmp_path, 0.05, 0.5)
    with one.take("job.a", look(one, "job.a")) as mine:
        assert mine is not None
        seen = look(two, "job.a")
        assert seen.number == 1 and not two.alone("job.a", seen)
        time.sleep(0.7)  # longer than its patience, but the first one lives
        assert not two.alone("job.a", look(two, "job.a"))
        with two.take("job.a", Seen()) as second:
            assert second is None
        mine.check()
    assert two.alone("job.a", look(two, "job.a"))  # given back
    assert look(two, "job.a").died == 0


def test_a_worker_that_was_silent_loses_the_job_and_knows_it(tmp_path):
    one, two = Claims(tmp_path, 9.0, 0.1), Claims(tmp_path, 9.0, 0.1)
    with one.take("job", look(one, "job")) as asleep:
        assert not two.alone("job", look(two, "job"))
        time.sleep(0.12)
        seen = look(two, "job")
        assert two.alone("job", seen) and seen.died == 1
        with two.take("job", seen) as mine:
            mine.check()
            with pytest.raises(Superseded):
                asleep.check()
            assert look(two, "job").number == 2
    one.forgive("job")
    assert look(one, "job").died == 0


def test_what_was_seen_long_ago_is_no_silence(tmp_path):
    one, two = Claims(tmp_path, 9.0, 0.1), Claims(tmp_path, 9.0, 0.1)
    with one.take("job", Seen()):
        assert not two.alone("job", look(two, "job"))
        seen = look(two, "job")
        time.sleep(0.15)  # busy with something else between two looks
        assert not two.alone("job", seen)


def test_of_many_processes_one_gets_the_job(tmp_path):
    def work(rank):
        claims = Claims(tmp_path / "claims", 9.0, 90.0)
        for job in range(50):
            with claims.take(f"job{job}", Seen()) as claim:
                if claim is not None:
                    (tmp_path / f"{job}.{rank}").touch()
                    os.sched_yield()

    for code, said in forked(4, work):
        assert code == 0, said
    assert sorted(int(path.name.split(".")[0]) for path in tmp_path.glob("*.?")) == list(range(50))
