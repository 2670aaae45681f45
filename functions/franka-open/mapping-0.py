from typing import List, Tuple

import torch


def mapping_function(
    franka_grasp_pos: torch.Tensor, drawer_grasp_pos: torch.Tensor, cabinet_dof_pos: torch.Tensor
) -> Tuple[List[torch.Tensor], List[bool], List[str]]:
    distance = torch.norm(franka_grasp_pos - drawer_grasp_pos, dim=-1)
    return [distance, cabinet_dof_pos[:, 3]], [False, True], ["distance", "opening"]
