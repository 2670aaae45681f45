"""PushBlock: each hand pushes its cube to a goal."""

from porse.tasks.push_block.task import PushBlock

__all__ = ["PushBlock"]
