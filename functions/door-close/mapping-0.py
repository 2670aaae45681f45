from typing import List, Tuple

import torch


def mapping_function(
    door_left_handle_pos: torch.Tensor,
    door_right_handle_pos: torch.Tensor,
    left_hand_pos: torch.Tensor,
    right_hand_pos: torch.Tensor,
) -> Tuple[List[torch.Tensor], List[bool], List[str]]:
    left = torch.norm(door_left_handle_pos - left_hand_pos, dim=-1)
    right = torch.norm(door_right_handle_pos - right_hand_pos, dim=-1)
    opening = torch.abs(door_left_handle_pos[:, 1] - door_right_handle_pos[:, 1])
    return [0.5 * (left + right), opening], [False, True], ["distance", "opening"]
