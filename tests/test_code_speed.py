"""What generated functions cost of a training, in processor time, which is steadier than the clock."""

import os
import re
import subprocess
import sys

import pytest


@pytest.mark.slow
@pytest.mark.parametrize("profile", ["fast", "portable"])
@pytest.mark.parametrize(("num_envs", "share"), [(128, 0.03), (1024, 0.01)])
def test_reward_mapping_and_bonus_take_little_of_a_training_step(root, num_envs, share, profile):
    command = [sys.executable, str(root / "tests" / "share_of_step.py"), profile, str(num_envs)]
    environment = os.environ | {"PYTHONPATH": str(root)}
    result = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    print(result.stdout)
    assert float(re.search(r"a share of ([\d.]+)", result.stdout)[1]) <= share
