"""Whether a warm process is what a cold one would become: the same sources, the same switches of the libraries."""

import hashlib
import re
from collections.abc import Mapping
from pathlib import Path

_SWITCHES = ("ATEN_", "KMP_", "LD_", "MALLOC_", "MKL_", "MUJOCO_", "OMP_", "OPENBLAS_", "TORCH")
_MORE_SWITCHES = ("GLIBC_TUNABLES", "PYTHONHOME", "PYTHONPATH")


def sources(root: Path) -> str:
    """Returns the hash of every source file of the package and of the stages in a project's folder, scenes among them."""
    digest = hashlib.sha256()
    files = [*(root / "porse").rglob("*.py"), *(root / "porse").rglob("*.xml"), *(root / "stages").rglob("*.py")]
    for name, path in sorted((str(path.relative_to(root)), path) for path in files):
        content = path.read_bytes()
        digest.update(f"{name}\n{len(content)}\n".encode())
        digest.update(content)
    return digest.hexdigest()


def libraries_see(environment: Mapping[str, str]) -> dict[str, str]:
    """Returns the variables that libraries read when they are loaded; a loaded one takes no notice of another value."""
    return {name: value for name, value in environment.items() if name.startswith(_SWITCHES) or name in _MORE_SWITCHES}


def declared_profile(folder: Path) -> str | None:
    """Returns the numeric profile that a project's parameters declare, None where that cannot be told at a glance.

    Parsing the file takes longer than all else that a stage does before it begins.
    """
    try:
        text = (folder / "params.yaml").read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError):
        return None
    found = re.findall(r"^numerics:[ \t]*(\w+)[ \t]*(?:#.*)?$", text, re.MULTILINE)
    return found[0] if len(found) == 1 else None
