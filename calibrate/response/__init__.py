"""What tests on a soil show, as one function that JAX differentiates, without a run.

`process` holds Gaussian processes of the mean over packings, `reading` a load cell and how it reads
a soil that is crushed, `mould` one that is pressed, `machine` both, `response` all of it:

    response(delta, strengths) -> features

Fits, samplers and the diagnosis stand on it; it knows neither files nor libraries of runs.
"""
