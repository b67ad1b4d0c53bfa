"""The paper's published figures beside what its own printed tables give.

    tables (CSV) -> levels, screening, depth, force, sweep -> verdict of each figure -> report

The paper is Chen et al. 2023, Sustainability 15, 15079 (CC BY 4.0); `tables.md` says how
its numbers were read.  `verdict.py` states the one rule by which every figure is judged.
"""
