"""A soil: its parameters, and the laws that they belong to."""
