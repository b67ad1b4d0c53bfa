"""What the program does, one verb a file: a function to call and the result that it returns.

`import calibrate` offers them; `calibrate VERB` is made from the function's signature.  A new verb
is a file NAME.py that begins with what it does, and its line below.
"""

VERBS = {  # the name that is typed, which is that of the file: the function, in the order of --help
    "check": "check",
    "simulate": "simulate",
    "example": "example",
    "fit": "fit",
    "posterior": "posterior",
    "predict": "predict",
    "contact": "contact",
    "audit": "audit",
    "doe": "doe",
    "convert": "convert",
    "diagnose": "diagnose",
    "next": "next_test",
    "library": "make_library",
    "discrepancy": "estimate_discrepancy",
    "report": "report",
    "export": "export",
    "view": "view",
}
