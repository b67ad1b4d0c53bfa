"""What the program does, one verb a file: a function to call and the result that it returns.

`import calibrate` offers all of them; the command line parses options and calls the same functions.
"""
