"""What tests of tasks have in common."""

import torch

from porse.tasks.base import Task


def at_rest(task: Task) -> torch.Tensor:
    """Returns the outer forces and torques of an environment whose hands are not pushed, `(bodies, 6)`.

    They are the weights of all bodies that move and are not of a hand, in scenes without gravity of their own; else nothing.
    """
    model = task._physics.model
    forces = torch.zeros(model.nbody, 6, dtype=torch.float64)
    for body in range(1, model.nbody):
        falls = model.body_weldid[body] != 0 and not model.body(body).name.startswith(("right/", "left/"))
        if falls and not model.opt.gravity.any():
            forces[body, 2] = -9.81 * (1.0 - model.body_gravcomp[body]) * model.body_mass[body]
    return forces
