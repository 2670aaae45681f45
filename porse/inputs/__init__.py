"""Inputs: what the result of a stage depends on, besides what other stages left for it.

They are the parameters that it reads, and the files that it runs: its own script, the modules that this imports for the
task of the run, the prompts where it asks, the pinned packages. Stage `resolve` writes them to one JSON file a stage,
and DVC tracks that file. A stage has its parameters from there, and checks the files before its work and after it.
"""
