"""Reading what testing machines export: cells, tables, columns, recordings, lab files.

    bytes -> sheets of cells -> tables -> columns -> recordings -> specimens -> lab file

Each file is one arrow; `convert` runs them all.  Nothing here plots, prints or writes.
"""
