"""A blend of two strategies, weighed by what was measured of their variance and bias.

    slope = w a + (1 - w) b,    w = v_b / (v_a + v_b)
    v_a = se_a^2 + max(0, (a - b)^2 - se_a^2 - se_b^2),    v_b = se_b^2

a is precise but may be biased (pathwise), b is noisy but unbiased over a usable range (ensemble).
What their difference exceeds their noise by is taken for a's bias.  After Suh et al. 2022, Do
differentiable simulators give better policy gradients?, ICML, who weigh by variance and
bound the bias.
"""

import jax.numpy as jnp
from jax import Array

from jdem.sensitivity.base import AbstractStrategy, Response, Sensitivity
from jdem.sensitivity.ensemble import Ensemble
from jdem.sensitivity.pathwise import Pathwise


class Blend(AbstractStrategy):
    """`precise` and `unbiased` are both evaluated; their costs add."""

    precise: AbstractStrategy = Pathwise()
    unbiased: AbstractStrategy = Ensemble()

    def __call__(self, response: Response, point: Array, packings: int) -> Sensitivity:
        precise = self.precise(response, point, packings)
        return blended(precise, self.unbiased(response, point, packings))

    def runs(self, parameters: int, packings: int) -> float:
        each = (s.runs(parameters, packings) for s in (self.precise, self.unbiased))
        return sum(each) - 1

    def describe(self) -> str:
        return f"blend of [{self.precise.describe()}] and [{self.unbiased.describe()}]"


def blended(precise: Sensitivity, unbiased: Sensitivity) -> Sensitivity:
    """Slopes weighed as above; where the precise one is not finite it has no weight."""
    usable = jnp.isfinite(precise.slopes) & jnp.isfinite(precise.standard_error)
    slope = jnp.where(usable, precise.slopes, 0.0)
    own = jnp.where(usable, precise.standard_error, 0.0) ** 2
    other = unbiased.standard_error**2
    bias = jnp.maximum((slope - unbiased.slopes) ** 2 - own - other, 0.0)
    total = own + bias + other
    weight = jnp.where(usable & (total > 0), other / jnp.where(total > 0, total, 1.0), 0.0)
    slopes = weight * slope + (1 - weight) * unbiased.slopes
    variance = weight**2 * (own + bias) + (1 - weight) ** 2 * other
    return Sensitivity(unbiased.values, slopes, jnp.sqrt(variance))
