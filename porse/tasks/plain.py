"""The variables that every task offers to generated functions."""

from porse.variables import Variable

PLAIN_VARIABLES = (
    Variable("actions", "tensor", (), "1", "-", "the last actions, clamped to [-1, 1]; 0 after a reset"),
    Variable("obs_buf", "tensor", (), "1", "-", "the observations before clipping"),
    Variable("progress_buf", "tensor", (), "steps", "-", "control steps since the episode began (int64)"),
    Variable("num_envs", "int", (), "1", "-", "number of environments"),
    Variable("device", "device", (), "-", "-", "device of every tensor"),
)


def plain_variables(observations: int, actions: int) -> tuple[Variable, ...]:
    """Returns the variables that every task offers, with the widths of one task."""
    shapes = {"actions": (actions,), "obs_buf": (observations,)}
    return tuple(
        Variable(v.name, v.kind, shapes.get(v.name, v.shape), v.unit, v.frame, v.meaning) for v in PLAIN_VARIABLES
    )
