"""The file of a posterior's draws, posterior.nc: how it is made, and soils as others read them.

It is ArviZ' InferenceData: groups posterior, prior, posterior_predictive, observed_data and
sample_stats.  What would be measured of a draw holds the errors of the response and of runs, and
the scatter of repeats.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import xarray as xr
from jax import Array
from scipy.stats import chi2

from calibrate.core.errors import InputError
from calibrate.core.files import whole
from calibrate.inference.identifiability import IDENTIFIED
from calibrate.inference.on_response import FeaturesOfBeds
from calibrate.inference.posterior import Density, Question
from calibrate.inference.sampling import ESS, PART, RHAT, Sampled, mixing, values_of
from calibrate.io.lab import Lab
from calibrate.io.soil import base_soil, with_values
from calibrate.simulation.specimens import soil_json
from jdem.materials.conventions import CONVENTIONS
from jdem.materials.soil import SoilParameters
from jdem.physics import PHYSICS

FILE = "posterior.nc"
CURVES = 60  # draws of which curves are kept
NETCDF = "h5netcdf"


@eqx.filter_jit
def _predicted(density: Density, values: Array, noise: Array) -> tuple[Array, ...]:
    """Of parameters (n, p): what would be measured (n, m), given noise (n, m) of deviation 1,
    variances (n, m), of the response and all, and the square (n,) of how far what was measured is
    off, in deviations."""

    def one(both: tuple[Array, Array]) -> tuple[Array, ...]:
        values, noise = both
        mean, own = density.shown(values)
        total = own + density.covariance
        off = density.measured - mean
        shown = mean + jnp.linalg.cholesky(total) @ noise
        return shown, jnp.diag(own), jnp.diag(total), off @ jnp.linalg.solve(total, off)

    return jax.lax.map(one, (values, noise), batch_size=64)


def predicted(
    density: Density, values: np.ndarray, seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """What tests on soils of parameters (..., p) would show, as they were measured: (..., m);
    variances (..., m) of the response with the runs that correct it, and of all; the square (...)
    of how far what was measured is off."""
    flat = values.reshape(-1, values.shape[-1])
    noise = np.random.default_rng([seed, 2]).normal(size=(len(flat), len(density.measured)))
    found = _predicted(density, jnp.asarray(flat), jnp.asarray(noise))
    *parts, off = (np.asarray(part) for part in found)
    shape = values.shape[:-1]
    return *(part.reshape(*shape, -1) for part in parts), off.reshape(shape)  # pyright: ignore[reportReturnType]


def inference_data(
    question: Question, found: Sampled, seed: int, more: Mapping[str, Any]
) -> xr.DataTree:
    """All that was drawn, as ArviZ reads it, with what made it (`more`, plain values)."""
    from arviz_base import from_dict  # a second, which who reads draws does without

    names, features = question.names, [f.name for f in question.problem.features]
    draws = found.draws
    values = values_of(found.density, draws.y)
    shown, own, total, off = predicted(found.density, values, seed)
    prior = question.drawn(values[..., 0].size, np.random.default_rng([seed, 3]))
    np.exp(of_soil := prior[:, : len(question.space.names)], out=of_soil)
    groups = {
        "posterior": dict(zip(names, np.moveaxis(values, -1, 0), strict=True)),
        "prior": dict(zip(names, prior.T[:, None], strict=True)),
        "posterior_predictive": {"features": shown},
        "observed_data": {"features": question.problem.measured},
        "sample_stats": {
            "lp": draws.log_density,
            "diverging": draws.diverging,
            "n_steps": draws.steps,
            "acceptance_rate": draws.accepted,
            "step_size": draws.step_size,
            "response_share": own / total,
            "off": off,
        },
    }
    dims = {"features": ["feature"], "response_share": ["feature"]}
    tree = from_dict(groups, coords={"feature": features}, dims=dims)
    tree["curves"] = xr.DataTree(_curves(question, values.reshape(-1, len(names))))
    tree.attrs = {
        "physics": PHYSICS,
        "soil": question.lab.name,
        "conventions": question.lab.particles.conventions,
        "base": json.dumps(soil_json(question.space.base)),
        "wider": json.dumps(laboratory_scatter(question)),
        "effects": json.dumps(question.strengths.names),
        **more,
    }
    return tree


def laboratory_scatter(question: Question) -> dict[str, float]:
    """By what factor the laboratory's specimens vary more than packings, by target and test."""
    found = question.problem.wider(np.diag(question.scatter))
    return dict(zip(question.problem.groups, found.tolist(), strict=True))


def _curves(question: Question, values: np.ndarray) -> xr.Dataset:
    """Curves of CURVES draws among parameters and strengths (n, q), by test: means over packings as
    the response has them, without what runs correct."""
    rows = np.linspace(0, len(values) - 1, CURVES).round().astype(int)
    found = _shown(question.features(), jnp.asarray(values[rows]))
    columns = {"what": ["displacement (mm)", "force (N)"]}
    return xr.Dataset(
        {test: (("soil", f"{test}_point", "what"), np.asarray(c)) for test, c in found.items()},
        columns,
    )


@eqx.filter_jit
def _shown(features: FeaturesOfBeds, values: Array) -> Mapping[str, Array]:
    def one(values: Array) -> Mapping[str, Array]:
        return features.beds.shown(features.of_beds(values))[1]

    return jax.lax.map(one, values)


def write_draws(tree: xr.DataTree, folder: Path) -> None:
    """Writes posterior.nc, whole or not at all."""
    with whole(folder / FILE, ".nc") as part:
        tree.to_netcdf(part, engine=NETCDF)


@dataclass(frozen=True, eq=False)
class SoilDraws:
    """Soils of a posterior: parameters `names` of `values` (n, p), SI, one row a draw, all others
    as in `base`; `tree` is all of posterior.nc, loaded."""

    names: tuple[str, ...]
    values: np.ndarray
    base: SoilParameters
    tree: xr.DataTree

    def soil(self, number: int) -> SoilParameters:
        """That of one draw."""
        return self.in_soil(self.base, number)

    @property
    def wider(self) -> dict[str, float]:
        """By what factor the laboratory's specimens vary more than simulated packings, in variance:
        of targets by name, of curves by test."""
        return json.loads(self.tree.attrs.get("wider", "{}"))

    def base_in(self, lab: Lab) -> SoilParameters:
        """The soil of a lab file, in which draws set their parameters; `InputError` where the
        contact laws differ."""
        own, theirs = lab.particles.conventions, self.tree.attrs["conventions"]
        if own != theirs:
            problem = f"'{own}', but the draws follow '{theirs}'"
            raise InputError(lab.file, "particles.conventions", problem, f"give '{theirs}'")
        return base_soil(lab)

    def in_soil(self, base: SoilParameters, number: int) -> SoilParameters:
        """Another soil with the parameters of one draw."""
        return with_values(base, dict(zip(self.names, self.values[number], strict=True)))

    def spread(self, count: int) -> Iterator[SoilParameters]:
        """So many soils along the direction of ln p in which draws differ most, at equal shares of
        them."""
        logs = np.log(self.values) - np.log(self.values).mean(axis=0)
        along = logs @ np.linalg.svd(logs, full_matrices=False)[2][0]
        for share in (np.arange(count) + 0.5) / count:
            yield self.soil(int(np.argmin(np.abs(along - np.quantile(along, share)))))


def read_draws(folder: str | Path) -> SoilDraws:
    """The draws that `calibrate posterior` left in a folder.

    Raises:
        InputError: there are none, they cannot be read, another version of the physics made them,
            or they hold strengths of effects.
    """
    path = Path(folder) / FILE
    again = "run calibrate posterior again (finished simulations are on disk)"
    if not path.is_file():
        raise InputError(str(path), "", "there is no such file", "give a folder of its results")
    try:
        with xr.open_datatree(path, engine=NETCDF) as opened:
            tree = opened.load()
        physics = int(tree.attrs["physics"])
        conventions = CONVENTIONS[tree.attrs["conventions"]]
        known = json.loads(tree.attrs["base"])
        acting = json.loads(tree.attrs.get("effects", "[]"))
        columns = {str(name): column for name, column in tree["posterior"].data_vars.items()}
    except (OSError, ValueError, KeyError) as error:
        raise InputError(str(path), "", f"not draws of a posterior: {error}", again) from None
    if physics != PHYSICS:
        problem = f"draws of another physics version, {physics}; this program has {PHYSICS}"
        raise InputError(str(path), "physics", problem, again)
    if acting:
        problem = f"its draws hold strengths of effects ({', '.join(acting)})"
        raise InputError(str(path), "", problem, "run calibrate posterior without --effect")
    base = with_values(SoilParameters(conventions=conventions), known)
    values = np.stack([np.asarray(column).ravel() for column in columns.values()], axis=1)
    return SoilDraws(tuple(columns), values, base, tree)


# ---------------------------------------------------------------- in plain data and in words

INTERVAL = (5.0, 95.0)  # per cent of draws
ENDS = (50.0, *INTERVAL)
KEYS = ("median", "low", "high", "rhat", "ess", "width")
SURPRISE = (0.05, 99.95)  # per cent, beyond which a number is not met
LITTLE = 0.25  # of the largest weight, below which a parameter is no part of a direction
CUT = 0.02  # of a range in ln p: draws that lie so near the end of the library
MANY = 0.05  # of draws there, from which an interval counts as cut
UNLIKELY = 0.01  # chance, below which what was measured does not go together
OUTSIDE = 0.05  # of a parameter's prior beyond the library, from which on it is said


def described(
    question: Question, found: Sampled, tree: xr.DataTree, notes: Sequence[str]
) -> dict[str, Any]:
    """What posterior.json says of draws: parameters, features, directions, warnings."""
    names, every = question.space.names, question.names
    columns = {name: np.ravel(tree["posterior"][name]) for name in every}
    rhat, ess = mixing(found.draws.y)
    logs = np.log(np.stack([columns[name] for name in names], axis=1))
    width = logs.std(axis=0) / question.prior.std()
    ends = np.exp(np.percentile(logs, ENDS, axis=0))
    rows = zip(names, *ends, rhat, ess, width, strict=False)
    parameters = {name: dict(zip(KEYS, map(float, row), strict=True)) for name, *row in rows}
    features, chance = _features_json(question, tree), _chance(question, tree)
    diverging = int(found.draws.diverging.sum())
    effects = _effects_json(question, columns, rhat[len(names) :], ess[len(names) :])
    return {
        "parameters": parameters,
        **({"effects": effects} if effects else {}),
        "divergences": diverging,
        "points_added": found.added,
        "features": features,
        "chance": chance,
        "directions": list(_directions(question, logs)),
        "reach": _reach_json(question),
        "warnings": [
            *notes, *_of_chains(every, rhat, ess, diverging), *_of_features(features),
            *_of_agreement(question, chance), *_of_reach(question, logs),
        ],
    }  # fmt: skip


def _effects_json(
    question: Question, columns: Mapping[str, np.ndarray], rhat: np.ndarray, ess: np.ndarray
) -> dict[str, dict]:
    """Strengths of effects, in their units."""
    found, rows = {}, zip(question.acting, question.strengths.prior_sd(), rhat, ess, strict=True)
    for each, prior, *chains in rows:
        drawn = columns[each.name]
        row = *(each.typical * np.percentile(drawn, ENDS)), *chains, drawn.std() / prior
        known = dict(zip(KEYS, map(float, row), strict=True))
        found[each.name] = {**known, "unit": each.unit, "typical": each.typical}
    return found


def _features_json(question: Question, tree: xr.DataTree) -> dict[str, dict]:
    """Each measured number, what soils of the posterior would show, the response's part in it."""
    shown = np.asarray(tree["posterior_predictive"]["features"])
    share = np.asarray(tree["sample_stats"]["response_share"])
    ends = np.percentile(shown, [*INTERVAL, *SURPRISE, 50], axis=(0, 1))
    rows = zip(question.problem.features, question.problem.measured, share.mean(axis=(0, 1)),
               ends.T, strict=True)  # fmt: skip
    return {
        feature.name: {
            "measured": float(measured), "median": float(median), "low": float(low),
            "high": float(high), "response_share": float(part), "target": feature.is_target,
            "met": bool(least <= measured <= most),
        }
        for feature, measured, part, (low, high, least, most, median) in rows
    }  # fmt: skip


def _directions(question: Question, logs: np.ndarray) -> Iterator[str]:
    """What the data fix and what they leave open: directions of the posterior's covariance of ln p
    over the prior's deviations, the best known first."""
    names, prior = question.space.names, question.prior.std()
    width, axes = np.linalg.eigh(np.atleast_2d(np.cov((logs / prior).T)))
    known = np.sqrt(width) < IDENTIFIED
    for number in np.flatnonzero(known):
        powers = axes[:, number] / prior
        powers = powers / powers[np.argmax(np.abs(axes[:, number]))]
        kept = np.abs(axes[:, number]) > LITTLE * np.abs(axes[:, number]).max()
        order = np.argsort(-np.abs(axes[:, number]))
        product = " x ".join(
            names[i] if powers[i] == 1 else f"{names[i]}^{powers[i]:.1f}" for i in order if kept[i]
        )
        spread = 100 * np.expm1((logs @ np.where(kept, powers, 0.0)).std())
        yield f"fixed by the data, to {spread:.2g} % (one deviation): {product}"
    alone = logs.std(axis=0) / prior
    wide = [name for name, each in zip(names, alone, strict=True) if each > IDENTIFIED]
    if wide:
        yield (
            f"left open by the data, each by itself more than half as wide as before: "
            f"{', '.join(wide)}"
        )


def _of_chains(names, rhat: np.ndarray, ess: np.ndarray, diverging: int) -> Iterator[str]:
    off = [f"{n} (R-hat {r:.3f})" for n, r in zip(names, rhat, strict=True) if r > RHAT]
    if off:
        yield f"the chains have not mixed: {', '.join(off)}; the intervals are not to be relied on"
    few = [f"{n} ({e:.0f})" for n, e in zip(names, ess, strict=True) if e < ESS]
    if few:
        yield (
            f"fewer than {ESS:.0f} effective draws of {', '.join(few)}: ends of intervals are rough"
        )
    if diverging:
        yield (
            f"{diverging} trajectories diverged: the sampler may have missed a narrow part of the "
            "posterior"
        )


def _of_features(features: Mapping[str, Mapping]) -> Iterator[str]:
    for name, row in features.items():
        if row["target"] and row["response_share"] > PART:
            yield (
                f"{100 * row['response_share']:.0f} % of the variance of {name} is the library's "
                "own error, which intervals hold; at a few soils more runs would not lessen it much"
            )
    for name, row in features.items():
        if not row["met"]:
            yield (
                f"no soil of the library shows what was measured: {name} is {row['measured']:.4g}, "
                f"and soils of the posterior give {row['low']:.4g} to {row['high']:.4g}"
            )


def _chance(question: Question, tree: xr.DataTree) -> float:
    """That soils of the posterior show numbers as far off as the measured ones, or further, all
    together (posterior predictive; Gelman, Meng and Stern 1996, Statistica Sinica 6, 733)."""
    heard = int((~question.unknown).sum())
    return float(chi2.sf(np.asarray(tree["sample_stats"]["off"]), heard).mean())


def _of_agreement(question: Question, chance: float) -> Iterator[str]:
    silent = [f.name for f, no in zip(question.problem.features, question.unknown, strict=True)
              if no]  # fmt: skip
    if silent:
        yield f"beyond the library's curves, so without a say: {', '.join(silent)}"
    if chance < UNLIKELY:
        yield (
            "no soil of the library explains all measured numbers together (a chance of "
            f"{chance:.1g}): intervals are narrower than they should be, and may lie elsewhere; "
            "calibrate diagnose asks what acts beside the parameters"
        )


def _reach_json(question: Question) -> dict[str, dict]:
    ends = question.space.bounds()
    return {
        name: {"low": float(low), "high": float(high), "share_of_prior": float(share)}
        for name, (low, high), share in zip(question.space.names, ends, question.share, strict=True)
    }


def _of_reach(question: Question, logs: np.ndarray) -> Iterator[str]:
    """What of the prior lies beyond the library, and whose draws gather at its end."""
    names, share, ends = question.space.names, question.share, question.space.bounds()
    left = [f"{n} {100 * (1 - s):.0f} %" for n, s in zip(names, share, strict=True)
            if 1 - s > OUTSIDE]  # fmt: skip
    if left:
        yield (
            "soils beyond the library's runs are left out, which were possible beforehand: of the "
            f"prior of {', '.join(left)}"
        )
    low, high = question.space.log_bounds()
    place = (logs - low) / (high - low)
    for name, column, (least, most) in zip(names, place.T, ends, strict=True):
        for end, near in ((least, column < CUT), (most, column > 1 - CUT)):
            if near.mean() > MANY:
                yield (
                    f"draws of {name} gather at {end:.4g}, where the library or the bounds of a "
                    "fit end: what lies beyond may fit as well"
                )
