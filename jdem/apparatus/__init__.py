"""What the testing machine does, one apparatus per file; see `base` for the contract."""
