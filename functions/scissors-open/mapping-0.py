from typing import List, Tuple

import torch


def mapping_function(
    scissors_left_handle_pos: torch.Tensor,
    scissors_right_handle_pos: torch.Tensor,
    left_hand_pos: torch.Tensor,
    right_hand_pos: torch.Tensor,
    object_dof_pos: torch.Tensor,
) -> Tuple[List[torch.Tensor], List[bool], List[str]]:
    left = torch.norm(scissors_left_handle_pos - left_hand_pos, dim=-1)
    right = torch.norm(scissors_right_handle_pos - right_hand_pos, dim=-1)
    return [0.5 * (left + right), object_dof_pos[:, 0]], [False, True], ["distance", "angle"]
