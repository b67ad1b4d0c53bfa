"""How a specimen becomes a bed: it settles, or grows to its porosity where it has one."""

from jdem.core.quantity import check_precision
from jdem.materials.soil import SoilParameters
from jdem.packing.growth import grown
from jdem.packing.settling import settled
from jdem.packing.specimen import Packing, Specimen


def prepare(specimen: Specimen, seed: int, soil: SoilParameters | None = None) -> Packing:
    """Makes the bed of a specimen: spheres that fell, or grew to a porosity, and lie still.

    Args:
        specimen: how many spheres of which sizes, and the mould.
        seed: of the draw; another seed is another bed of the same kind.
        soil: the soil that the bed is made with; None: a slippery one without cohesion.

    Returns:
        Positions and radii (m) of the spheres, height and radius (m) of the bed.

    Raises:
        ValueError: no such bed stands, or JAX is not in double precision.

    Example:
        >>> packing = jdem.prepare(jdem.Specimen(count=150), seed=0)
    """
    check_precision("float64")
    make = settled if specimen.porosity is None else grown
    return make(specimen, seed, soil)
