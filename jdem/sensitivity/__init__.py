"""How a response is differentiated, one strategy per file; see `base` for the contract."""
