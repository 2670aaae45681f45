from typing import Dict, Tuple

import torch


def compute_reward(
    door_left_handle_pos: torch.Tensor,
    door_right_handle_pos: torch.Tensor,
    left_hand_pos: torch.Tensor,
    right_hand_pos: torch.Tensor,
) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    left = torch.norm(door_left_handle_pos - left_hand_pos, dim=-1)
    right = torch.norm(door_right_handle_pos - right_hand_pos, dim=-1)
    reach_temp = 0.3
    reach = torch.exp(-(left + right) / reach_temp)
    closing = 2.0 * (1.0 - torch.abs(door_left_handle_pos[:, 1] - door_right_handle_pos[:, 1]))
    return reach + closing, {"reach": reach, "closing": closing}
