"""What the cases are: how many of each kind, which effect how strong, which soil, which seeds.

Everything follows from one seed that is sealed with the labels.  Acceptance is stated here and
does not look at the effect: a case in which a specimen falls apart, or whose mean depression
depth or crushing force leaves the range that soils show, gets another soil and other packings
and keeps its effect.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass

import numpy as np

from studies.liggghts.effects import BY_NAME, LIBRARY, OUTSIDE, Setup
from studies.liggghts.soil import Soil, draw_soil

SHARES = {"none": 0.24, "outside": 0.18, "two": 0.04}  # the rest: one effect of the library
SPECIMENS = 3  # of each case; each gives both curves
ACCEPTED_DEPTH = (1.0, 8.0)  # mm, mean of the specimens, from the raw curves
ACCEPTED_CRUSHING = (50.0, 650.0)  # N
ATTEMPTS = 6
THIRDS = (0, 1, 2)  # of a range of strengths that single effects visit; 2 is the strong one


@dataclass(frozen=True)
class Hidden:
    """One effect at work; strength in the unit that `effects` states."""

    name: str
    strength: float


@dataclass(frozen=True)
class Case:
    """One case; `seed` gives soil, packings and noise of every attempt."""

    name: str
    kind: str
    hidden: tuple[Hidden, ...]
    seed: int
    nonce: str

    def setup(self, attempt: int) -> Setup:
        """Soil, physics and instrument of one attempt."""
        random = np.random.default_rng([self.seed, attempt])
        setup = Setup(draw_soil(random))
        setup = setup.with_instrument(
            noise_force=float(0.5 * np.exp(0.3 * random.standard_normal()))
        )
        for effect in self.hidden:
            setup = BY_NAME[effect.name].realise(setup, effect.strength)
        return setup

    def specimen_seed(self, attempt: int, specimen: int) -> int:
        """Seed of the packing and moisture of one specimen."""
        return int(np.random.default_rng([self.seed, attempt, specimen]).integers(2**31))

    def label(self, attempt: int) -> dict:
        """What is sealed."""
        soil: Soil = self.setup(attempt).soil
        units = {effect.name: effect.unit for effect in (*LIBRARY, *OUTSIDE)}
        effects = [{**asdict(h), "unit": units[h.name]} for h in self.hidden]
        return {
            "case": self.name, "kind": self.kind, "effects": effects, "soil": asdict(soil),
            "conventions": "liggghts", "seed": self.seed, "attempt": attempt, "nonce": self.nonce,
        }  # fmt: skip


def plan(
    count: int, seed: int, nothing_hidden: bool = False, thirds: tuple[int, ...] = THIRDS
) -> list[Case]:
    """`count` cases; every beginning of the list holds the kinds in about their shares, or
    (for learning what the two codes differ by) nothing is hidden in any."""
    random = np.random.default_rng(seed)
    kinds = [("none", ())] * count if nothing_hidden else _kinds(count, random, thirds)
    cases = []
    for kind, hidden in kinds:
        numbers = random.integers(2**31, size=3)
        case = Case(f"{int(numbers[0]):08x}", kind, hidden, int(numbers[1]), _nonce(random))
        cases.append(case)
    if len({case.name for case in cases}) < count:
        return plan(count, seed + 1, nothing_hidden, thirds)
    return cases


def _nonce(random: np.random.Generator) -> str:
    return random.bytes(16).hex()


def _kinds(
    count: int, random: np.random.Generator, thirds: tuple[int, ...]
) -> list[tuple[str, tuple[Hidden, ...]]]:
    """Kinds and effects, mixed so that each kind is spread evenly over the list."""
    number = {kind: round(share * count) for kind, share in SHARES.items()}
    number["library"] = count - sum(number.values())
    source = {
        "none": _nothing(),
        "library": _single(LIBRARY, random, thirds),
        "outside": _single(OUTSIDE, random, thirds),
        "two": _double(random),
    }
    placed: list[tuple[float, str, tuple[Hidden, ...]]] = []
    for kind, many in number.items():
        for rank in range(many):
            place = (rank + random.uniform()) / many
            placed.append((place, kind, next(source[kind])))
    return [(kind, hidden) for _, kind, hidden in sorted(placed, key=lambda row: row[0])]


def _nothing() -> Iterator[tuple[Hidden, ...]]:
    while True:
        yield ()


def _single(
    effects, random: np.random.Generator, thirds: tuple[int, ...]
) -> Iterator[tuple[Hidden, ...]]:
    """Every effect in turn, in random order, each time with the next of the thirds."""
    offsets = random.integers(3, size=len(effects))
    turn = 0
    while True:
        for index in random.permutation(len(effects)):
            strength = effects[index].draw(random, thirds[int(offsets[index] + turn) % len(thirds)])
            yield (Hidden(effects[index].name, strength),)
        turn += 1


def _double(random: np.random.Generator) -> Iterator[tuple[Hidden, ...]]:
    """Two different effects of the library, both from the upper two thirds."""
    while True:
        chosen = random.choice(len(LIBRARY), 2, replace=False)
        yield tuple(
            Hidden(LIBRARY[i].name, LIBRARY[i].draw(random, int(random.integers(1, 3))))
            for i in chosen
        )


def accepted(depth_mm: list[float], crushing_n: list[float]) -> bool:
    """Do the specimens' mean depth and crushing force lie where soils lie?"""
    depth, force = float(np.mean(depth_mm)), float(np.mean(crushing_n))
    low, high = ACCEPTED_DEPTH
    weak, strong = ACCEPTED_CRUSHING
    return low <= depth <= high and weak <= force <= strong
