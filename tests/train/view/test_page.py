"""The page: what is where at which moment, and what a browser shows of it."""

import time

import numpy as np
import PIL.Image
import pytest

from tests import chromium

mujoco = pytest.importorskip("mujoco")
pytest.importorskip("viser")

from train.view.page import Page, Take  # noqa: E402
from train.view.shapes import Shapes  # noqa: E402

SCENE = """<mujoco><worldbody>
  <geom type="plane" size="1 1 .1"/>
  <body pos="0 0 .5"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 .8" size=".15" rgba=".95 .45 .1 1"/></body>
  <body pos="1 0 .4"><joint type="slide" axis="0 0 1"/><geom type="sphere" size=".4" rgba=".5 .5 .5 1"/></body>
</worldbody></mujoco>"""


def takes():
    times = np.linspace(0.0, 2.0, 11)
    made = []
    for policy, far in (("before", 1.0), ("after", 2.0)):
        for trial in ("1", "2"):
            path = np.stack([far * times, 0 * times, 0.2 + 0 * times], -1)
            qpos = np.stack([0 * times, far * times], -1)
            made.append(Take(policy, trial, times, qpos, {"tool": path}, {"force [N]": far * np.sin(3 * times)}))
    return made


@pytest.fixture
def page():
    shapes = Shapes(mujoco.MjModel.from_xml_string(SCENE))
    page = Page("a test", takes(), shapes, port=8311, look=((0.5, -5.0, 2.0), (0.5, 0.0, 0.5)))
    yield page
    page.close()


@pytest.mark.slow
def test_everything_is_where_the_slider_and_the_choice_say(page):
    assert page.policy.value == "after" and page.url.startswith("http://localhost:")
    for policy, far in (("before", 1.0), ("after", 2.0)):
        page.policy.value, page.time.value = policy, 1.0
        page.draw()
        np.testing.assert_allclose(page._rounds.batched_positions, [[1.0, 0.0, 0.4 + far]], atol=1e-6)
        np.testing.assert_allclose(page._balls["tool"].position, [far, 0.0, 0.2])
        times, before, after, here = page._plots["force [N]"].data
        np.testing.assert_allclose((before, after), np.outer((1.0, 2.0), np.sin(3 * times)))
        assert np.flatnonzero(np.isfinite(here)).tolist() == [5] and here[5] == pytest.approx(far * np.sin(3.0))


@pytest.mark.slow
def test_it_plays_and_begins_again(page):
    page.time.value, page.playing.value = 1.9, True
    page.serve(0.5)
    assert page.time.value < 1.9


@pytest.mark.slow
@pytest.mark.skipif(chromium.MISSING, reason="no chromium with chromedriver")
def test_a_browser_shows_scene_and_plots(page, tmp_path):
    chromium.screenshot(page.url, tmp_path / "page.png", "document.querySelectorAll('.u-over').length > 0")
    time.sleep(0.1)
    picture = np.asarray(PIL.Image.open(tmp_path / "page.png").convert("RGB")).astype(int)
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    left, right = np.s_[:, :320], np.s_[:, 320:]
    orange = (red > 150) & (blue < 90) & (red - green > 60)
    grey = (abs(red - green) < 12) & (abs(green - blue) < 12) & (red > 60) & (red < 200)
    line = (abs(red - 31) < 40) & (abs(green - 95) < 40) & (abs(blue - 168) < 40)
    assert orange[left].sum() > 500 and grey[left].sum() > 1000 and line[right].sum() > 50
