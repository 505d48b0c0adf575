import pytest

import tasks


class Short(tasks.TwoStarts):
    """Two starts in a tenth of the steps."""

    def motion(self):
        motion = super().motion()
        return motion._replace(n_steps=motion.n_steps // 10, dt=10 * motion.dt)


@pytest.fixture(scope="module")
def task():
    return Short()
