from typing import Dict, Tuple

import torch


def compute_reward(
    scissors_left_handle_pos: torch.Tensor,
    scissors_right_handle_pos: torch.Tensor,
    left_hand_pos: torch.Tensor,
    right_hand_pos: torch.Tensor,
    object_dof_pos: torch.Tensor,
) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    left = torch.norm(scissors_left_handle_pos - left_hand_pos, dim=-1)
    right = torch.norm(scissors_right_handle_pos - right_hand_pos, dim=-1)
    reach_temp = 0.3
    reach = torch.exp(-(left + right) / reach_temp)
    opening = 2.0 * (object_dof_pos[:, 0] + 0.59)
    return reach + opening, {"reach": reach, "opening": opening}
