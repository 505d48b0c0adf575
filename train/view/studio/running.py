"""Settings of what is done with a problem: it is learned, the mass is pushed, and files are taken along."""

from __future__ import annotations

from collections.abc import Callable

from tasks.sketch import Problem
from train.view.studio import keeping
from train.view.studio.asking import EXECUTIONS, file
from train.view.studio.controls import LABEL, VALUE, Place, bind, note, number, select
from train.view.studio.nice import ui
from train.view.studio.side import stem
from train.view.studio.state import Studio
from train.view.studio.window import Window

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
NUMBERS = {
    "rollouts": ("roll-outs", 10),
    "runs": ("runs", 1),
    "updates": ("updates", 50),
    "seed": ("seed", 0),
}
SHRINKS = {
    "all": "all of it is scaled (the paper)",
    "direction": "what offends is cut",
    "none": "as it is: stability may be lost",
}
FASTEST = 100.0  # updates a second
FILES: dict[str, tuple[str, Callable[[Studio], bytes]]] = {
    "Policy": (".pt", keeping.policies),
    "Demonstrations": (".npz", keeping.demonstrations),
    "Problem": (".json", keeping.problem),
    "Picture": (".svg", keeping.svg),
    "Picture in pixels": (".png", keeping.png),
    "Python script": (".py", keeping.program),
}


def learning(window: Window) -> None:
    """The two learners, and when they learn."""
    studio = window.studio
    with ui.element("div").classes("studio-row"):
        ui.button("Go", icon="play_arrow", on_click=lambda: window.attempt(lambda: studio.go(float(pace.value or 1))))
        ui.button("Pause", icon="pause", on_click=studio.pause)
        ui.button("Step", icon="skip_next", on_click=lambda: window.attempt(studio.step))
        ui.button("Reset", icon="replay", on_click=lambda: window.attempt(studio.reset))
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label("updates a second").style(LABEL)
        pace = ui.slider(min=1, max=FASTEST, step=1, value=25).props('aria-label="updates a second"')
        pace.on("change", lambda: hurry(studio, float(pace.value or 1)))
        ui.label().bind_text_from(pace, "value", lambda n: f"{n:.0f}").style(VALUE)
    learner(window, 0)
    second = ui.switch("compare with a second learner")
    bind(
        window,
        second,
        ("learners",),
        into=lambda learners: len(learners) > 1,
        out=lambda yes: [studio.problem.learners[0], *([contender(studio.problem)] if yes else [])],
    )
    with ui.column().style("gap: 6px; width: 100%") as column:
        learner(window, 1)
    window.tellers.append(lambda: column.set_visibility(len(studio.problem.learners) > 1))


def contender(problem: Problem) -> dict[str, str | int]:
    """The learner to compare with, to begin with: one with gradients where the trial has them."""
    if problem.walls:
        return {"optimizer": "surrogate", "updates": 50}
    return {"optimizer": "adam", "updates": 50, "shrink": "none"}


def hurry(studio: Studio, pace: float) -> None:
    """Another pace for those who learn already."""
    for side in studio.sides:
        if side.running:
            side.go(pace)


def learner(window: Window, index: int) -> None:
    """The options of a learner."""
    place: Place = ("learners", index)
    ui.label(f"Learner {'AB'[index]}").style("font-weight: 600")
    select(window, "optimizer", (*place, "optimizer"), OPTIMIZERS, "pibb")
    chosen = select(
        window,
        "exploration",
        (*place, "exploration"),
        EXPLORATIONS,
        into=lambda name: name or ("homogeneous" if window.studio.problem.condition == "none" else "stable"),
    )
    shrink = select(window, "stable noise", (*place, "shrink"), SHRINKS, "all")
    shrink.bind_visibility_from(chosen, "value", lambda name: str(name).startswith("stable"))
    with ui.element("div").classes("studio-row"):
        for name, (label, usual) in NUMBERS.items():
            number(window, label, (*place, name), usual, whole=True, min=0, precision=0)
        number(window, "noise", (*place, "noise"), placeholder="usual")
        number(window, "noise in costs", (*place, "cost_noise"), 0.0, min=0)


def pushing(window: Window) -> None:
    """The mass that can be pulled at."""
    studio = window.studio
    note("A mass of 1 kg follows the motion. Grab it with the last tool above the table and pull.")
    execution = ui.radio(EXECUTIONS, value="open").props("inline dense")
    with ui.element("div").classes("studio-row").style("flex-wrap: nowrap"):
        ui.label("stiffness [N/m]").style(LABEL)
        stiffness = ui.slider(min=5, max=1000, step=5, value=200).props('aria-label="stiffness of the mass"')
        ui.label().bind_text_from(stiffness, "value", lambda n: f"{n:.0f}").style(VALUE)
    note("Where the policy has a stiffness of its own, that is taken.")

    def begin() -> None:
        window.attempt(lambda: studio.push(execution.value, float(stiffness.value or 0)))

    window.push = begin
    execution.on_value_change(begin)
    stiffness.on("change", begin)
    with ui.element("div").classes("studio-row"):
        ui.button("From the start", on_click=begin)
        ui.button("Take it away", on_click=studio.let_go)
    with ui.element("div").classes("studio-row"):
        for name, direction in {"←": (-1, 0), "→": (1, 0), "↑": (0, 1), "↓": (0, -1)}.items():
            nudge(window, name, direction)
    applied = ui.label()  # it changes all the time: nothing to be read aloud

    def tell() -> None:
        mass = studio.pushed
        said = "" if mass is None else f"applied stiffness: {', '.join(f'{s:.0f}' for s in mass.applied)} N/m"
        applied.set_text(said)

    window.tellers.append(tell)


def nudge(window: Window, name: str, direction: tuple[int, int]) -> None:
    """A button that pulls for a moment."""
    ui.button(name, on_click=lambda: window.studio.nudge(direction)).props(f'aria-label="pull {name}"')


def taking(window: Window) -> None:
    """Files to take along, and a problem to bring."""
    for label, (ending, make) in FILES.items():
        download(window, f"{label} ({ending})", ending, make)
    bind(window, ui.input("name").props("dense debounce=400").style("width: 100%"), ("name",))
    file(window, "a problem (.json)", ".json")
    note("In a terminal, python -m train FILE.json learns a problem, with TensorBoard.")


def download(window: Window, label: str, ending: str, make: Callable[[Studio], bytes]) -> None:
    """A button that brings a file."""
    studio = window.studio

    def bring() -> None:
        window.attempt(lambda: ui.download.content(make(studio), f"{stem(studio.problem)}{ending}"))

    ui.button(label, icon="download", on_click=bring).props("align=left").style("width: 100%")
