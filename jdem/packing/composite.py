"""How a specimen becomes a bed: it settles, or grows to its porosity where it has one."""

from jdem.materials.soil import SoilParameters
from jdem.packing.growth import grown
from jdem.packing.settling import settled
from jdem.packing.specimen import Packing, Specimen


def prepare(specimen: Specimen, seed: int, soil: SoilParameters | None = None) -> Packing:
    """A packing drawn by its seed; `soil` is what the bed is made with (None: a neutral one).

    Raises ValueError where no such bed stands.
    """
    make = settled if specimen.porosity is None else grown
    return make(specimen, seed, soil)
