"""The stages of `dvc.yaml`: each reads, calls the package, and writes. Nothing imports them."""
