from typing import List, Tuple

import torch


def mapping_function(
    root_positions: torch.Tensor, target_root_positions: torch.Tensor, root_linvels: torch.Tensor
) -> Tuple[List[torch.Tensor], List[bool], List[str]]:
    distance = torch.norm(target_root_positions - root_positions, dim=-1)
    speed = torch.norm(root_linvels, dim=-1)
    return [distance, speed], [False, False], ["distance", "speed"]
