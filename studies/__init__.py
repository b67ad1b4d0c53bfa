"""Research about the product: run from a checkout, in no wheel.

One study is one module or folder: `python -m studies.NAME --help`.  docs/studies.md lists them.
A study imports `jdem`, `calibrate` and other studies; these never import a study.
"""
