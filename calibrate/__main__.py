"""`python -m calibrate` is the console script `calibrate`."""

from calibrate.cli import main

main()
