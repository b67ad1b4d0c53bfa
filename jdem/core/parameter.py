"""What is known of one parameter, apart from its value: an entry of the catalogue.

Name, symbol, unit, what a law accepts, where a fit looks for it and what other programs call
it.  Entries stand beside the law that they belong to, in a tuple `PARAMETERS`;
`jdem.materials.catalogue` lists them all.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

INFINITE = float("inf")


@dataclass(frozen=True)
class Accepted:
    """The values that a law accepts: from `least` to `most`, or one of `choices`.

    An end belongs to it unless it is said to be open.
    """

    least: float = -INFINITE
    most: float = INFINITE
    least_open: bool = False
    most_open: bool = False
    choices: tuple[float, ...] = ()

    def __call__(self, value: float) -> bool:
        """Whether `value` (SI) is accepted."""
        if self.choices:
            return value in self.choices
        above = self.least < value if self.least_open else self.least <= value
        return above and (value < self.most if self.most_open else value <= self.most)


@dataclass(frozen=True)
class Search:
    """Where a fit looks for a parameter: between `low` and `high` (SI).

    prior_sd is the prior's standard deviation of ln p; calibrated_sd the same about a soil that
    was calibrated before, None if it is not varied then.
    """

    low: float
    high: float
    prior_sd: float
    calibrated_sd: float | None = None


@dataclass(frozen=True)
class Parameter:
    """One parameter; numbers are in `unit`, an SI unit ("" for a pure number).

    `label` says in a few words what it is; `repair` what to say where a value is not accepted;
    `search` is None where it is never fitted; `free` is False where a user does not set it;
    `names` has what it is called elsewhere, by program (EDEM as "section / name"; LIGGGHTS and
    Yade the property that it decides).
    """

    name: str
    symbol: str
    label: str
    accepted: Accepted
    repair: str
    unit: str = ""
    search: Search | None = None
    free: bool = True
    names: Mapping[str, str] = field(default_factory=dict)


POSITIVE = Accepted(0.0, least_open=True)
NOT_NEGATIVE = Accepted(0.0)
FRACTION = Accepted(0.0, 1.0, least_open=True, most_open=True)
