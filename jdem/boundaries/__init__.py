"""What stands around a bed, one kind of boundary per file."""
