"""How beds are made, one preparation per file."""
