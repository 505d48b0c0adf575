"""The settings beside the table: each control shows a value of the problem's file, and asks for another one."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from nicegui import events, ui

from tasks.sketch import Problem
from torchds import load, load_lasa
from torchds.recordings.lasa import lasa_names
from train.studio import keeping
from train.studio.side import stem
from train.studio.state import Studio

if TYPE_CHECKING:
    from train.studio.layout import View

Json = dict[str, Any]
OPTIMIZERS = {
    "surrogate": "surrogate (recommended)",
    "pibb": "PI^BB (the paper)",
    "pi2": "PI²",
    "pi2cma": "PI²-CMA",
    "nes": "evolution strategy (NES)",
    "cma": "CMA-ES",
    "cobyqa": "COBYQA",
    "finite_differences": "finite differences",
    "adam": "Adam (gradient)",
    "sgd": "gradient descent",
    "lbfgs": "L-BFGS (gradient)",
}
EXPLORATIONS = {
    "trajectory": "along the motion",
    "homogeneous": "homogeneous in space",
    "stable": "keeps it stable",
    "stable-trajectory": "stable, along the motion",
    "gaussian": "all parameters alike",
}
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
SECOND = {"optimizer": "adam", "runs": 1, "updates": 50}  # the learner to compare with, to begin with
OFF, MOST = -6.0, 2.0  # of the logarithm of a weight
FASTEST = 100.0  # updates a second; as fast as it can


class Control(NamedTuple):
    """An element, and what it shows of a problem."""

    element: Any
    read: Callable[[Json], Any]


def build(view: View) -> None:
    """All settings, as tabs."""
    rooms = {
        "Draw": drawing,
        "Imitate": imitating,
        "Ask": asking,
        "Learn": learning,
        "Push": pushing,
        "Keep": taking,
    }
    with ui.tabs().props('dense align=left no-caps inline-label aria-label="settings"') as tabs:
        for name in rooms:
            ui.tab(name)
    with ui.tab_panels(tabs, value="Draw", keep_alive=True).style("width: 100%"):
        for name, room in rooms.items():
            with ui.tab_panel(name).style("padding: 8px 0; gap: 6px"):
                room(view)


def fill(view: View) -> None:
    """Show the problem in all controls."""
    view.filling = True
    p = view.studio.problem.to_json()
    try:
        places(view, p)
        view.body.set_visibility(p["body"] is not None)
        view.second_learner.set_visibility(len(p["learners"]) > 1)
        for control in view.controls:
            control.element.value = control.read(p)
    finally:
        view.filling = False


def bind(view: View, element: Any, read: Callable[[Json], Any], write: Callable[[Json, Any], Json]) -> Any:
    """Let an element show `read(problem)`, and change the fields `write(problem, value)`."""

    def changed(event: events.ValueChangeEventArguments[Any]) -> None:
        if view.filling or event.value is None:
            return
        view.attempt(lambda: view.studio.change(**write(view.studio.problem.to_json(), event.value)))
        view.news("problem")  # what was refused is shown as it still is

    element.on_value_change(changed)
    view.controls.append(Control(element, read))
    return element


def slider(view: View, label: str, low: float, high: float, step: float, read: Any, write: Any, shown: str = "") -> Any:
    """A slider with its name and its value."""
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label(label).style("width: 8.5rem; font-size: 14px")
        element = ui.slider(min=low, max=high, step=step).props(f'aria-label="{label}" label')
        bind(view, element, read, write)
        ui.label().bind_text_from(element, "value", lambda value: shown_as(value, shown)).style(
            "width: 4rem; text-align: right; font-size: 14px"
        )
    return element


def shown_as(value: float | None, kind: str) -> str:
    """The value of a slider in words."""
    if value is None:
        return ""
    if kind == "weight":
        return "off" if value <= OFF else f"{weight(value):.3g}"
    return f"{value:.4g}{kind}"


def weight(position: float) -> float:
    """Where a slider of weights stands, as a weight."""
    return 0.0 if position <= OFF else float(f"{10**position:.3g}")


def position(weight: float) -> float:
    """A weight as a place on its slider."""
    return OFF if weight <= 10**OFF else math.log10(weight)


def number(view: View, label: str, read: Any, write: Any, **options: Any) -> Any:
    """A number that is asked for when it is complete."""
    element = ui.number(label=label, **options).props("dense debounce=500").style("width: 6.5rem")
    return bind(view, element, read, write)


def select(view: View, label: str, options: dict[str, str], read: Any, write: Any) -> Any:
    """One of several names."""
    return bind(view, ui.select(options, label=label).props("dense options-dense").style("width: 100%"), read, write)


def note(text: str) -> Any:
    """A sentence of explanation."""
    return ui.label(text).classes("studio-note")


# ------------------------------------------------------------------ the rooms


def drawing(view: View) -> None:
    """Demonstrations: by hand, from LASA, from files."""
    note("Draw the same motion two or three times, as you would move a robot: slowly where it is to be slow.")
    slider(view, "samples of each", 20, 400, 1, lambda p: p["samples"], lambda p, n: {"samples": int(n)})
    slider(
        view,
        "smoothing",
        0,
        41,
        1,
        lambda p: p["smoothing"],
        lambda p, n: {"smoothing": 0 if n < 5 else min(int(n) | 1, p["samples"] - 1 | 1)},
    )
    number(
        view,
        "duration [s]",
        lambda p: p["duration"],
        lambda p, n: {"duration": n or None},
        placeholder="as drawn",
        min=0,
    )
    names = lasa_names(single=True)
    with ui.element("div").classes("studio-row"):
        chosen = ui.select(names, label="a LASA motion", value=names[0]).props("dense options-dense").style("flex: 1")
        ui.button("Add", on_click=lambda: view.attempt(lambda: view.studio.add(load_lasa(chosen.value, 3).every(5))))
    ui.upload(label="own recordings (.csv, .npz, .mat)", auto_upload=True, on_upload=lambda e: upload(view, e)).props(
        'flat bordered dense accept=".csv,.npz,.mat,.txt"'
    ).style("width: 100%")
    with ui.element("div").classes("studio-row"):
        ui.button("Remove last", on_click=lambda: view.studio.change(strokes=list(view.studio.problem.strokes[:-1])))
        ui.button("Clear", on_click=lambda: view.studio.change(strokes=[]))
    view.findings = ui.column().style("gap: 2px").props("role=status")


async def upload(view: View, event: events.UploadEventArguments) -> None:
    """Recordings from a file, or a problem."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / Path(event.file.name).name
        path.write_bytes(await event.file.read())
        if path.suffix == ".json":
            view.attempt(lambda: view.studio.put(Problem.read(path)))
        else:
            view.attempt(lambda: view.studio.add(load(path)))
    event.sender.reset()


def imitating(view: View) -> None:
    """The mixture, the condition of stability, and its certificate."""
    slider(view, "Gaussians K", 1, 12, 1, lambda p: p["components"], lambda p, k: {"components": int(k)})
    select(view, "stability condition", CONDITIONS, lambda p: p["condition"], lambda p, name: {"condition": name})
    note("A certificate proves that the motion ends at the goal from everywhere. Fits under a condition take seconds.")
    view.certificate = ui.label().props("role=status").style("font-weight: 600")
    note("Drag the start, the goal or via-points with the second tool above the table, or type where they are:")
    view.placed = ui.column().style("gap: 2px; width: 100%")


def places(view: View, p: Json) -> None:
    """A pair of numbers for each place in the problem; made anew where there are others."""
    names = [("start", "start"), ("goal", "goal"), *((f"via-point {i + 1}", i) for i in range(len(p["via_points"])))]
    if view.named == names:
        return
    view.named = names
    view.controls = [control for control in view.controls if control.element not in view.pairs]
    view.placed.clear()
    view.pairs = []
    with view.placed:
        for label, key in names:
            with ui.element("div").classes("studio-row"):
                for axis in range(2):
                    view.pairs.append(number(view, f"{label}, x{axis + 1}", at(key, axis), moved(key, axis), step=0.01))
                if isinstance(key, int):
                    ui.button(icon="delete", on_click=lambda key=key: view.studio.erase("via", key)).props(
                        f'flat dense aria-label="remove {label}"'
                    )
        ui.button("Add a via-point", on_click=lambda: view.studio.place("via", [0.0, 0.0], [0.0, 0.0])).props(
            "flat dense"
        )


def at(key: str | int, axis: int) -> Callable[[Json], float | None]:
    """A coordinate of a place; None where the drawing says it."""

    def read(p: Json) -> float | None:
        place = p["via_points"][key] if isinstance(key, int) else p[key]
        return None if place is None else place[axis]

    return read


def moved(key: str | int, axis: int) -> Callable[[Json, Any], Json]:
    """The same place with another coordinate."""

    def write(p: Json, value: float) -> Json:
        place = p["via_points"][key] if isinstance(key, int) else p[key] or [0.0, 0.0]
        place = [value if i == axis else x for i, x in enumerate(place)]
        if isinstance(key, int):
            return {"via_points": [place if i == key else point for i, point in enumerate(p["via_points"])]}
        return {key: place}

    return write


def said(studio: Studio) -> str:
    """What there is to say below the table, in a line."""
    parts = []
    known = studio.imitation
    if studio.complaint:
        parts.append(studio.complaint)
    elif known is not None:
        parts.append(f"imitated in {known.seconds:.2f} s")
    elif not studio.problem.strokes:
        parts.append("Draw a motion on the table: press, move, let go.")
    for i, side in enumerate(studio.sides):
        picture = studio.fresh(i)
        if side.complaint:
            parts.append(side.complaint)
        if picture is not None:
            cost = picture.curves["total"]
            parts.append(
                f"{'AB'[i]}: update {picture.done} of {picture.of}, cost {cost[-1]:.3g}, at the start {cost[0]:.3g}"
            )
        elif side.stale(studio.problem):
            parts.append(f"{'AB'[i]} has learned an earlier version of the problem; Go begins anew")
    return " · ".join(parts)


def told(view: View) -> None:
    """What is known of the drawing, the system and the mass, in words."""
    studio = view.studio
    known = studio.imitation
    view.certificate.set_text(
        "" if known is None else f"certificate: {known.verdict}, rate of convergence {known.margin:.3g} /s"
    )
    findings = () if known is None else known.findings
    if view.told != findings:
        view.told = findings
        view.findings.clear()
        with view.findings:
            for sentence in findings:
                ui.label(sentence).classes("studio-note studio-bad")
    pushed = studio.pushed
    view.stiffness.set_text(
        "" if pushed is None else "applied: " + ", ".join(f"{s:.0f}" for s in pushed.applied) + " N/m"
    )


def asking(view: View) -> None:
    """Weights of the cost terms, and the body with its forces."""
    note("Click via-points, walls and forbidden regions into the table; say here how much each counts.")
    for name, label in WEIGHTS.items():
        slider(
            view,
            label,
            OFF,
            MOST,
            0.1,
            lambda p, name=name: position(p["weights"][name]),
            lambda p, at, name=name: {"weights": {**p["weights"], name: weight(at)}},
            "weight",
        )
    bind(
        view,
        ui.switch("a point mass follows the motion"),
        lambda p: p["body"] is not None,
        lambda p, there: {"body": (p["body"] or {}) if there else None},
    )
    with ui.column().style("gap: 6px; width: 100%") as view.body:
        body(view)


def body(view: View) -> None:
    """The point mass, how it follows, and what forces it aside."""
    of_body(view, "stiffness [N/m]", "stiffness", 1, 2000, 1)
    of_body(view, "mass [kg]", "mass", 0.1, 10, 0.1)
    of_body(view, "damping [N s/m]", "damping", 0, 20, 0.1)
    of_body(view, "gain [N/m]", "gain", -50, 50, 1)
    for label, key, options in (("it follows in", "execution", EXECUTIONS), ("force", "field", FIELDS)):
        select(
            view,
            label,
            options,
            lambda p, key=key: (p["body"] or {}).get(key),
            lambda p, name, key=key: {"body": {**(p["body"] or {}), key: name}},
        )
    with ui.element("div").classes("studio-row"):
        for axis in range(2):
            number(
                view,
                f"force {axis + 1} [N]",
                lambda p, axis=axis: (p["body"] or {}).get("force", [0, 0])[axis],
                lambda p, n, axis=axis: {
                    "body": {
                        **(p["body"] or {}),
                        "force": [n if i == axis else v for i, v in enumerate((p["body"] or {}).get("force", [0, 0]))],
                    }
                },
            )


def of_body(view: View, label: str, key: str, low: float, high: float, step: float) -> None:
    """A slider for a number of the body."""
    slider(
        view,
        label,
        low,
        high,
        step,
        lambda p: (p["body"] or {}).get(key, low),
        lambda p, n: {"body": {**p["body"], key: n}} if p["body"] else {},
    )


def learning(view: View) -> None:
    """The two learners, and when they learn."""
    studio = view.studio
    with ui.element("div").classes("studio-row"):
        ui.button("Go", icon="play_arrow", on_click=lambda: view.attempt(lambda: studio.go(view.pace.value)))
        ui.button("Pause", icon="pause", on_click=studio.pause)
        ui.button("Step", icon="skip_next", on_click=lambda: view.attempt(studio.step))
        ui.button("Reset", icon="replay", on_click=lambda: view.attempt(studio.reset))
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label("updates a second").style("width: 8.5rem; font-size: 14px")
        view.pace = ui.slider(min=1, max=FASTEST, step=1, value=20).props('aria-label="updates a second" label')
        ui.label().bind_text_from(view.pace, "value", lambda n: "all it can" if n >= FASTEST else f"{n:.0f}").style(
            "width: 4rem; text-align: right; font-size: 14px"
        )
    learner(view, 0)
    bind(
        view,
        ui.switch("compare with a second learner"),
        lambda p: len(p["learners"]) > 1,
        lambda p, there: {"learners": [p["learners"][0], *([SECOND] if there else [])]},
    )
    with ui.column().style("gap: 6px; width: 100%") as view.second_learner:
        learner(view, 1)


def learner(view: View, index: int) -> None:
    """The options of a learner."""

    def read(name: str, usual: Any) -> Callable[[Json], Any]:
        return lambda p: (p["learners"][index : index + 1] or [{}])[0].get(name, usual)

    def write(name: str, kind: Callable[[Any], Any] = lambda value: value) -> Callable[[Json, Any], Json]:
        return lambda p, value: {
            "learners": [{**each, name: kind(value)} if i == index else each for i, each in enumerate(p["learners"])]
        }

    ui.label(f"Learner {'AB'[index]}").style("font-weight: 600")
    select(view, "optimizer", OPTIMIZERS, read("optimizer", "pibb"), write("optimizer"))
    select(view, "exploration", EXPLORATIONS, read("exploration", "homogeneous"), write("exploration"))
    with ui.element("div").classes("studio-row"):
        for name, label, usual in (
            ("rollouts", "roll-outs", 10),
            ("runs", "runs", 1),
            ("updates", "updates", 50),
            ("seed", "seed", 0),
        ):
            number(view, label, read(name, usual), write(name, int), min=0, precision=0)
        number(view, "noise", read("noise", None), write("noise", float), placeholder="usual")
        number(view, "noise in costs", read("cost_noise", 0.0), write("cost_noise", float), min=0)


def pushing(view: View) -> None:
    """The mass that can be pulled at."""
    studio = view.studio
    note("A mass of 1 kg follows the motion. Grab it with the last tool above the table and pull.")
    execution = ui.radio(EXECUTIONS, value="open").props("inline dense")
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label("stiffness [N/m]").style("width: 8.5rem; font-size: 14px")
        stiff = ui.slider(min=5, max=1000, step=5, value=200).props('aria-label="stiffness of the mass" label')
    note("Where the policy has learned a stiffness, that is taken.")
    view.pushing = lambda: studio.push(execution.value, stiff.value)
    execution.on_value_change(lambda: view.attempt(view.pushing))
    stiff.on("change", lambda: view.attempt(view.pushing))
    with ui.element("div").classes("studio-row"):
        ui.button("From the start", on_click=lambda: view.attempt(view.pushing))
        ui.button("Away with it", on_click=studio.let_go)
    with ui.element("div").classes("studio-row"):
        for label, force in (("←", (-1, 0)), ("→", (1, 0)), ("↑", (0, 1)), ("↓", (0, -1))):
            ui.button(label, on_click=lambda force=force: studio.nudge(force)).props(f'aria-label="push {label}"')
    view.stiffness = ui.label().props("role=status")


def taking(view: View) -> None:
    """Files to take along, and a problem to bring."""
    studio = view.studio
    for label, name, make in (
        ("Policy (.pt)", "{}.pt", keeping.policy),
        ("Demonstrations (.npz)", "{}.npz", keeping.demonstrations),
        ("Problem (.json)", "{}.json", keeping.problem),
        ("Picture (.svg)", "{}.svg", lambda studio: keeping.picture(studio, "svg")),
        ("Picture (.png)", "{}.png", lambda studio: keeping.picture(studio, "png")),
        ("Python script (.py)", "{}.py", keeping.program),
    ):
        ui.button(
            label,
            icon="download",
            on_click=lambda name=name, make=make: view.attempt(
                lambda: ui.download.content(make(studio), name.format(stem(studio.problem)))
            ),
        ).props("align=left").style("width: 100%")
    ui.input("name", on_change=lambda e: None if view.filling else studio.change(name=e.value)).props(
        "dense debounce=500"
    ).style("width: 100%")
    ui.upload(label="a problem (.json)", auto_upload=True, on_upload=lambda e: upload(view, e)).props(
        'flat bordered dense accept=".json"'
    ).style("width: 100%")
    note("`python -m train FILE.json` learns a problem in the terminal, with TensorBoard.")
