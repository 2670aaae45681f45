from typing import Dict, Tuple

import torch


def compute_reward(
    franka_grasp_pos: torch.Tensor, drawer_grasp_pos: torch.Tensor, cabinet_dof_pos: torch.Tensor
) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    distance = torch.norm(franka_grasp_pos - drawer_grasp_pos, dim=-1)
    reach_temp = 0.3
    reach = torch.exp(-distance / reach_temp)
    opening = 5.0 * cabinet_dof_pos[:, 3]
    return reach + opening, {"reach": reach, "opening": opening}
