from typing import Dict, Tuple

import torch


def compute_reward(
    franka_grasp_pos: torch.Tensor, drawer_grasp_pos: torch.Tensor
) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    distance = torch.norm(franka_grasp_pos - drawer_grasp_pos, dim=-1)
    reach_temp = 0.3
    reach = torch.exp(-distance / reach_temp)
    return reach, {"reach": reach}
