"""A drawn problem in the plane as one JSON file: what was drawn, what is asked of the motion, and what shall learn it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from tasks.sketch.kinds import Kind, many, maybe, number, one_of, options, record, rising_rows, text, whole, window
from torchds import Demonstrations
from torchds.errors import FileError, InvalidArgumentError, UnknownNameError
from torchds.files import existing, read_json, write_text

MARK, VERSION = "problem", 1
HEADER = ("torchds", "version")
LARGEST = 1e6  # of a coordinate, a size or a weight; more is a mistake, and squares of it stay far from overflow
CLOCK = 1e10  # s, of a time stamp; dates fit
MOST_POINTS, MOST_STROKES, MOST = 5000, 50, 100
MOST_BYTES = 50_000_000

coordinate = number(-LARGEST, LARGEST)
point = many(coordinate, 2, 2, "coordinates")
stroke = rising_rows(MOST_POINTS, CLOCK, LARGEST)
amount, size = number(0.0, LARGEST), number(1e-6, LARGEST)


REGION = record(center=(point, None), radius=(size, None))
WEIGHTS = record(
    via_points=(amount, 1.0),
    goal=(amount, 1.0),
    acceleration=(amount, 1e-4),
    path_length=(amount, 0.0),
    regions=(amount, 1.0),
    stiffness=(amount, 0.0),
)
BODY = record(
    mass=(size, 1.0),
    damping=(amount, 1.0),
    stiffness=(size, 200.0),
    execution=(one_of("open", "closed", "passive"), "open"),
    field=(one_of("none", "constant", "divergent"), "none"),
    force=(point, (0.0, 0.0)),
    gain=(coordinate, 0.0),
)


def _kept(kind: Kind, usual: Any) -> Any:
    """A field of a kind, with what it is where a file does not say it."""
    return field(default_factory=lambda: usual, metadata={"kind": kind})


@dataclass(frozen=True)
class Problem:
    """What was drawn, what is asked of the motion, and what shall learn it; plain values, checked wherever one is made.

    Lists are kept as tuples, objects as dicts with all their names; `dataclasses.replace` makes a changed one.

    Attributes:
        name: what people call it.
        unit: of positions.
        strokes: rows (t [s], x1, x2) of each, as a pointer gave them: any clock, uneven steps. Of points with one time stamp
            the first is kept.
        samples: of each demonstration after resampling.
        smoothing: window of `Demonstrations.smooth` in samples, odd; 0 for none.
        duration: that every demonstration is stretched to [s]; None for its own.
        components: Gaussians of the mixture.
        condition: of stability, see `torchds.fit_stable`; "none" for a mixture as it is.
        start: where the motion begins; None for the mean start of the demonstrations.
        goal: where all demonstrations are moved to end; None for the mean end of the demonstrations as they are.
        via_points: to pass through.
        walls: the two ends of each; a motion that meets one stays there, with a body the point mass.
        regions: discs to stay out of, each with `center` and `radius`.
        weights: of the cost terms by name.
        body: a point mass that follows the motion, with its controller and the field of force around it; None for none.
        learners: options of the training command, of one learner or of two to compare.

    Raises:
        InvalidArgumentError: a value out of its range, of a wrong kind or shape; says which one.
        UnknownNameError: a name that does not exist.
    """

    name: str = _kept(text(100), "A drawing")
    unit: str = _kept(text(20), "")
    strokes: tuple[tuple[tuple[float, float, float], ...], ...] = _kept(many(stroke, 0, MOST_STROKES, "strokes"), ())
    samples: int = _kept(whole(10, 2000), 101)
    smoothing: int = _kept(window, 0)
    duration: float | None = _kept(maybe(number(1e-3, LARGEST)), None)
    components: int = _kept(whole(1, 12), 4)
    condition: str = _kept(one_of("none", "seds", "p-qlf"), "none")
    start: tuple[float, float] | None = _kept(maybe(point), None)
    goal: tuple[float, float] | None = _kept(maybe(point), None)
    via_points: tuple[tuple[float, float], ...] = _kept(many(point, 0, MOST, "points"), ())
    walls: tuple[tuple[tuple[float, float], tuple[float, float]], ...] = _kept(
        many(many(point, 2, 2, "ends"), 0, MOST, "walls"), ()
    )
    regions: tuple[Mapping[str, Any], ...] = _kept(many(REGION, 0, MOST, "regions"), ())
    weights: Mapping[str, float] = _kept(WEIGHTS, {})
    body: Mapping[str, Any] | None = _kept(maybe(BODY), None)
    learners: tuple[Mapping[str, Any], ...] = _kept(many(options, 1, 2, "learners"), ({},))

    def __post_init__(self) -> None:
        for each in fields(self):
            object.__setattr__(self, each.name, each.metadata["kind"](each.name, getattr(self, each.name)))
        if self.smoothing > self.samples:
            raise InvalidArgumentError(
                f"smoothing has to be at most the {self.samples} samples of a demonstration, got {self.smoothing}"
            )

    # ------------------------------------------------------------------ files

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> Self:
        """What `to_json` gave; what is not there is as usual.

        Raises:
            InvalidArgumentError: no problem, one of a later version, or a value that is not allowed.
            UnknownNameError: a name that does not exist.
        """
        if not isinstance(values, Mapping) or values.get("torchds") != MARK:
            raise InvalidArgumentError(
                f'a problem has to be an object with "torchds": "{MARK}" in it, got something else'
            )
        if values.get("version", VERSION) != VERSION:
            raise InvalidArgumentError(
                f"version has to be {VERSION}, got {values['version']!r}; a later one needs a newer torchds"
            )
        known = [each.name for each in fields(cls)]
        for name in values:
            if name not in known and name not in HEADER:
                raise UnknownNameError("name in a problem", str(name), known)
        return cls(**{name: value for name, value in values.items() if name in known})

    def to_json(self) -> dict[str, Any]:
        """Plain values as they stand in a file."""
        own = {each.name: _lists(getattr(self, each.name)) for each in fields(self)}
        return {"torchds": MARK, "version": VERSION, **own}

    @classmethod
    def read(cls, path: str | Path) -> Self:
        """The problem in a file.

        Raises:
            FileError: there is none, or it is no JSON.
            InvalidArgumentError: see `from_json`; the message names the file.
        """
        if (n := existing(path).stat().st_size) > MOST_BYTES:
            raise FileError(f"{path} is no problem file: it has {n} bytes, and at most {MOST_BYTES} are read")
        content = read_json(path)
        try:
            return cls.from_json(content)
        except (InvalidArgumentError, UnknownNameError) as error:
            raise InvalidArgumentError(f"{path}: {error}") from error

    def write(self, path: str | Path) -> None:
        """Write a file to be read and edited by people, whole or not at all.

        Raises:
            FileError: it cannot be written.
        """
        lines = [f"  {json.dumps(name)}: {_written(value)}" for name, value in self.to_json().items()]
        write_text(path, "{\n" + ",\n".join(lines) + "\n}\n")

    # ------------------------------------------------------------------ motions

    def demonstrations(self) -> Demonstrations:
        """The strokes at equal time steps, smoothed and stretched, where they were drawn.

        Raises:
            InvalidArgumentError: nothing is drawn.
        """
        if not self.strokes:
            raise InvalidArgumentError("nothing is drawn: a problem needs at least one stroke to learn from; draw one")
        drawn = [np.array(stroke) for stroke in self.strokes]
        demos = Demonstrations.from_samples(
            [rows[:, 0] for rows in drawn],
            [rows[:, 1:] for rows in drawn],
            n_samples=self.samples,
            kind="linear",
            units=self.unit,
        )
        demos = demos.smooth(self.smoothing) if self.smoothing else demos
        return demos if self.duration is None else demos.retime(self.duration)


def _lists(value: Any) -> Any:
    """Tuples as lists, as JSON has them."""
    if isinstance(value, dict):
        return {name: _lists(each) for name, each in value.items()}
    return [_lists(each) for each in value] if isinstance(value, tuple) else value


def _written(value: Any) -> str:
    """A value on one line; a list of lists or objects with a line for each."""
    if isinstance(value, list) and any(isinstance(each, (list, dict)) for each in value):
        return "[\n" + ",\n".join(f"    {json.dumps(each)}" for each in value) + "\n  ]"
    return json.dumps(value)
