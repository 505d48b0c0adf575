"""Runs by several processes under torchrun, compared with one process bit for bit: `python -m tests.faults.ranks ...`.

equal 1 2 3 4   every task and optimizer by that many processes
kill 20         a run of two processes one of which dies 20 times (SIGKILL), torchrun restarting them
hang 20         the same, but one of them stands still (SIGSTOP), until the other waits no longer
resize 20       torchrun and all its processes die 20 times, and the command is given again with another number of processes
"""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import torch

ROOT = Path(__file__).parents[2]
NOISY = {"cost_noise": 0.1}
ALONG = {"exploration": "trajectory"}
CASES = {
    "N, PIBB": ("via_point", {}),
    "N, PIBB, noisy costs": ("via_point", NOISY),
    "N, surrogate along the motion": ("via_point", {"optimizer": "surrogate", **ALONG}),
    "N, surrogate along the motion, noisy costs": ("via_point", {"optimizer": "surrogate", **ALONG, **NOISY}),
    "N, PI2": ("via_point", {"optimizer": "pi2"}),
    "N, PI2CMA": ("via_point", {"optimizer": "pi2cma"}),
    "divergent field, PIBB": ("divergent_field", {}),
    "divergent field, sensor noise and pushes": ("divergent_field", {"sensor_noise": 0.002, "pushes": 1.0}),
    "divergent field, surrogate along the motion": ("divergent_field", {"optimizer": "surrogate", **ALONG}),
    "half plane, PIBB": ("half_plane_force", {}),
    "two starts, PIBB": ("two_starts", {}),
    "constrained reaching, PIBB": ("constrained_reaching", {}),
    "N, NES": ("via_point", {"optimizer": "nes", **NOISY}),
    "N, CMA-ES": ("via_point", {"optimizer": "cma", **ALONG}),
    "N, COBYQA": ("via_point", {"optimizer": "cobyqa"}),
    "N, finite differences": ("via_point", {"optimizer": "finite_differences"}),
    "N, Adam": ("via_point", {"optimizer": "adam", **NOISY}),
    "digging, PIBB": ("lwr_digging", {"runs": 1, "grains": "coarse", "seconds": 3.0, "rollouts": 4, "updates": 2}),
}
COMMAND = ["via_point", "--shape", "N", "--runs", "2", "--updates", "400", "--cost-noise", "0.1", "--folder"]


def outcome(folder):
    """What has to be equal: policies, costs of all updates, and all scalars of TensorBoard but the times."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    from torchds import files, load_policy

    results = files.read_sealed(folder / "results.json")
    events = EventAccumulator(str(folder), size_guidance={"scalars": 0}).Reload()
    tags = [tag for tag in events.Tags()["scalars"] if not tag.startswith("time/")]
    found = {tag: [(event.step, event.value) for event in events.Scalars(tag)] for tag in tags}
    found |= {name: results[name] for name in ("rollouts", "forward_equivalents", "cost", "terms", "failed")}
    found["policy"] = load_policy(folder / "policy.pt").pack().detach().numpy().tobytes()
    return found


def all_cases(folder):
    """One process of several: all cases, one after the other."""
    from train.learning.run import run
    from train.options import options_for

    torch.set_num_threads(1)
    if "RANK" in os.environ:
        torch.distributed.init_process_group("gloo")
    for name, (task, options) in CASES.items():
        values = {"runs": 2, "updates": 5, "rollouts": 10, **options}
        run(options_for(task, folder=folder / name, **values))


def torchrun(size, *arguments, **options):
    """A command for `size` processes."""
    command = [sys.executable, "-m", "torch.distributed.run", "--standalone", f"--nproc-per-node={size}"]
    return [*command, *(f"--{name.replace('_', '-')}={value}" for name, value in options.items()), *arguments]


def begin(command, **options):
    """Start a command in a group of its own."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    return subprocess.Popen(command, cwd=ROOT, env=environment, start_new_session=True, **quiet, **options)


def differing(expected, found):
    """Names of what differs."""
    return [name for name in expected.keys() | found.keys() if expected.get(name) != found.get(name)]


def equal(base, sizes):
    """Try every case with each number of processes, and print what differs."""
    failed = False
    subprocess.run([sys.executable, "-m", "tests.faults.ranks", "cases", str(base / "alone")], cwd=ROOT, check=True)
    for size in sizes:
        folder = base / str(size)
        arguments = ["-m", "tests.faults.ranks", "cases", str(folder)]
        subprocess.run(torchrun(size, *arguments), cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        for name in CASES:
            wrong = differing(outcome(base / "alone" / name), outcome(folder / name))
            failed |= bool(wrong)
            print(f"| {name} | {size} | {', '.join(wrong) or 'equal'} |", flush=True)
    return failed


def workers(launcher):
    """The processes that torchrun has started, by rank."""
    found = {}
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and (entry / "stat").read_text().rpartition(")")[2].split()[1] == str(launcher.pid):
                said = dict(item.split("=", 1) for item in (entry / "environ").read_text().split("\0") if "=" in item)
                if "RANK" in said:
                    found[int(said["RANK"])] = int(entry.name)
        except (OSError, ValueError, IndexError):
            continue
    return found


def checkpoint(folder):
    """When the last checkpoint was written; 0 without one."""
    try:
        return (folder / "checkpoint.pt").stat().st_mtime_ns
    except OSError:
        return 0


def struck(base, times, fault, rng):
    """Let one of two processes die at any moment, or stand still at any moment after their first update, `times` times."""
    folder = base / "struck"
    arguments = ["-m", "train", *COMMAND, str(folder), "--patience", "5"]
    launcher = begin(torchrun(2, *arguments, max_restarts=times + 5, monitor_interval=0.1))
    done, group, due = 0, {}, 0.0
    while launcher.poll() is None:
        time.sleep(0.05)
        alive = workers(launcher)
        if (
            done < times and len(alive) == 2 and not set(alive.values()) & set(group.values())
        ):  # they have just been started
            group, known = alive, checkpoint(folder)
            due = time.monotonic() + rng.uniform(0.0, 8.0) if fault == signal.SIGKILL else None
        if due is None and checkpoint(folder) != known:
            due = time.monotonic() + rng.uniform(0.0, 1.5)
        if due and time.monotonic() > due and alive == group:
            os.kill(alive[rng.randrange(2)], fault)
            done, due = done + 1, 0.0
    return done, launcher.returncode, folder


def resized(base, times, rng):
    """Let torchrun and its processes die, and give the command again for another number of processes."""
    folder, done = base / "resized", 0
    while True:
        size = 1 + (done + 1) % 4
        launcher = begin(torchrun(size, "-m", "train", *COMMAND, str(folder)))
        known = checkpoint(folder)
        while done < times and launcher.poll() is None and checkpoint(folder) == known:
            time.sleep(0.02)
        if done == times or launcher.poll() is not None:
            return done, launcher.wait(), folder
        time.sleep(rng.uniform(0.0, 0.5))
        for pid in workers(launcher).values():
            os.kill(pid, signal.SIGKILL)
        launcher.kill()
        launcher.wait()
        done += 1


def main():
    """Do what the command line says; exit code 1 if anything differs."""
    what, *rest = sys.argv[1:]
    if what == "cases":
        return all_cases(Path(rest[0]))
    with tempfile.TemporaryDirectory() as place:
        base, rng = Path(place), random.Random(0)
        if what == "equal":
            return equal(base, [int(size) for size in rest])
        began = time.monotonic()
        subprocess.run([sys.executable, "-m", "train", *COMMAND, str(base / "alone")], cwd=ROOT, check=True)
        once = time.monotonic() - began
        if what == "resize":
            done, code, folder = resized(base, int(rest[0]), rng)
        else:
            fault = {"kill": signal.SIGKILL, "hang": signal.SIGSTOP}[what]
            done, code, folder = struck(base, int(rest[0]), fault, rng)
        wrong = ["exit code"] if code else differing(outcome(base / "alone"), outcome(folder))
        seconds = time.monotonic() - began - once
        print(f"| {what} | {done} times | {wrong or 'equal'} | {seconds:.0f} s, {once:.0f} s without |")
        return bool(wrong) or done < int(rest[0])


if __name__ == "__main__":
    sys.exit(main())
