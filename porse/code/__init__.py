"""Generated code: the contract, extraction from replies, the static check, compilation and the sandboxed probe.

Text of a model is hostile until each of these has passed: `extract` finds the function in a reply, `check` holds its
syntax tree against the allow-list of `contract`, `emit` writes it again as TorchScript, `graph` holds the compiled
operators against a second allow-list, and `probe` runs it for the first time in a limited child process.
"""
