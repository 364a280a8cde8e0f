"""Scenarios: what a TOML file may say, how it is read, and those that come with Heliarch.

Here belongs what turns a file and options into the plan of a run. It imports `sunspec`, `sim_plant`
and the folders below. Begin with `scenario.py` (the fields), then `preparation.py`.
"""
