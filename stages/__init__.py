"""The stages of `dvc.yaml`: each reads, calls the package, and writes. Nothing imports them.

A stage ends when `dvc repro` does, however that ends, and from its first line on: what it imports takes half a second.
"""

from porse.processes import die_with_parent

die_with_parent()
