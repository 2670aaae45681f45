"""Puts the files that `porse init` starts a project with into the wheel; all else is said in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

ROOT = Path(__file__).resolve().parent


class BuildWithProject(build_py):
    """Builds the package, with copies of the project's files in `porse/project`."""

    def run(self) -> None:
        """Builds."""
        super().run()
        if self.editable_mode:
            return
        target = Path(self.build_lib) / "porse" / "project"
        shutil.rmtree(target, ignore_errors=True)
        for name in (ROOT / "porse" / "starter" / "files.txt").read_text(encoding="utf-8").split():
            source, copy = ROOT / name, target / name
            copy.parent.mkdir(parents=True, exist_ok=True)
            if source.is_dir():
                shutil.copytree(source, copy, ignore=shutil.ignore_patterns("__pycache__"))
            else:
                shutil.copy(source, copy)


setup(cmdclass={"build_py": BuildWithProject})
