"""The stages of `dvc.yaml`: each reads, calls the package, and writes. Nothing imports them.

A stage ends when `dvc repro` does, however that ends, and from its first line on: what it imports takes half a second.
"""

import os

from porse.processes import die_with_parent

# stages/python.sh says who started it, so that a stage whose DVC ended before this line ends, too.
_parent = os.environ.pop("PORSE_PARENT", "")
die_with_parent(int(_parent) if _parent else None)
