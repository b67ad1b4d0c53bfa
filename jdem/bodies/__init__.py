"""What a bed is made of, one kind of body per file."""
