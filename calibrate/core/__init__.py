"""What every part of the program stands on: errors, units, progress, set-up."""
