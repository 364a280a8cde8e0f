"""What a run was worth: figures of merit, timing, tables and pages.

Here belongs what is computed from a whole run. It imports `recordings` and the folders below. Begin
with `figures.py`, whose table `FIGURES` lists every figure of merit.
"""
