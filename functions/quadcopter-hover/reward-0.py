from typing import Dict, Tuple

import torch


def compute_reward(
    root_positions: torch.Tensor, target_root_positions: torch.Tensor, root_angvels: torch.Tensor
) -> Tuple[torch.Tensor, Dict[str, torch.Tensor]]:
    distance = torch.norm(target_root_positions - root_positions, dim=-1)
    spin = torch.norm(root_angvels, dim=-1)
    near_temp, spin_temp = 1.0, 4.0
    near = torch.exp(-distance / near_temp)
    steady = 0.2 * torch.exp(-spin / spin_temp)
    return near + steady, {"near": near, "steady": steady}
