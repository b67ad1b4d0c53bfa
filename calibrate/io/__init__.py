"""Lab files and measured curves."""
