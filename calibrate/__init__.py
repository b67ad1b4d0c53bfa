"""calibrate: from laboratory measurements to DEM parameters to an explanation.

    import calibrate

    fitted = calibrate.fit("my_soil.toml", preset="quick")
    fitted.parameters, fitted.interval_95

Its names are those of `__init__.pyi`; each has this one path.  They are loaded when they are first
used, so that `import calibrate` is quick.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
