"""Best fits of all explanations: none, each effect, pairs of the leading ones.

Each is made with the noise at the base fit, then with that at its own location, and again where
that moves it; it is weighed by the noise where it ends, not where it came from.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from calibrate.core.progress import Silent
from calibrate.discrepancy.comparison.evidence import Evidence
from calibrate.discrepancy.comparison.linear import Linearised
from calibrate.discrepancy.comparison.noise import Noise, estimate
from calibrate.discrepancy.comparison.projection import admissible, fitted_shift, lengths
from calibrate.discrepancy.comparison.refit import (
    Refit,
    Start,
    local_minima,
    refit,
    start_at,
    weighed,
)
from calibrate.discrepancy.comparison.repeats import Measured
from calibrate.simulation import side_by_side

REFITTED = 3  # leading effects whose pairs are refitted
BEGINNINGS = (0.35, 0.9)  # of an effect's reach, from which it is refitted too
ELSEWHERE = 4  # further soils, drawn from the prior, from which the base fit starts
MOVES = 2  # of a fit, at most, to where the noise at its location leads
MINIMA = 3  # different fits of one explanation that are weighed by their own noise
HOPELESS = 12.0  # above the likeliest before any moves; minus twice the log density, as below
SETTLED = 0.1  # fall in a move after which there is no other

Fits = dict[tuple[int, ...], Refit]


def fitted_base(
    d: Linearised, measured: Measured, packing: np.ndarray, inflation: float
) -> tuple[Noise, Refit]:
    """The noise of a sample and the fit of the base parameters alone; packing (m, m): covariance
    of simulated specimens."""
    noise = estimate(d, measured, packing, d.prior_sd**2)
    base = refit(d, measured.mean, inflation * noise.mean)
    spread = fitted_shift(base.working, base.base_slopes, d.prior_sd, noise.mean)[1]
    noise = estimate(d, measured, packing, base.delta**2 + np.diag(spread))
    starts = [start_at(d), start_at(d, base.delta)]
    if d.emulator is not None:
        drawn = np.random.default_rng(0).normal(size=(ELSEWHERE, len(d.prior_sd)))
        starts += [start_at(d, d.prior_sd * shift) for shift in drawn]
    return noise, _Fitter(d, measured.mean, noise, inflation).likeliest((), starts)


def covariance_at(d: Linearised, noise: Noise, fit: Refit) -> np.ndarray:
    """Covariance (m, m) of measured minus simulated mean, with what the description is wrong by
    at the fit in place of what it is wrong by at its own centre."""
    here = d.wrong_at(fit.delta, fit.strengths)
    return noise.mean - d.wrong @ d.wrong.T + here @ here.T


def all_fits(
    d: Linearised,
    measured: np.ndarray,
    noise: Noise,
    inflation: float,
    base: Refit,
    first: Evidence,
) -> Fits:
    """Fits to means (m,) with each effect (without an emulator: with the leading ones), with the
    pairs of the leading effects, the best one with its companions, and the leading pair."""
    fitter = _Fitter(d, measured, noise, inflation)
    order = [int(k) for k in np.argsort(-first.singles)]
    alone = order if d.emulator is not None else order[:REFITTED]

    def single(number: int) -> Refit:
        k = alone[number]
        return fitter.likeliest((k,), _starts(d, base, k), [base])

    fits: Fits = {(k,): fit for k, fit in zip(alone, _each(single, len(alone)), strict=True)}
    lead = sorted(alone, key=lambda k: fits[(k,)].objective)[:REFITTED]
    chosen = [(i, j) for n, i in enumerate(lead) for j in lead[n + 1 :]]
    if lead:
        chosen += [(lead[0], j) for j in _companions(d, fits[(lead[0],)])]
    if len(first.pairs):
        i, j = first.pair_index[int(np.argmax(first.pairs))]
        chosen.append((int(i), int(j)))
    pairs = list(dict.fromkeys((min(key), max(key)) for key in chosen))

    def pair(number: int) -> Refit:
        parts = [base, *(fits[(k,)] for k in pairs[number] if (k,) in fits)]
        starts = [(fit.delta, fit.strengths) for fit in parts]
        return fitter.likeliest(pairs[number], starts, parts)

    return fits | dict(zip(pairs, _each(pair, len(pairs)), strict=True))


def _each(fitted: Callable[[int], Refit], count: int) -> list[Refit]:
    """So many fits, in threads: most of the time they wait for the description's values."""
    return side_by_side(fitted, count, Silent(), "")


def _starts(d: Linearised, base: Refit, effect: int) -> Iterator[Start]:
    """Starts with one effect: without it and, where it is not linear, from several strengths with
    the soil of the base fit, which may be far off where an effect is strong, and the prior's."""
    yield start_at(d, base.delta)
    if d.emulator is None:
        return
    candidate = d.effects[effect]
    signs = (1.0,) if candidate.one_sided else (1.0, -1.0)
    for delta, share, sign in product((base.delta, None), BEGINNINGS, signs):
        yield start_at(d, delta, effect, sign * share * candidate.reach)


@dataclass(frozen=True, eq=False)
class _Fitter:
    """Fits explanations to one sample."""

    d: Linearised
    measured: np.ndarray
    noise: Noise
    inflation: float

    def likeliest(
        self, key: tuple[int, ...], starts: Iterable[Start], parts: Sequence[Refit] = ()
    ) -> Refit:
        """The likeliest of the best fits from some starts, each weighed by the noise at its own
        location and moved to where this leads, and of those of its parts, with fewer effects."""
        covariance = self.inflation * self.noise.mean
        found = local_minima(self.d, self.measured, covariance, key, starts)[:MINIMA]
        every = [self._weighed(fit) for fit in found]
        of_parts = [self._weighed(replace(part, chosen=key)) for part in parts]
        least = min(map(self._unlikely, [*every, *of_parts]))
        hopeful = [fit for fit in every if self._unlikely(fit) <= least + HOPELESS]
        best = min([*map(self._moved, hopeful), *of_parts], key=self._unlikely)
        return self._moved(best) if best in of_parts else best

    def _moved(self, fit: Refit) -> Refit:
        """The fit, moved to where the noise at its location leads while that is likelier."""
        for _ in range(MOVES if self.d.emulator is not None else 0):
            start, own = (fit.delta, fit.strengths), self.inflation * fit.covariance
            moved = self._weighed(refit(self.d, self.measured, own, fit.chosen, start))
            gain = self._unlikely(fit) - self._unlikely(moved)
            fit = moved if gain > 0 else fit
            if gain < SETTLED:
                break
        return fit

    def _weighed(self, fit: Refit) -> Refit:
        """The same point, weighed by the noise there."""
        own = covariance_at(self.d, self.noise, fit)
        return replace(weighed(self.d, self.measured, self.inflation * own, fit), covariance=own)

    def _unlikely(self, fit: Refit) -> float:
        """Minus twice the log posterior density, up to a constant."""
        return fit.objective + float(np.linalg.slogdet(self.inflation * fit.covariance)[1])


def _companions(d: Linearised, fit: Refit) -> list[int]:
    """The two effects that would help most beside the fitted one."""
    on = list(fit.chosen)
    design = fit.projected(fit.covariance)
    unit = design.effects[:, on] / lengths(design.effects[:, on])
    others = design.effects - unit @ (unit.T @ design.effects)
    left = design.residual - unit @ (unit.T @ design.residual)
    score = admissible(others.T @ left / lengths(others), d.one_sided)
    score[on] = -np.inf
    return [int(k) for k in np.argsort(-score)[:2] if k not in on]
