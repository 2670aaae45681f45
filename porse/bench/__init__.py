"""Bench: how close the program comes to what its libraries can do, as ratios of what one run measures in turn.

Nothing here is tracked, and nothing else depends on it. `table` says what is measured and what is wanted, one module measures
each suite, and `command` prints them.
"""
