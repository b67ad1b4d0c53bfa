"""From measurements to parameters: problem, fit, identifiability, audit."""
