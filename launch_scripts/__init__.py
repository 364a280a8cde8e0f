"""Starts the processes of a run, watches them and ends them.

Here belongs what knows more than one process of a run. It imports all but `live_page`, `studies`
and `heliarch`. Begin with `launch.py`, then `process.py` and `processes.py`.
"""
