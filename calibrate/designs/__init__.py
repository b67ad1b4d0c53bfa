"""Designed experiments: the classic way to calibrate, kept as a cross-check of the gradient fit.

    factors -> designs -> (runs made here or elsewhere) -> screening -> surface -> anova -> optimum

Matrices of designs come from pyDOE, least squares from statsmodels.  Everything is analysed in
coded units, in which a factor's low level is -1 and its high level +1.
"""
