"""Functions as a model would write them, for tests."""

import functools

import torch

from code_cases import traced
from porse.tasks import make_task

REWARD = """def compute_reward(root_positions: torch.Tensor, target_root_positions: torch.Tensor, root_quats: torch.Tensor):
    temperature: float = 1.5
    distance = torch.sqrt(((target_root_positions - root_positions) ** 2).sum(dim=-1))
    closeness = torch.exp(-temperature * distance)
    upright = 1.0 - 2.0 * (root_quats[:, 0] ** 2 + root_quats[:, 1] ** 2)
    tilt = torch.acos(torch.clamp(upright, -1.0, 1.0))
    return closeness + 0.2 * upright - 0.01 * tilt, {"closeness": closeness, "upright": upright, "tilt": tilt}
"""

MAPPING = """def mapping_function(self):
    distance = self.dist(self.root_positions, self.target_root_positions)
    speed = torch.norm(self.root_linvels, dim=-1)
    return [distance, speed], [False, False], ["distance", "speed"]
"""

NOT_FINITE = """def compute_reward(root_positions: torch.Tensor, progress_buf: torch.Tensor):
    late = torch.where(progress_buf > 12, torch.log(-torch.ones_like(root_positions[:, 0])), root_positions[:, 2])
    return late, {"late": late}
"""

INFINITE_COMPONENT = """def compute_reward(root_positions: torch.Tensor, progress_buf: torch.Tensor):
    height = root_positions[:, 2]
    late = torch.where(progress_buf > 12, torch.log(torch.zeros_like(height)), height)
    return height, {"late": late, "height": height}
"""

HUGE = """def compute_reward(root_positions: torch.Tensor, progress_buf: torch.Tensor):
    late = torch.where(progress_buf > 12, 1.0e37 + 1.0e36 * root_positions[:, 0], root_positions[:, 2])
    return late, {"late": late}
"""

RAISES = """def compute_reward(root_positions: torch.Tensor, progress_buf: torch.Tensor):
    column = 5 * (progress_buf > 12).long()
    height = torch.gather(root_positions, 1, column.unsqueeze(-1)).squeeze(-1)
    return height, {"height": height}
"""


@functools.cache
def program(source: str) -> str:
    """Returns the operator list of a source, traced on states of Quadcopter right after its first step."""
    task = make_task("Quadcopter", 4, 0)
    task.step(torch.zeros(4, task.NUM_ACTIONS))
    kind = "mapping" if "def mapping_function" in source else "reward"
    return traced(source, kind, task.VARIABLES, task.variables()).text
