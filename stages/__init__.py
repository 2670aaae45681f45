"""The stages of `dvc.yaml`: each reads, calls the package, and writes. Nothing imports them.

A stage ends when `dvc repro` does, however that ends, and from its first line on: what it imports takes half a second.
Where there is a warm server, it does the stage's work.
"""

from porse.processes import die_with_parent, expected_parent
from porse.warm.client import hand_over

die_with_parent(expected_parent())
hand_over()
