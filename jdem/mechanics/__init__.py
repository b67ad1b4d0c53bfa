"""One contact: its nouns, its elasticity, its dashpot."""
