"""A page on which trials are looked at: choose one, move through time, compare plots."""

from __future__ import annotations

import importlib.util
import threading
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from torchds.errors import MissingPackageError

if TYPE_CHECKING:
    from train.view.shapes import Shapes

Point = tuple[float, float, float]
PER_SECOND = 20  # pictures while it plays
COLOURS = ((216, 90, 30), (31, 95, 168), (60, 150, 70), (120, 70, 160))
MOMENT = "#c00020"


class Take(NamedTuple):
    """One trial.

    Attributes:
        policy: what was tried, "before learning" say.
        trial: its number or name; there is one for each policy.
        times: `(F,)` of the pictures [s].
        qpos: `(F, nq)` generalised positions of the scene, or None.
        paths: lines in space `(F, 3)` by name, with a ball where they are at each moment [m].
        series: numbers over time `(F,)` by name, with their unit.
    """

    policy: str
    trial: str
    times: np.ndarray
    qpos: np.ndarray | None
    paths: dict[str, np.ndarray]
    series: dict[str, np.ndarray]


class Page:
    """The page, served until `close`.

    Args:
        title: of the page.
        takes: at least one, with the same names of paths and series.
        shapes: of the scene, or None where there are lines alone.
        host: address that is served; "127.0.0.1" for this machine alone, which is what an ssh tunnel needs.
        port: at which, or the next that is free.
        look: where the camera stands and what it looks at; the paths, if None.

    Attributes:
        url: of the page.

    Raises:
        MissingPackageError: without the package viser.
    """

    def __init__(
        self,
        title: str,
        takes: Sequence[Take],
        shapes: Shapes | None = None,
        *,
        host: str = "127.0.0.1",
        port: int = 8080,
        look: tuple[Point, Point] | None = None,
    ) -> None:
        if importlib.util.find_spec("viser") is None:
            raise MissingPackageError("viser", "view", "a scene in a web page")
        import viser

        self._takes = {(take.policy, take.trial): take for take in takes}
        self._shapes = shapes
        self.server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
        self.url = f"http://{'localhost' if host == '127.0.0.1' else host}:{self.server.get_port()}"
        everywhere = np.concatenate([path for take in takes for path in take.paths.values()])
        self._middle, self._size = everywhere.mean(0), float(np.ptp(everywhere, axis=0).max())
        camera = self.server.initial_camera
        camera.position, camera.look_at = look or (self._middle + self._size * np.array([0.2, -0.9, 0.9]), self._middle)
        self._drawing = threading.Lock()  # the slider and the playing draw from two threads
        self._build(title)
        self._scene()
        self.draw()

    # ------------------------------------------------------------------ what there is on the page

    def _build(self, title: str) -> None:
        gui, policies, trials = (
            self.server.gui,
            *(list(dict.fromkeys(names)) for names in zip(*self._takes, strict=True)),
        )
        gui.set_panel_label(title)
        self.policy = gui.add_dropdown("policy", policies, initial_value=policies[-1])
        self.trial = gui.add_dropdown("trial", trials)
        first = next(iter(self._takes.values()))
        end = max(float(take.times[-1]) for take in self._takes.values())
        self.time = gui.add_slider("time [s]", 0.0, end, float(first.times[1] - first.times[0]), 0.0)
        self.playing = gui.add_checkbox("play", False)
        self._plots: dict[str, Any] = {name: self._plot(name, policies) for name in first.series}
        for control in (self.policy, self.trial, self.time):
            control.on_update(lambda _: self.draw())

    def _plot(self, name: str, policies: list[str]) -> Any:
        from viser import uplot

        colours = [f"rgb{COLOURS[i % len(COLOURS)]}" for i in range(len(policies))]
        lines = [
            uplot.Series(label=policy, stroke=colour, width=2) for policy, colour in zip(policies, colours, strict=True)
        ]
        here = uplot.Series(label="now", stroke=MOMENT, width=0, points={"show": True, "size": 9, "fill": MOMENT})
        return self.server.gui.add_uplot(
            self._curves(name),
            (uplot.Series(label="s"), *lines, here),
            title=name,
            scales={"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=False, range=self._range(name))},
            aspect=2.2,
        )

    def _range(self, name: str) -> tuple[float, float]:
        """Of a series over all trials, with a little room; the plot itself would not find it beside what is no number."""
        values = np.concatenate([take.series[name] for take in self._takes.values()])
        low, high = float(values.min()), float(values.max())
        level = 0.1 * max(abs(low), abs(high)) or 1.0  # of a series that does not change
        room = 0.1 * (high - low) if high - low > 0.01 * level else level
        return low - room, high + room

    def _curves(self, name: str, moment: int = 0) -> tuple[np.ndarray, ...]:
        """Times, the series of all policies in the chosen trial, and the chosen one at this moment alone."""
        shown = [take for (_, trial), take in self._takes.items() if trial == self.trial.value]
        here = np.full(len(self.take.times), np.nan)
        here[moment] = self.take.series[name][moment]
        return (self.take.times, *(take.series[name] for take in shown), here)

    def _scene(self) -> None:
        scene = self.server.scene
        take, size = self.take, self._size
        scene.add_grid("/floor", 8 * size, 8 * size, cell_size=0.2 * size, section_size=size)
        self._solids, self._rounds = [], None
        if self._shapes is not None:
            from train.view.shapes import ball

            for i, (vertices, faces, colour) in enumerate(self._shapes.solids):
                self._solids.append(scene.add_mesh_simple(f"/scene/{i}", vertices, faces, color=_bytes(colour)))
            if n := len(self._shapes.sizes):
                mesh = ball()
                self._rounds = scene.add_batched_meshes_simple(
                    "/scene/round",
                    mesh.vertices,
                    mesh.faces,
                    batched_wxyzs=np.tile([1.0, 0, 0, 0], (n, 1)),
                    batched_positions=np.zeros((n, 3)),
                    batched_scales=self._shapes.sizes,
                    batched_colors=_bytes(self._shapes.colours),
                    lod="off",
                )
        self._lines, self._balls = {}, {}
        for i, (name, path) in enumerate(take.paths.items()):
            colour = COLOURS[i % len(COLOURS)]
            self._lines[name] = scene.add_line_segments(
                f"/path/{name}", _segments(path), colour, thickness=0.006 * size
            )
            self._balls[name] = scene.add_icosphere(f"/now/{name}", 0.012 * size, colour)

    # ------------------------------------------------------------------ what moves

    @property
    def take(self) -> Take:
        """The trial that is chosen."""
        return self._takes[self.policy.value, self.trial.value]

    def draw(self) -> None:
        """Put everything where it is at the slider's time."""
        with self._drawing, self.server.atomic():
            take = self.take
            moment = int(np.abs(take.times - self.time.value).argmin())
            if self._shapes is not None and take.qpos is not None:
                solid, ball = self._shapes.at(take.qpos[moment])
                for handle, x, wxyz in zip(self._solids, solid.x, solid.wxyz, strict=True):
                    handle.position, handle.wxyz = x, wxyz
                if self._rounds is not None:
                    self._rounds.batched_positions, self._rounds.batched_wxyzs = ball.x, ball.wxyz
            for name, path in take.paths.items():
                self._lines[name].points = _segments(path)
                self._balls[name].position = path[moment]
            for name, plot in self._plots.items():
                plot.data = self._curves(name, moment)

    def serve(self, seconds: float = float("inf")) -> None:
        """Play while it is asked for, until the process is interrupted or the time is over."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            time.sleep(1 / PER_SECOND)
            if self.playing.value:
                ahead = self.time.value + 1 / PER_SECOND
                self.time.value = ahead if ahead <= self.take.times[-1] else 0.0  # type: ignore[misc]  # and draws

    def close(self) -> None:
        """Serve no longer."""
        self.server.stop()


def show(page: Page, seconds: float = float("inf")) -> None:
    """Say where the page is, and serve it until the command is interrupted."""
    print(
        f"{page.url} until Ctrl-C; from another machine: ssh -L {page.server.get_port()}:localhost:{page.server.get_port()} …"
    )
    try:
        page.serve(seconds)
    except KeyboardInterrupt:
        pass
    finally:
        page.close()


def _segments(path: np.ndarray) -> np.ndarray:
    """`(F−1, 2, 3)`."""
    return np.stack([path[:-1], path[1:]], 1)


def _bytes(colour: object) -> np.ndarray:
    return (255 * np.asarray(colour)).round().astype(np.uint8)
