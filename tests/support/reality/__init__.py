"""The recipe of cases whose reality LIGGGHTS computes, from the plan to what the machine writes.

`benchmarks/reality` makes the cases; its README says how.
"""
