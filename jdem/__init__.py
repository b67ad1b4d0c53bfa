"""jdem: a differentiable discrete element method for cohesive soil, in JAX.

    import jax
    import jdem

    jax.config.update("jax_enable_x64", True)
    specimen = jdem.Specimen(count=150)
    tests = jdem.TestSequence((jdem.ConfinedCompression(), jdem.UnconfinedCompression()))
    lab = jdem.VirtualLab.of(specimen, tests, jdem.Numerics())
    found = jdem.simulate(lab, jdem.prepare(specimen, seed=0), jdem.SoilParameters())

What happens in one contact is in `laws`, what the testing machine does in `apparatus`, the one loop
in `engine`.  Nothing here reads lab files or fits.  Its names are those of `__init__.pyi`; each has
this one path.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
