"""What happens in ONE contact, one law per file; see `base` for the contract."""
