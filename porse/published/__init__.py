"""Published runs: made from finished ones, listed, shown, and replayed from their own recorded replies.

A published run is a folder of data that says of each of its files what it is (`porse.published.manifest`). Whoever reads one
holds it to that, and what is in the files to their declarations (`porse.published.check`), before anything else is done with it.
"""
