"""Settings of the problem: what is drawn, how it is imitated, and what is asked of it."""

from __future__ import annotations

import tempfile
from pathlib import Path

from tasks.sketch import Problem
from tasks.sketch.problem import MOST_BYTES
from torchds import Demonstrations, load, load_lasa
from torchds.errors import InvalidArgumentError, TorchdsError
from torchds.files import write_atomically
from torchds.recordings.lasa import lasa_names
from train.view.studio import changes, places
from train.view.studio.controls import bind, note, number, select, slider, switch, weight
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
        content = await event.file.read()
        window.attempt(lambda: bring(window, event.file.name, content))
        element.reset()

    def refused() -> None:
        ui.notify(f"a file has to be one of {endings}, of at most {MOST_BYTES // 10**6} MB", type="negative")

    element = ui.upload(
        label=label, auto_upload=True, on_upload=taken, on_rejected=refused, max_file_size=MOST_BYTES
    ).style("width: 100%; max-height: 6rem")
    element.props(f'flat bordered dense accept="{endings}"')


def bring(window: Window, name: str, content: bytes) -> None:
    """A problem in place of this one, or recorded motions beside what is drawn.

    Raises:
        TorchdsError: neither is in the file; the message has its name.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"file{Path(name).suffix.lower()}"  # names of files elsewhere may be none here
        try:
            write_atomically(path, lambda stream: stream.write(content))
            if path.suffix == ".json":
                window.studio.put(Problem.read(path))
            else:
                add(window, load(path))
        except TorchdsError as error:
            raise InvalidArgumentError(str(error).replace(str(path), name)) from error


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
    places.ends(window)
    places.things(window, "via")

    def tell() -> None:
        known = studio.imitation
        certificate.set_text(
            "" if known is None else f"certificate: {known.verdict}, rate of convergence {known.margin:.3g} /s"
        )

    window.tellers.append(tell)


def asking(window: Window) -> None:
    """Weights of the cost terms, and the body with its forces."""
    note("Click via-points, walls and forbidden regions into the table; say here how much each counts.")
    for name, label in WEIGHTS.items():
        weight(window, label, ("weights", name))
    for kind in ("walls", "regions"):
        places.things(window, kind)
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
