"""Model replies: asked once, recorded in readable files, replayed for ever.

`request` says what a question is and what its key is; `record` is the format of one recorded reply; `store` reads and
writes the files; `index` and its locks are what diskcache is for; `ledger` counts what was spent and keeps budgets; `ask`
is the one function that the stages call. The contract is written down in `docs/llm-cache.md`. Nothing here imports torch
or mujoco, and only `provider` ever opens a socket.
"""
