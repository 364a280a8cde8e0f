"""Recordings of runs: recorder, reader, inspect, verify, replay, export, recover."""
