"""What a fit did not meet, and every sentence that it warns of.

    off = |simulated - measured| / sd,   sd of their difference

A number is missed where off > WARNED.  The largest number of a test, and a target, are missed also
where they are wrong by more than A_FIFTH and off > 1: half a peak is a miss, however much packings
scatter.  Everything here is read off plain data as result.json holds it, so that report, figure and
export say the same.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

WARNED = 3.0  # deviations beyond which a number is missed
A_FIFTH = 0.2  # of a target or of a test's largest number, which may not be wrong by more
STOOD = 0.01  # change of ln p below which a parameter stands where it began
WIDER = 1.25  # times that an interval may exceed the covariance's before it is said
LOWER = 0.5  # of the objective, by which a point of a profile shows that a fit stopped short


@dataclass(frozen=True)
class Miss:
    """A number that the fit does not meet."""

    name: str
    measured: float
    simulated: float
    sd: float

    @property
    def off(self) -> float:
        """Standard deviations between both; nothing where these are not known."""
        return abs(self.simulated - self.measured) / self.sd if self.sd > 0 else 0.0

    @property
    def wrong(self) -> bool:
        """Whether it is off by more than a number that has to be right may be."""
        return abs(self.simulated - self.measured) > A_FIFTH * abs(self.measured) and self.off > 1

    def __str__(self) -> str:
        return (
            f"the fit did not meet {self.name}: {self.simulated:.4g} for {self.measured:.4g} "
            f"measured, {self.off:.2g} standard deviations off"
        )


def misses(features: Mapping[str, Mapping]) -> list[Miss]:
    """What of the compared features is missed, numbers first."""
    every = {name: Miss(name, *_numbers(row)) for name, row in features.items()}
    found = [
        miss for name, miss in every.items()
        if miss.off > WARNED or (features[name].get("target") and miss.wrong)
    ]  # fmt: skip
    groups: dict[tuple[str, str], list[Miss]] = {}
    for name, row in features.items():
        if row.get("target") is False and row.get("test"):
            groups.setdefault((row["test"], name.split(" ")[0]), []).append(every[name])
    for (test, kind), group in groups.items():
        top = max(group, key=lambda miss: miss.measured)
        simulated = max(miss.simulated for miss in group)
        peak = Miss(f"the largest {kind} of {test}", top.measured, simulated, top.sd)
        if peak.wrong and top not in found:
            found.append(peak)
    return found


def _numbers(row: Mapping) -> list[float]:
    known = [row.get(key) for key in ("measured", "simulated", "sd")]
    return [float("nan") if value is None else float(value) for value in known]


def stood(free: Mapping[str, float], start: Mapping[str, float]) -> bool:
    """Whether every free parameter stands where the fit began."""
    return all(abs(np.log(value / start[name])) < STOOD for name, value in free.items())


def warnings(result: Mapping, further: Sequence[str] = ()) -> list[str]:
    """Every sentence that the result of a fit warns of, from its own entries, and further ones."""
    return [
        *_of_misses(result),
        *(f"{name} ended at its bound" for name in result["at_bound"]),
        *_of_packings(result),
        *_of_fresh(result),
        *_of_open_directions(result),
        *_of_profiles(result),
        *result["notes"],
        *further,
        *(["a contact list stayed too small in a run"] if result["quality"]["overflow"] else []),
    ]


def _of_misses(result: Mapping) -> Iterator[str]:
    found = misses(result["features"])
    yield from map(str, found)
    free = {name: result["parameters"][name] for name in result["free"]}
    if found and stood(free, result["history"][0]["parameters"]):
        yield f"the fit did not move: {', '.join(free)} stand where they began"
    if found and result["help"]:
        yield result["help"]


def _of_packings(result: Mapping) -> Iterator[str]:
    for packing in (*result["packings"]["fitted"], *result["packings"]["fresh"]):
        if packing["failure"]:
            yield f"packing {packing['seed']} failed: {packing['failure']}"


def _of_fresh(result: Mapping) -> Iterator[str]:
    """Observables that packings of which the fit saw nothing give otherwise."""
    fresh = result["fresh_packings"]
    for name, fitted in result["observables"].items():
        found, spread = fresh["observables"].get(name), fresh["spread"].get(name)
        if found and fitted and abs(found / fitted - 1) > A_FIFTH:
            scatter = "" if spread is None else f" ± {spread:.2g} (one packing)"
            yield (
                f"fresh packings give {name} {found:.4g}{scatter}, those of the fit {fitted:.4g}: "
                "it rests on too few packings; give a finer --preset"
            )


def _of_open_directions(result: Mapping) -> Iterator[str]:
    """Combinations that the data do not see, by the parameter that weighs most in each."""
    every = [d["weights"] for d in result["identifiability"]["directions"] if not d["seen_by_data"]]
    if every:
        names = dict.fromkeys(max(each, key=lambda name: abs(each[name])) for each in every)
        yield (
            f"the data leave open {len(every)} of {len(result['free'])} combinations of the free "
            f"parameters, mostly {', '.join(names)}"
        )


def _of_profiles(result: Mapping) -> Iterator[str]:
    """Where a parameter's profile is lower than the best point, or flatter than its interval."""
    found = result["identifiability"]
    for name, points in result["profiles"].items():
        best = min((p for p in points if not p["failure"]), key=lambda p: p["simulated"])
        centre = next(p["simulated"] for p in points if p["linearised"] == 0)
        if centre - best["simulated"] > LOWER:
            yield (
                f"the objective is lower at {name} = {best['value']:.4g} ({best['simulated']:.3g} "
                f"for {centre:.3g}): the fit stopped short of its best; go on from there with "
                f"--set {name}={best['value']:.4g}"
            )
        elif _wider(found["interval_95"][name], found["interval_95_linearised"][name]) > WIDER:
            yield (
                f"the interval of {name} is wider than its slopes say: along its profile the "
                "simulations change less"
            )
    cut = [
        name
        for name, ends in found["interval_95"].items()
        if set(ends) & set(found["bounds"].get(name, ()))
    ]
    if cut:
        yield f"intervals are cut at the bound of a fit: {', '.join(cut)}"


def _wider(interval: Sequence[float], linearised: Sequence[float]) -> float:
    """How many times wider one interval is than another, in ln p."""
    (low, high), (least, most) = np.log(interval), np.log(linearised)
    return float((high - low) / max(most - least, 1e-12))
