"""What a task offers to generated functions: one `Variable` for each name, as data.

The tasks declare them, the checker of generated code allows exactly them, and the prompts print them.
"""

from dataclasses import dataclass
from typing import Literal

Kind = Literal["tensor", "int", "float", "tuple", "device"]


@dataclass(frozen=True)
class Variable:
    """One name that a generated function may read.

    Attributes:
        name: the name, as in the original environment.
        kind: "tensor" is a float32 or int64 tensor whose first dimension is num_envs; the others are plain values, which
            stay what they are while the task lives: shapes of results may hang on them. "tuple" is one of ints.
        shape: the tensor's shape without its first dimension, `()` for one number an environment; a tuple's length.
        unit: SI unit, "1" when it has none.
        frame: "world", "body", "joint" or "-".
        meaning: one line for people and for the prompt.
    """

    name: str
    kind: Kind
    shape: tuple[int, ...]
    unit: str
    frame: str
    meaning: str
