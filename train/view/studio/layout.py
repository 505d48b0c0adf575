"""The page: what is where on it, and which change of the state each control asks for."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import torch

from tasks.sketch import Problem, examples
from train.view.studio import changes, panels, showing
from train.view.studio.drawing import EVENTS, Drawing
from train.view.studio.motions import motion
from train.view.studio.nice import app, ui
from train.view.studio.state import Studio
from train.view.studio.window import Window

LOOKS = 100.0  # a second, for what has come
CURVES = 0.3  # s between two pictures of the learning curves, at least
WORDS = 1.0  # s between two sentences about who learns, at least: they are read aloud to some
TOOLS = {
    "draw": ("draw", "Draw a demonstration with mouse, pen or touch"),
    "move": ("open_with", "Drag the start, the goal or a via-point"),
    "via": ("add_location", "Click where the motion has to pass"),
    "wall": ("horizontal_rule", "Drag a wall from end to end"),
    "region": ("do_not_disturb_on", "Drag a forbidden disc from its centre"),
    "erase": ("delete", "Click a demonstration, via-point, wall or region to remove it"),
    "pull": ("pan_tool", "Grab the moving mass and pull"),
}
STYLE = """
.nicegui-content { padding: 0 }
.studio { display: grid; grid-template-columns: minmax(0, 1fr) 23rem; height: 100vh; width: 100%;
  background: #eef1f4; color: #1b2733 }
.studio-left { display: flex; flex-direction: column; gap: 6px; padding: 8px; min-width: 0; min-height: 0 }
.studio-tables { display: flex; gap: 6px; flex: 1; min-height: 14rem }
.studio-tables > * { flex: 1; min-width: 0; position: relative }
.studio-right { background: white; overflow-y: auto; padding: 4px 12px }
.studio-row { display: flex; gap: 8px; align-items: center; flex-wrap: wrap; width: 100% }
.studio-right .q-tab { padding: 0 9px; min-width: 0 }
.studio-note { font-size: 13px; color: #41505f }
.studio-bad { color: #a32015 }
.studio :focus-visible { outline: 2px solid #1f5fa8 !important; outline-offset: 1px }
@media (max-width: 1000px) {
  .studio { grid-template-columns: minmax(0, 1fr); height: auto }
  .studio-tables { height: 30rem }
}
"""


def serve(studio: Studio, host: str, port: int, *, show: bool = True) -> None:
    """Serve the page until the process is interrupted."""
    last = [time.monotonic()]

    def tick() -> None:
        now = time.monotonic()
        studio.tick(now - last[0])
        last[0] = now

    @ui.page("/", title="torchds studio")
    def page() -> None:
        View(studio)

    print(f"studio: http://{host}:{port} until Ctrl-C; its state is kept in {studio.folder}", flush=True)
    app.timer(1 / LOOKS, tick)
    ui.run(
        host=host,
        port=port,
        show=show,
        reload=False,
        tailwind=False,
        show_welcome_message=False,
        ws_per_message_deflate=False,  # this machine talks to itself
    )


class View(Window):
    """The table, the chart and the settings of one window."""

    def __init__(self, studio: Studio) -> None:
        super().__init__(studio)
        self.shape = 1.6  # of a table, width by height
        ui.colors(primary="#1f5fa8", negative="#a32015")
        ui.add_css(STYLE)
        with ui.element("main").classes("studio"):
            with ui.element("section").classes("studio-left").props('aria-label="table"'):
                self.bar()
                with ui.element("div").classes("studio-tables"):
                    with ui.element("div"):
                        self.first = Drawing(
                            "the table: draw a motion here", {name: self.heard(name) for name in EVENTS}
                        )
                    with ui.element("div") as self.beside:
                        self.second = Drawing(
                            "the second learner", {"ready": lambda _: self.news("problem")}, active=False
                        )
                self.line = ui.label().classes("studio-note").props("role=status")
                self.chart()
            with ui.element("section").classes("studio-right").props('aria-label="settings"'):
                panels.build(self)
        studio.views.append(self)
        ui.context.client.on_delete(self.leave)
        ui.timer(1 / LOOKS, self.draw)
        self.news("problem")

    # ------------------------------------------------------------------ what is heard

    def heard(self, name: str) -> Callable[[dict[str, Any]], object]:
        """What is done about an event of the table."""
        return lambda said: self.attempt(lambda: getattr(self, f"on_{name}")(said))

    def on_ready(self, said: dict[str, Any]) -> None:
        """The table is empty, or has another shape."""
        self.shape = said["width"] / max(said["height"], 1)
        self.news("problem")

    def on_stroke(self, said: dict[str, Any]) -> None:
        """A demonstration, or its beginning."""
        self.given_up = None if said["done"] else self.studio.forget
        self.studio.draw(said["points"], said["done"])

    def on_place(self, said: dict[str, Any]) -> None:
        """A via-point, a wall or a region."""
        self.studio.change(**changes.placed(self.studio.problem, said["kind"], said["from"], said["to"]))

    def on_erase(self, said: dict[str, Any]) -> None:
        """Something is removed."""
        self.studio.change(**changes.erased(self.studio.problem, said["kind"], said["index"]))

    def on_drag(self, said: dict[str, Any]) -> None:
        """Start, goal or a via-point is somewhere else, for now or for good."""
        kind, at = said["kind"], said["at"]
        if said["done"]:
            self.news("problem")  # what is refused is shown where it still is
            return self.studio.change(**changes.dragged(self.studio.problem, kind, said["index"], at))
        self.first.show(**self.moved(kind, said["index"], at))

    def on_pull(self, said: dict[str, Any]) -> None:
        """The hand at the mass."""
        self.given_up = None if said["at"] is None else lambda: self.studio.pull(None)
        self.studio.pull(said["at"])

    # ------------------------------------------------------------------ what is shown

    def bar(self) -> None:
        """The row above the table: examples, undo and redo, and what the pointer does."""
        with ui.element("div").classes("studio-row"):
            ui.label("torchds studio").style("font-weight: 600; font-size: 17px").props("role=heading aria-level=1")
            names = {name: Problem.read(path).name for name, path in examples().items()}
            self.examples = ui.select(names, label="example", on_change=lambda e: self.example(e.value))
            self.examples.props("dense options-dense").style("min-width: 10rem")
            for label, call in {"undo": self.studio.undo, "redo": self.studio.redo}.items():
                button = ui.button(icon=label, on_click=lambda call=call: self.attempt(call))
                button.props(f'flat dense aria-label="{label}"').tooltip(label)
            self.tools = {}
            for name, (icon, label) in TOOLS.items():
                button = ui.button(icon=icon, on_click=lambda name=name: self.use(name)).tooltip(label)
                self.tools[name] = button.props(f'dense aria-label="{label}"')
        self.tool = "draw"
        self.tools["draw"].props("aria-pressed=true")
        for name in TOOLS:
            if name != "draw":
                self.tools[name].props("flat aria-pressed=false")

    def example(self, name: str | None) -> None:
        """Begin with one of the examples."""
        if name is not None:
            self.studio.put(Problem.read(examples()[name]))
            self.examples.value = None

    def use(self, tool: str) -> None:
        """What the pointer does from now on."""
        self.tool = tool
        self.first.use(tool)
        for name, button in self.tools.items():
            button.props(f"aria-pressed={'true' if name == tool else 'false'}")
            button.props(remove="flat") if name == tool else button.props("flat")
        if tool == "pull" and self.studio.pushed is None:
            self.push()

    def chart(self) -> None:
        """Learning curves by term."""
        self.curves = (
            ui.echart(
                {
                    "animation": False,
                    "grid": {"left": 64, "right": 16, "top": 46, "bottom": 40},
                    "legend": {"top": 0, "type": "scroll"},
                    "xAxis": {
                        "type": "value",
                        "name": "roll-outs of each run",
                        "nameLocation": "middle",
                        "nameGap": 22,
                    },
                    "yAxis": {
                        "type": "log",
                        "name": "cost (median of runs)",
                        "nameGap": 6,
                        "nameTextStyle": {"align": "left"},
                    },
                    "series": [],
                }
            )
            .style("height: 12rem; width: 100%")
            .props('role=img aria-label="learning curves by cost term"')
        )
        self.charted, self.old = 0.0, False
        self.told, self.unsaid = 0.0, False

    def draw(self) -> None:
        """Show what has changed since the last picture."""
        waiting, self.waiting = self.waiting, set()
        studio, tables = self.studio, (self.first, self.second)
        if "problem" in waiting:
            self.fill()
            self.beside.set_visibility(len(studio.problem.learners) > 1)
            for table in tables:
                table.show(**showing.scenery(studio, self.shape))
        if "imitation" in waiting:
            for table in tables:
                table.show(**showing.imitated(studio))
        for i, table in enumerate(tables):
            if waiting & {"imitation", f"side {i}"} and (i == 0 or self.beside.visible):
                table.show(**showing.learned(studio, i, self.shape))
        if "mass" in waiting:
            self.first.show(mass=showing.mass(studio))
        self.old = self.old or bool(waiting & {"side 0", "side 1"})
        if self.old and time.monotonic() - self.charted > CURVES:
            self.charted, self.old = time.monotonic(), False
            self.curves.run_chart_method("setOption", {"series": showing.series(studio)}, {"replaceMerge": ["series"]})
        if waiting:
            for tell in self.tellers:
                tell()
        self.unsaid = self.unsaid or bool(waiting)
        if self.unsaid and (time.monotonic() - self.told > WORDS or not any(side.running for side in studio.sides)):
            self.told, self.unsaid = time.monotonic(), False
            self.line.set_text(panels.said(studio))

    def moved(self, kind: str, index: int, at: list[float]) -> dict[str, Any]:
        """The layers while something is dragged: the motions begin or end elsewhere."""
        studio = self.studio
        if kind == "via":
            return {"via": changes.dragged(studio.problem, kind, index, at)["via_points"]}
        place = {kind: torch.tensor(at, dtype=torch.float64)}
        layers: dict[str, Any] = {kind: at}
        if studio.task is None:
            return layers
        if studio.imitation is not None and not studio.imitating:
            layers["imitated"] = [showing.plain(motion(studio.task, studio.imitation.policy, **place), studio.table)]
        if (picture := studio.fresh(0)) is not None:
            layers["motion"] = [showing.plain(motion(studio.task, picture.policy, **place), studio.table)]
        return layers
