"""Studies of control: figures of merit, comparisons, timing, conformance, and their pages.

Here belongs what needs many runs. It imports all but `heliarch`. Begin with `compare/study.py`,
then `arrays/closed_loop.py`: the closed loop without processes.
"""
