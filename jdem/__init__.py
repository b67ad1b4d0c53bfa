"""jdem: a differentiable discrete element method for cohesive soil, in JAX.

What happens in one contact is in `laws`, what the testing machine does in
`experiments`, the one loop in `simulate`.  Nothing here reads lab files or fits.
"""
