"""A model by rule: answers the open requests of a run, the same question always the same way. For tests alone."""

import hashlib
import json

REWARD = """Closeness and an upright pose.
```python
def compute_reward(root_positions: torch.Tensor, target_root_positions: torch.Tensor, root_quats: torch.Tensor, root_linvels: torch.Tensor):
    temperature: float = {temperature}
    distance = torch.norm(target_root_positions - root_positions, dim=-1)
    closeness = torch.exp(-temperature * distance)
    upright = 1.0 - 2.0 * (root_quats[:, 0] ** 2 + root_quats[:, 1] ** 2)
    calm = -{calm} * torch.norm(root_linvels, dim=-1)
    total = closeness + 0.2 * closeness * upright + calm
    return total, {{"closeness": closeness, "upright": upright, "calm": calm}}
```"""
MAPPING = """```python
def mapping_function(self):
    distance = self.dist(self.root_positions, self.target_root_positions)
    height = self.root_positions[:, 2]
    return [distance, height][:{count}], [False, True][:{count}], ["distance", "height"][:{count}]
```"""
BROKEN = "```python\ndef compute_reward(velocity: torch.Tensor):\n    return velocity, {}\n```"


def answer(request: dict) -> str:
    """Returns the reply to a request's body; the first reward of a first question is broken, its repair is not."""
    messages = request["messages"]
    digest = hashlib.sha256(json.dumps(request, sort_keys=True).encode()).digest()
    system = messages[0]["content"]
    if "```json" in system:
        values = [round(0.1 + 0.8 * (i + digest[i] / 256) / 5, 3) for i in range(5)]
        if '"goal"' in system:
            return "```json\n" + json.dumps([{"goal": 2 - 2 * v, "bonus": 2 * v} for v in values]) + "\n```"
        return "```json\n" + json.dumps(values) + "\n```"
    if "mapping_function" in system:
        return MAPPING.format(count=2)
    if len(messages) == 2 and request["sample"] == 0:
        return BROKEN
    return REWARD.format(temperature=round(0.5 + digest[0] / 64, 3), calm=round(digest[1] / 2560, 4))
