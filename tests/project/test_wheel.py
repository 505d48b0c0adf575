"""What pip brings: wheel and sdist are built, installed outside the checkout, and tried with no extra and with each alone."""

import json
import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import venv
import zipfile
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
EXTRAS = {name: needs for name, needs in PROJECT["optional-dependencies"].items() if name != "dev"}
INSTALLED = {canonicalize_name(found.name): found for found in metadata.distributions()}

# What needs an extra: it works where the extra is there, and names the extra where it is not.
NEEDS = {
    "lasa": "torchds.load_lasa('NShape', n_demos=1)",
    "plot": "import torchds.plotting",
    "metrics": "torchds.metrics.dtwd(torch.zeros(3, 2), torch.ones(4, 2))",
}

# One process of the user's interpreter for all cases: each is a fork of it, in which what torchds needs is there
# already and the hidden modules are not installed.
CASES = """
import json, os, sys, traceback
from importlib.machinery import PathFinder
import scipy.interpolate, sklearn.mixture, torch._dynamo

def case(code, hidden):
    class Visible(PathFinder):
        @classmethod
        def find_spec(cls, name, path=None, target=None):
            return None if name.split(".")[0] in hidden else super().find_spec(name, path, target)
    for name in [name for name in sys.modules if name.split(".")[0] in hidden]:
        del sys.modules[name]  # torch takes tqdm where it is
    sys.meta_path[sys.meta_path.index(PathFinder)] = Visible
    exec(code, {"hidden": hidden})

for line in sys.stdin:
    code, hidden, said = json.loads(line)
    child = os.fork()
    if not child:
        os.dup2(os.open(said, os.O_WRONLY), 1)
        os.dup2(1, 2)
        try:
            case(code, set(hidden))
        except BaseException:
            traceback.print_exc()
            os._exit(1)
        sys.stdout.flush()
        os._exit(0)
    print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
"""

WITHOUT_EXTRAS = """
import importlib, pkgutil, sys, torch, torchds
assert torchds.__file__.startswith(sys.prefix), torchds.__file__
t = torch.linspace(0, 1, 50, dtype=torch.float64)
curves = [torch.stack([t.cos() + shift, t.sin()], -1).numpy() for shift in (0.0, 0.01)]
demos = torchds.Demonstrations(curves, dt=0.1)
policy = torchds.GMRPolicy.from_demonstrations(demos, n_components=2)
optim = torchds.optim.PIBB(policy.parameters(), torchds.exploration.Homogeneous(policy, mean_speed=0.01), n_rollouts=4)
before = policy.pack().detach().clone()
optim.step(lambda: torchds.costs.goal(torchds.rollout(policy, demos[0].x[0], 10, 0.1).x, torch.zeros(2).double()))
assert not torch.equal(policy.pack(), before)
for info in pkgutil.walk_packages(torchds.__path__, "torchds."):
    try:
        importlib.import_module(info.name)
    except torchds.errors.MissingPackageError:
        assert hidden, info.name
"""

CHECKOUT = f"""
import importlib, pathlib, sys, torchds
sys.path.append({str(ROOT)!r})
for package in ("tasks", "train"):
    for path in sorted(pathlib.Path(sys.path[-1], package).rglob("*.py")):
        name = ".".join(path.relative_to(sys.path[-1]).with_suffix("").parts).removesuffix(".__init__")
        try:
            importlib.import_module(name)
        except torchds.errors.MissingPackageError as error:
            print(name, error)
"""


def brought(needs):
    """The packages that requirements bring, with all that these need in turn."""
    found, todo = set(), [Requirement(need) for need in needs]
    while todo:
        need = todo.pop()
        name = canonicalize_name(need.name)
        if name not in found and (need.marker is None or need.marker.evaluate({"extra": ""})):
            found.add(name)
            todo += map(Requirement, (name in INSTALLED and INSTALLED[name].requires) or [])
    return found


def all_but(*extras):
    """The modules that are not there where only these extras are installed."""
    here = brought(PROJECT["dependencies"] + [need for extra in extras for need in EXTRAS[extra]])
    gone = brought(need for needs in EXTRAS.values() for need in needs) - here
    owners = metadata.packages_distributions()
    return {module for module, names in owners.items() if {canonicalize_name(name) for name in names} <= gone}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Sdist and wheel; the wheel is built from the sdist, as pip would."""
    folder = tmp_path_factory.mktemp("dist")
    build = [sys.executable, "-m", "build", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(build, check=True, capture_output=True)
    return next(folder.glob("*.tar.gz")), next(folder.glob("*.whl"))


@pytest.fixture(scope="module")
def run(built, tmp_path_factory):
    """Runs code in an environment in which the wheel is installed, as if the hidden modules were not; gives what it printed."""
    folder = tmp_path_factory.mktemp("user")
    venv.create(folder / "venv", with_pip=False)
    pip = [sys.executable, "-m", "pip", "--python", str(folder / "venv"), "install", "--no-index", "--no-deps"]
    subprocess.run([*pip, str(built[1])], check=True, capture_output=True)
    # Third-party packages come from this environment; its .pth files, which lead to the checkout, are not read there.
    target = next((folder / "venv").rglob("site-packages"))
    (target / "third_party.pth").write_text(sysconfig.get_paths()["purelib"] + "\n")
    environment = os.environ | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    environment.pop("PYTHONPATH", None)
    command = [folder / "venv" / "bin" / "python", "-W", "error", "-c", CASES]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen(command, cwd=folder, env=environment, text=True, **pipes) as process:

        def run(code, hidden):
            said = folder / "said"
            said.write_text("")
            print(json.dumps([code, sorted(hidden), str(said)]), file=process.stdin, flush=True)
            assert process.stdout.readline() == "0\n", said.read_text()
            return said.read_text()

        yield run


def test_the_sdist_holds_the_library_and_its_pages_alone(built):
    with tarfile.open(built[0]) as sdist:
        names = {name.split("/", 1)[1] for name in sdist.getnames()}
    pages = {"README.md", "LICENSE", "CHANGELOG.md", "CITATION.cff", "pyproject.toml", "PKG-INFO", ".gitignore"}
    assert {name for name in names if not name.startswith("torchds/")} == pages


def test_the_wheel_holds_the_library_alone(built):
    with zipfile.ZipFile(built[1]) as wheel:
        names = wheel.namelist()
    folders = {name.split("/")[0] for name in names}
    assert folders == {"torchds", f"torchds-{PROJECT['version']}.dist-info"}
    sources = {str(path.relative_to(ROOT)) for path in (ROOT / "torchds").rglob("*.py")}
    assert sources <= set(names)


@pytest.mark.parametrize("extras", [(), *((extra,) for extra in EXTRAS)], ids=lambda extras: "".join(extras) or "none")
def test_the_library_works_with_no_extra_and_with_each_alone(run, extras):
    run(WITHOUT_EXTRAS, all_but(*extras))


@pytest.mark.parametrize("extra", NEEDS)
def test_what_needs_an_extra_works_with_it_alone_and_names_it_where_it_is_missing(run, extra):
    run(f"import torch, torchds\n{NEEDS[extra]}", all_but(extra))
    missing = (
        f"import torch, torchds\ntry: {NEEDS[extra]}\nexcept torchds.errors.MissingPackageError as error: print(error)"
    )
    assert f"pip install 'torchds[{extra}]'" in run(missing, all_but())


@pytest.mark.parametrize("extras", [(), ("train",)], ids=["none", "train"])
def test_tasks_and_commands_import_or_name_the_extra_that_is_missing(run, extras):
    lines = run(CHECKOUT, all_but(*extras)).splitlines()
    named = {line.split()[0]: re.search(r"torchds\[(\w+)\]", line)[1] for line in lines}
    sources = (ROOT / "tasks" / "digging").glob("*.py")
    digging = {f"tasks.digging.{path.stem}".removesuffix(".__init__"): "digging" for path in sources}
    if extras:  # every command can be chosen; what it needs beside is asked for when it runs
        robot = {"train.hardware.trial": "digging"}
        page = ("asking", "controls", "drawing", "layout", "nice", "panels", "places", "running", "window")
        studio = {f"train.view.studio.{name}": "studio" for name in page}
        later = {**robot, **studio, "train.deep_rl.agents": "baselines", "train.view.shapes": "digging"}
    else:
        later = {name: "train" for name in named if name.split(".")[0] == "train"}
        assert "train.__main__" in later
    assert named == {**digging, "tasks.gym": "baselines", **later}


def test_the_first_example_of_the_readme_needs_the_extra_lasa_alone(run):
    example = re.search(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)[1]
    end = "\nwith torch.no_grad(): print(float(closure()))"
    assert float(run(example + end, all_but("lasa"))) < 1.0  # 3.1 before learning
