"""What the base model leaves out, one effect per file; see `base` for the contract."""
