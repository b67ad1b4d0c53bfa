"""What the cases are: kind, effects and strengths, soil, packings; all from one secret seed.

Strata are in projected signal-to-noise: what is left of an effect's signature once calibration
has absorbed what it can, in units of the scatter of four specimens.  An effect that cannot
reach its stratum within the strengths that the library holds gives way to another one, and the
stratum stays; so weakly visible effects are rarer where the signal is large.  A plan goes by the
signatures that the library predicts, and prefers those that it takes for too large; what counts in
the end is the change that the laboratory itself sees with and without the effect, shrunk towards
the predicted one the more, the more packings differ (`expected_snr`).
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from calibrate.discrepancy.comparison.generated import SampleGenerator
from calibrate.discrepancy.comparison.noise import packing_covariance
from calibrate.discrepancy.comparison.probability_calibration import NONE
from calibrate.discrepancy.comparison.refit import refit, start_at
from calibrate.discrepancy.library.description import EmulatedLibrary, ModelDiscrepancy, describe
from calibrate.discrepancy.library.design import CENTRE, LIMITS, SOIL_PRIOR_SD
from calibrate.discrepancy.library.lab_size import soil_prior_of
from calibrate.discrepancy.library.simulate import resized
from calibrate.io.lab import Lab, bundled_lab, load_lab
from studies.sealed.outside import OUTSIDE

STRATA: dict[str, tuple[float, float]] = {
    "0.5-2": (0.5, 2.0),
    "2-6": (2.0, 6.0),
    "above 6": (6.0, 15.0),
}
OF_SHAPES = {"none": 12, "2-6": 6, "above 6": 12}  # cases of other sizes and largest stresses
COUNTS = {"none": 60, "0.5-2": 20, "2-6": 40, "above 6": 40, "outside": 25, "two": 15}
SPECIMENS = 4
PACKINGS = 3 * SPECIMENS  # of a case; those after the first four are for specimens held back
SPHERES = (*7 * (1100,), 2200)  # other numbers than the library's, as often as here
OF_OTHER_SIZES = SPHERES[:1]  # of a specimen of twice its diameter
POROSITIES = (-0.01, 0.005)  # over the usual one; others than the library's
SMOOTHING = -0.95  # roundings nearly gone
PACE = 0.3125  # the platen's speed in the mould over the library's fast one: 50 mm/s
POOL = 12  # packings of each number and porosity, from which cases draw
FIRST_SEED = 1_900_000  # of packings
ATTEMPTS = 6
STARTS = 3  # of fits beside that from the soil itself
FURTHEST = 2.0  # prior deviations of a soil
ACCEPTED_DEPTH, ACCEPTED_CRUSHING = (1.0, 8.0), (60.0, 650.0)  # mm, N, means over specimens


@dataclass(frozen=True)
class Beds:
    """From which beds cases draw: seeds of packings begin at `first_seed`; numbers of spheres, as
    often as they stand here; packings of each number and porosity, and those of one case."""

    first_seed: int = FIRST_SEED
    spheres: tuple[int, ...] = SPHERES
    pool: int = POOL
    packings: int = PACKINGS


@dataclass(frozen=True)
class SpecimenSize:
    """Diameter and height (m) of specimens, and the largest force (N) of the test in the mould."""

    diameter: float = 0.05
    height: float = 0.1
    force_high: float = 400.0

    def lab(self) -> Lab:
        """The bundled soil's tests on such specimens."""
        return resized(load_lab(bundled_lab()), self.diameter, self.height, self.force_high)

    @staticmethod
    def of_stress(diameter: float, height: float, kpa: float) -> "SpecimenSize":
        """Of a largest stress (kPa) in the mould."""
        return SpecimenSize(diameter, height, round(1e3 * kpa * np.pi / 4 * diameter**2, 2))


USUAL = SpecimenSize()
SHAPES = (  # other specimens, as laboratories have them
    SpecimenSize.of_stress(0.05, 0.06, 300.0),
    SpecimenSize.of_stress(0.05, 0.13, 100.0),
    SpecimenSize.of_stress(0.038, 0.076, 300.0),
    SpecimenSize.of_stress(0.07, 0.1, 100.0),
    SpecimenSize.of_stress(0.05, 0.1, 100.0),
    SpecimenSize.of_stress(0.07, 0.1, 300.0),
)


@dataclass(frozen=True)
class Hidden:
    """An effect at work; strength in SI, or in the unit that `outside` states."""

    name: str
    strength: float


@dataclass(frozen=True)
class WithheldCase:
    """One case; `soil` values by name in SI; `packings` of its specimens within their pool, those
    that no diagnosis sees last, whose seeds begin at first_seed; snr as planned."""

    name: str
    kind: str
    stratum: str
    snr: float
    hidden: tuple[Hidden, ...]
    soil: dict[str, float]
    spheres: int
    porosity: float
    packings: tuple[int, ...]
    seed: int
    nonce: str
    first_seed: int = FIRST_SEED
    size: SpecimenSize = USUAL

    def label(self, changes: np.ndarray) -> dict:
        """What is sealed: the case, and what its hidden effects do to features (n, m)."""
        expected_snr = asdict(self)
        planned = expected_snr.pop("snr")
        return {
            **expected_snr,
            "case": self.name,
            "planned_snr": planned,
            "changes": without_nan(changes),
        }


def without_nan(values: np.ndarray) -> list:
    """Values (n, m) as lists, None for NaN, which JSON lacks."""
    return [[x if np.isfinite(x) else None for x in row] for row in values.tolist()]


class Planner:
    """Draws cases, of each of the sizes in turn; the library tells how visible an effect is at a
    soil."""

    def __init__(
        self, emulated: EmulatedLibrary, seed: int, beds: Beds | None = None,
        sizes: Sequence[SpecimenSize] = (USUAL,),
    ):  # fmt: skip
        self.emulated, self.beds, self.sizes = emulated, beds or Beds(), sizes
        self.random = np.random.default_rng(seed)

    def cases(self, counts: dict[str, int] | None = None) -> list[list[WithheldCase]]:
        """For each case its attempts: the same effects in other soils and packings."""
        kinds = [kind for kind, count in (counts or COUNTS).items() for _ in range(count)]
        names = self.random.permutation(2**20)[: len(kinds)]
        order = self.random.permutation(len(kinds))
        return [
            self._attempts(f"{names[i]:05x}", kinds[k], self.sizes[k % len(self.sizes)])
            for i, k in enumerate(order)
        ]

    def _attempts(self, name: str, kind: str, size: SpecimenSize) -> list[WithheldCase]:
        first = self._case(name, kind, size, None)
        return [first, *(self._case(name, kind, size, first) for _ in range(ATTEMPTS - 1))]

    def _case(
        self, name: str, kind: str, size: SpecimenSize, like: WithheldCase | None
    ) -> WithheldCase:
        soil, beds = self._soil(), self.beds
        if like is not None:
            hidden, snr = like.hidden, like.snr
        else:
            hidden, snr = self._hidden(kind, soil, size)
        stratum = kind if kind in STRATA else ""
        return WithheldCase(
            name=name,
            kind={"none": NONE, "outside": "outside", "two": "two"}.get(kind, "single"),
            stratum=stratum,
            snr=snr,
            hidden=hidden,
            soil=soil,
            spheres=int(self.random.choice(beds.spheres if size == USUAL else OF_OTHER_SIZES)),
            porosity=float(self.random.choice(POROSITIES)),
            packings=tuple(int(p) for p in self.random.permutation(beds.pool)[: beds.packings]),
            seed=int(self.random.integers(2**31)),
            nonce=self.random.bytes(16).hex(),
            first_seed=beds.first_seed,
            size=size,
        )

    def _soil(self) -> dict[str, float]:
        values = {}
        for name, sd in SOIL_PRIOR_SD.items():
            away = FURTHEST + 1
            while abs(away) > FURTHEST:
                away = self.random.standard_normal()
            values[name] = float(CENTRE[name] * np.exp(sd * away))
        values["plasticity_ratio"] = min(values["plasticity_ratio"], 0.82)
        return values

    def _hidden(
        self, kind: str, soil: dict[str, float], size: SpecimenSize
    ) -> tuple[tuple[Hidden, ...], float]:
        if kind == "none":
            return (), 0.0
        if kind == "outside":
            name = list(OUTSIDE)[int(self.random.integers(len(OUTSIDE)))]
            low, high = OUTSIDE[name]
            strength = float(low * (high / low) ** self.random.uniform())
            sign = self.random.choice([-1.0, 1.0]) if name == "height_gradient" else 1.0
            return (Hidden(name, sign * strength),), 0.0
        visible = Visibility(self.emulated, soil, size=size)
        if kind == "two":
            return self._two(visible)
        while True:
            snr = float(np.exp(self.random.uniform(*np.log(STRATA[kind]))))
            found = self._one(visible, snr)
            if found is not None:
                return (found,), visible.snr({found.name: found.strength})

    def _one(self, visible: "Visibility", snr: float, without: Sequence[str] = ()) -> Hidden | None:
        name = str(self.random.choice([n for n in LIMITS if n not in without]))
        low, high = LIMITS[name]
        limit = high if low >= 0 or self.random.random() < 0.5 else low
        strength = visible.strength(name, limit, snr)
        return None if strength is None else Hidden(name, strength)

    def _two(self, visible: "Visibility") -> tuple[tuple[Hidden, ...], float]:
        found: list[Hidden] = []
        while len(found) < 2:
            snr = float(np.exp(self.random.uniform(*np.log((4.0, 12.0)))))
            one = self._one(visible, snr, [h.name for h in found])
            found += [one] if one is not None else []
        return tuple(found), visible.snr({h.name: h.strength for h in found})


def relative_error(
    predicted: Sequence[float], scatter: Sequence[float], away: Sequence[float]
) -> float:
    """How wrong predicted changes are, as a share r^2 of their squared lengths |p_i|^2:

        |c_i - p_i|^2 = r^2 |p_i|^2 + V_i         least squares, weights 1/(|p_i|^2 + V_i)^2

    over cases with the same effects, c_i being mean changes that packings scatter by V_i
    (empirical Bayes, Efron and Morris 1973: one case's own error is mostly chance, since often
    one of four packings slips)."""
    length, chance, apart = (np.array(each) for each in (predicted, scatter, away))
    weight = (length + chance) ** -2.0
    r2 = weight @ (length * (apart - chance)) / (weight @ length**2)
    return max(float(r2), 0.0)


class Visibility:
    """Projected signal-to-noise of effects at one soil, for a number of full specimens; `seen`:
    which of the curves' features (m,) these have, all where it is not given."""

    def __init__(
        self, emulated: EmulatedLibrary, soil: dict[str, float], specimens: int = SPECIMENS,
        discrepancy: ModelDiscrepancy | None = None, size: SpecimenSize = USUAL,
        seen: np.ndarray | None = None,
    ):  # fmt: skip
        emulated = emulated.for_lab(size.lab())
        every = np.arange(len(emulated.library.features) - 2)  # curves; targets follow from them
        every = every if seen is None else every[seen]
        soil_prior = soil_prior_of(emulated.library, soil, PACE, shape=emulated.size.shape)
        design = emulated.library.design
        values = emulated.at(soil_prior)(
            np.zeros(len(soil_prior.offset)), np.zeros(len(design.limits))
        )[0]
        self.description = describe(
            emulated, soil_prior, values[every], every, discrepancy=discrepancy
        )
        plan = np.ones((specimens, len(every)), bool)
        self.generator = SampleGenerator(
            self.description, plan, packing_covariance(self.description)
        )
        self.typical = dict(zip(design.effect_names, emulated.typical, strict=True))

    def snr(self, strengths: dict[str, float]) -> float:
        """Signal-to-noise of effects of these strengths (SI) together."""
        return float(self.generator.snr(self.change(strengths)[:, None])[0])

    def change(self, strengths: dict[str, float]) -> np.ndarray:
        """What the library says that these effects do to the features (m,)."""
        d = self.description
        given = np.array([strengths.get(n, 0.0) / self.typical[n] for n in d.effect_names])
        zero = np.zeros(len(d.prior_sd))
        return d.at(zero, given)[0] - d.at(zero, np.zeros(len(given)))[0]

    def realised(self, changes: np.ndarray) -> float:
        """Signal-to-noise of the change that changes (n, m) of the curves' features, one for each
        of n packings, speak for: what calibration leaves of their mean, less what packings differ
        by (jackknife)."""
        count, whole = len(changes), self.left(changes.mean(axis=0)) ** 2
        without = [self.left(np.delete(changes, i, axis=0).mean(axis=0)) ** 2 for i in range(count)]
        return float(np.sqrt(max(whole - (count - 1) * (np.mean(without) - whole), 0.0)))

    def expected_snr(self, changes: np.ndarray, predicted: np.ndarray, error: float) -> float:
        """The same where a change p (m,) is predicted that may be wrong by a share r^2 = error of
        its squared length (`relative_error`): what calibration leaves of the change to be expected
        once the mean c of the simulated ones is known,

            p + T/(T + V) (c - p)       T = r^2 |p|^2       V: `scatter`

        What is known of it, and no more: the true change is longer by T V/(T + V) on average, in
        square and but for calibration."""
        wrong = error * self.length(predicted)
        share = wrong / max(wrong + self.scatter(changes), 1e-300)
        return self.left(predicted + share * (changes.mean(axis=0) - predicted))

    def length(self, change: np.ndarray) -> float:
        """Squared length of a change (m,), projected."""
        return float((self.generator.projected(change[:, None]) ** 2).sum())

    def scatter(self, changes: np.ndarray) -> float:
        """Sum of squares by which the mean of changes (n, m) is off as packings differ: V =
        sum_i |c_i - c|^2/(n (n - 1)), projected."""
        count = len(changes)
        off = self.generator.projected((changes - changes.mean(axis=0)).T)
        return float((off**2).sum() / (count * (count - 1)))

    def left(self, change: np.ndarray) -> float:
        """What calibration leaves of a change (m,) of the features, in units of scatter: not as
        far as slopes at the soil can mimic it, but as far as any soil can."""
        d = self.description
        values = d.at(np.zeros(len(d.prior_sd)), np.zeros(len(d.effects)))[0] + change
        rng = np.random.default_rng(0)
        away = [None, *(d.prior_sd * rng.standard_normal((STARTS, len(d.prior_sd))))]
        fits = [refit(d, values, self.generator.mean_covariance, (), start_at(d, x)) for x in away]
        return float(np.sqrt(min(fit.objective for fit in fits)))

    def strength(self, name: str, limit: float, snr: float) -> float | None:
        """The strength (SI) towards `limit` with this signal-to-noise; None if out of reach."""
        if self.snr({name: limit}) < snr:
            return None
        low, high = 0.0, 1.0
        for _ in range(25):
            middle = (low + high) / 2
            low, high = (middle, high) if self.snr({name: middle * limit}) < snr else (low, middle)
        return float(high * limit)
