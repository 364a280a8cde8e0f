"""Recordings of runs: recorder, reader, inspect, verify, replay, export, recover.

Here belongs what writes or reads a run's messages; what a run was worth belongs to `results`. It
imports `scenarios` and the folders below. Begin with `read/reader.py`, then `record/recorder.py`.
"""
