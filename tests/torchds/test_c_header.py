"""A policy as a C header, compiled as C99 and C++17 without a warning, against the policy itself."""

import shutil
import subprocess

import numpy as np
import pytest
import torch

import torchds
from torchds.errors import InvalidArgumentError

STRICT = ["-Wall", "-Wextra", "-Werror", "-pedantic", "-O2"]
LANGUAGES = {"C99": ("gcc", "c", ["-std=c99"]), "C++17": ("g++", "cpp", ["-std=c++17"])}
PROGRAM = """
#include <stdio.h>
#include "motion.h"
int main(void)
{
    double x[motion_inputs], y[motion_velocities + motion_stiffnesses];
    while (fread(x, sizeof x, 1, stdin) == 1) {
        motion_evaluate(x, y);
        fwrite(y, sizeof y, 1, stdout);
        motion_step(x, 0.5, y);
        fwrite(x, sizeof x, 1, stdout);
    }
    return 0;
}
"""


def compiled(folder, language):
    """The program with the header in `folder`."""
    compiler, ending, options = LANGUAGES[language]
    if shutil.which(compiler) is None:
        pytest.skip(f"no {compiler} here")
    source = folder / f"main.{ending}"
    source.write_text(PROGRAM)
    command = [compiler, *options, *STRICT, str(source), "-o", str(folder / "main"), "-lm"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return folder / "main"


@pytest.mark.parametrize("language", LANGUAGES)
@pytest.mark.parametrize("size", [{}, {"K": 5, "D": 3, "O": 4, "Q": 2}, {"K": 1, "D": 1, "O": 1}])
@pytest.mark.slow
def test_it_is_the_policy_in_a_thousand_states(random_policy, randn, tmp_path, language, size):
    policy = random_policy(**size, moved=True)
    torchds.export(policy, tmp_path / "motion.h", format="c")
    x = 3 * randn(1000, policy.input_dim)
    done = subprocess.run([compiled(tmp_path, language)], input=x.numpy().tobytes(), capture_output=True, check=True)
    O, Q, D = policy.output_dim, policy.stiffness_dim, policy.input_dim
    y, after = np.split(np.frombuffer(done.stdout).reshape(1000, -1), [O + Q], axis=1)
    expected = torch.cat([policy(x), policy.stiffness(x)] if Q else [policy(x)], -1).detach().numpy()
    np.testing.assert_allclose(y, expected, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(after, x.numpy() + 0.5 * expected[:, :D], rtol=1e-12, atol=1e-12)


def test_components_without_a_prior_are_left_out(random_policy, tmp_path):
    policy = random_policy()
    padded = torchds.GMRPolicy(
        torch.tensor([0.5, 0.5, 0.0]), policy.means, policy.covariances, policy.A.detach(), policy.b.detach()
    )
    torchds.export(padded, tmp_path / "motion.h", format="c")
    assert "log_scale[2]" in (tmp_path / "motion.h").read_text()


def test_what_is_known_stands_in_the_comment_and_cannot_end_it(random_policy, tmp_path):
    policy = random_policy()
    policy.info = policy.info._replace(names=("x", "*/ ü"), units="m", dt=0.01, goal=torch.ones(2))
    torchds.export(policy, tmp_path / "my motion-1.h", format="c")
    text = (tmp_path / "my motion-1.h").read_text()
    assert "inputs x, ? ?; in m; time step 0.01 s; goal [1.0, 1.0]" in text
    assert "void my_motion_1_step(" in text and text.isascii()


def test_batches_names_that_are_none_and_motions_are_refused(random_policy, tmp_path):
    with pytest.raises(InvalidArgumentError, match=r"one policy, got a batch \(2,\)"):
        torchds.export(random_policy(batch=(2,)), tmp_path / "motion.h", format="c")
    with pytest.raises(InvalidArgumentError, match="has to begin with a letter, got '1st'"):
        torchds.export(random_policy(), tmp_path / "1st.h", format="c")
    with pytest.raises(InvalidArgumentError, match="NAME_step, which integrates it; leave n_steps and dt out"):
        torchds.export(random_policy(), tmp_path / "motion.h", 10, 0.1, format="c")
    assert not list(tmp_path.iterdir())
