"""Functions as a model would write them, for tests."""

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

RAISES = """def compute_reward(root_positions: torch.Tensor, progress_buf: torch.Tensor, num_envs: int):
    late = progress_buf > 12
    chosen = root_positions[late]
    if chosen.shape[0] > 0:
        chosen = chosen.reshape(num_envs, 5)
    height = root_positions[:, 2]
    return height, {"height": height + 0.0 * chosen.sum()}
"""
