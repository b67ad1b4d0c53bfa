"""Reports to hand on: one self-contained HTML page for each kind of result.

    result -> template that extends templates/base.html -> page (html.py)

A page asks nothing of the network, escapes every text, and reads on a phone as in greyscale.
"""
