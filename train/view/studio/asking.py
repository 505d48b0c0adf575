"""Settings of the problem: what is drawn, how it is imitated, and what is asked of it."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

from tasks.sketch import Problem
from torchds import Demonstrations, load, load_lasa
from torchds.files import write_atomically
from torchds.recordings.lasa import lasa_names
from train.view.studio import changes
from train.view.studio.controls import Place, bind, note, number, select, slider, switch, weight
from train.view.studio.nice import events, ui
from train.view.studio.window import Window

CONDITIONS = {"none": "none", "seds": "SEDS (P = 1)", "p-qlf": "P-QLF (P is learned)"}
EXECUTIONS = {"open": "open loop", "closed": "closed loop", "passive": "passive"}
FIELDS = {"none": "no force", "constant": "a constant force", "divergent": "away from the demonstrations"}
WEIGHTS = {
    "via_points": "via-points",
    "goal": "goal",
    "acceleration": "acceleration",
    "path_length": "path length",
    "regions": "forbidden regions",
    "stiffness": "stiffness",
}
MIDDLE = (0.0, 0.0)


def drawing(window: Window) -> None:
    """Demonstrations: by hand, from LASA, from files."""
    studio = window.studio
    note("Draw the same motion two or three times, as you would move a robot: slowly where it is to be slow.")
    slider(window, "samples of each", ("samples",), 20, 400, 1)
    windows = {0: "none", 5: "5 samples", 9: "9 samples", 15: "15 samples"}
    bind(
        window, ui.select(windows, label="smoothing").props("dense options-dense").style("width: 100%"), ("smoothing",)
    )
    number(window, "duration [s]", ("duration",), placeholder="as drawn", min=0.01, step=0.1)
    names = lasa_names(single=True)
    with ui.element("div").classes("studio-row"):
        chosen = ui.select(names, label="a LASA motion", value=names[0]).props("dense options-dense").style("flex: 1")
        ui.button("Add", on_click=lambda: window.attempt(lambda: add(window, load_lasa(chosen.value, 3).every(5))))
    file(window, "own recordings (.csv, .npz, .mat)", ".csv,.npz,.mat,.txt")
    with ui.element("div").classes("studio-row"):
        ui.button("Remove last", on_click=lambda: window.change(strokes=studio.problem.strokes[:-1]))
        ui.button("Clear", on_click=lambda: window.change(strokes=()))
    findings = ui.column().style("gap: 2px").props("role=status")
    said: list[tuple[str, ...]] = [()]

    def tell() -> None:
        found = () if studio.imitation is None else studio.imitation.findings
        if found != said[0]:
            said[0] = found
            findings.clear()
            with findings:
                for sentence in found:
                    ui.label(sentence).classes("studio-note studio-bad")

    window.tellers.append(tell)


def add(window: Window, demos: Demonstrations) -> None:
    """Recorded motions beside what is drawn."""
    window.studio.change(**changes.recorded(window.studio.problem, demos))


def file(window: Window, label: str, endings: str) -> None:
    """A place for files of recordings, or of a problem."""

    async def taken(event: events.UploadEventArguments) -> None:
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / Path(event.file.name).name
            content = await event.file.read()
            write_atomically(path, lambda stream: stream.write(content))
            if path.suffix == ".json":
                window.attempt(lambda: window.studio.put(Problem.read(path)))
            else:
                window.attempt(lambda: add(window, load(path)))
        element.reset()

    element = ui.upload(label=label, auto_upload=True, on_upload=taken).style("width: 100%; max-height: 6rem")
    element.props(f'flat bordered dense accept="{endings}"')


def imitating(window: Window) -> None:
    """The mixture, the condition of stability, its certificate, and where things are."""
    studio = window.studio
    slider(window, "Gaussians K", ("components",), 1, 12, 1)
    select(window, "stability condition", ("condition",), CONDITIONS)
    note(
        "A certificate proves that the motion ends at the goal from everywhere. A fit under a condition takes seconds."
    )
    certificate = ui.label().props("role=status").style("font-weight: 600")
    note("Drag the start, the goal or via-points with the second tool above the table, or type where they are:")
    column = ui.column().style("gap: 2px; width: 100%")
    shown: dict[str, Any] = {"n": None, "pairs": []}

    def tell() -> None:
        known = studio.imitation
        certificate.set_text(
            "" if known is None else f"certificate: {known.verdict}, rate of convergence {known.margin:.3g} /s"
        )
        if (n := len(studio.problem.via_points)) != shown["n"]:
            for element in shown["pairs"]:
                del window.controls[element]
            column.clear()
            with column:
                shown.update(n=n, pairs=places(window, n))
            window.fill()

    window.tellers.append(tell)


def places(window: Window, n: int) -> list[Any]:
    """A pair of numbers for the start, the goal, and each of the `n` via-points; the elements."""
    names: dict[str, Place] = {"start": ("start",), "goal": ("goal",)}
    names |= {f"via-point {i + 1}": ("via_points", i) for i in range(n)}
    pairs = []
    for name, place in names.items():
        with ui.element("div").classes("studio-row"):
            pairs += [number(window, f"{name}, x{axis + 1}", (*place, axis), step=0.01) for axis in range(2)]
            if len(place) > 1:
                remove(window, name, int(place[1]))
    ui.button(
        "Add a via-point",
        on_click=lambda: window.change(**changes.placed(window.studio.problem, "via", MIDDLE, MIDDLE)),
    )
    return pairs


def remove(window: Window, name: str, index: int) -> None:
    """A button that removes a via-point."""
    studio = window.studio
    button = ui.button(icon="delete", on_click=lambda: window.change(**changes.erased(studio.problem, "via", index)))
    button.props(f'flat dense aria-label="remove {name}"')


def asking(window: Window) -> None:
    """Weights of the cost terms, and the body with its forces."""
    note("Click via-points, walls and forbidden regions into the table; say here how much each counts.")
    for name, label in WEIGHTS.items():
        weight(window, label, ("weights", name))
    switch(window, "a point mass follows the motion", ("body",), {}, None)
    with ui.column().style("gap: 6px; width: 100%") as body:
        slider(window, "stiffness [N/m]", ("body", "stiffness"), 1, 2000, 1)
        slider(window, "mass [kg]", ("body", "mass"), 0.1, 10, 0.1)
        slider(window, "damping [N s/m]", ("body", "damping"), 0, 20, 0.1)
        select(window, "it follows in", ("body", "execution"), EXECUTIONS)
        select(window, "force", ("body", "field"), FIELDS)
        slider(window, "gain [N/m]", ("body", "gain"), 0, 50, 1, 0)
        with ui.element("div").classes("studio-row"):
            for axis in range(2):
                number(window, f"force {axis + 1} [N]", ("body", "force", axis))
    window.tellers.append(lambda: body.set_visibility(window.studio.problem.body is not None))
