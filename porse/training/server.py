"""What the server of candidates' processes imports before it forks them (`porse.training.population`).

When the stage ends, the server ends at once: to take PyTorch apart takes a second of computing, and is no use.
"""

import atexit
import os

from porse.training.candidate import train_candidate

__all__ = ["train_candidate"]

atexit.register(os._exit, 0)
