"""Suites: many runs from one file, each in a clone of its own, and what came out of them as one table."""
