"""A design: the points at which an experiment is run, and the order of its runs.

Rows stand in the standard order of the design's construction; `run_order` says when each is
run.  Dummy columns of a screening design belong to no factor: what looks like their effect is
noise and aliased interactions.

`write_csv` makes a run sheet for an experiment that is run elsewhere; `calibrate.designs.runsheet`
reads it back.
"""

import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from calibrate.core.errors import BadValue
from calibrate.core.files import whole
from calibrate.designs.factors import Factor, natural_points

CODED = "(coded)"  # what follows a factor's name in the heading of its coded column


@dataclass(frozen=True, eq=False)
class Design:
    """Coded points (n, p) of `factors` (p), with dummy columns (n, d) where there are any.

    `kind` is the name of the construction; run_order (n,) holds the number, from 1, of each
    row's run.  `BadValue` if shapes do not agree or two factors share a name.
    """

    factors: tuple[Factor, ...]
    coded: np.ndarray
    kind: str
    dummies: np.ndarray = field(default_factory=lambda: np.zeros((0, 0)))
    run_order: np.ndarray = field(default_factory=lambda: np.zeros(0, int))

    def __post_init__(self):
        coded = np.array(self.coded, float)
        if coded.ndim != 2 or coded.shape[1] != len(self.factors):
            problem = f"points of shape {coded.shape} for {len(self.factors)} factors"
            raise BadValue(problem, "give one column for each factor", "coded")
        if len(set(self.names)) < len(self.factors):
            raise BadValue("two factors share a name", "give each its own", "factors")
        dummies = self.dummies if self.dummies.size else np.zeros((len(coded), 0))
        order = self.run_order if self.run_order.size else np.arange(1, len(coded) + 1)
        if sorted(order) != list(range(1, len(coded) + 1)) or len(dummies) != len(coded):
            raise BadValue("rows do not agree with the points", "give one for each", "run_order")
        for name, value in (("coded", coded), ("dummies", dummies), ("run_order", order)):
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        return len(self.coded)

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(factor.name for factor in self.factors)

    @property
    def dummy_names(self) -> tuple[str, ...]:
        return tuple(f"dummy_{number + 1}" for number in range(self.dummies.shape[1]))

    @property
    def centre(self) -> np.ndarray:
        """Which rows (n,) lie at the centre of every factor."""
        return np.all(self.coded == 0, axis=1)

    def natural(self) -> np.ndarray:
        """The points (n, p) in each factor's own unit."""
        return natural_points(self.factors, self.coded)

    def randomised(self, seed: int) -> "Design":
        """The same points, to be run in a random order that `seed` fixes."""
        order = np.random.default_rng(seed).permutation(len(self)) + 1
        return replace(self, run_order=order)

    def replicated(self, times: int) -> "Design":
        """Every point `times` times, one whole repeat after the other."""
        dummies = np.tile(self.dummies, (times, 1))
        return replace(
            self,
            coded=np.tile(self.coded, (times, 1)),
            dummies=dummies,
            run_order=np.arange(1, times * len(self) + 1),
        )

    def write_csv(self, path: Path, responses: Sequence[str] = ("response",)) -> None:
        """A run sheet in the order of the runs, with an empty column for each response.

        Lines that begin with # describe the design and its factors; keep them, and fill in the
        responses.
        """
        with whole(Path(path)) as part, part.open("w", newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(self._sheet(responses))

    def _sheet(self, responses: Sequence[str]) -> Iterator[list]:
        yield ["#design", self.kind]
        for f in self.factors:
            scale = "log" if f.log else "linear"
            yield ["#factor", f.name, f.unit, repr(float(f.low)), repr(float(f.high)), scale]
        labels = [f.label for f in self.factors]
        coded = [f"{name} {CODED}" for name in self.names]
        yield ["run", "point", *labels, *coded, *self.dummy_names, *responses]
        natural = self.natural()
        for row in np.argsort(self.run_order):
            numbers = [*natural[row], *self.coded[row], *self.dummies[row]]
            texts = [f"{number:.12g}" for number in numbers]
            yield [int(self.run_order[row]), int(row) + 1, *texts, *[""] * len(responses)]
