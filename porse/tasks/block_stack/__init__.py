"""BlockStack: two hands stack two cubes."""

from porse.tasks.block_stack.task import BlockStack

__all__ = ["BlockStack"]
