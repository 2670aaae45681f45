"""What a wheel carries besides modules, and what Git carries at all."""

import tomllib

from porse.suite.resolve import tracked_files

MOST_BYTES = 2**20
"""Of a tracked file; published runs, which are not among them, have a bound of their own."""


def test_the_package_says_that_it_is_typed(root):
    carried = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    assert "py.typed" in carried["porse"]
    assert (root / "porse" / "py.typed").is_file()


def test_git_carries_no_large_file_and_no_package(root):
    files = tracked_files(root)
    assert len(files) > 500
    assert [name for name in files if (root / name).stat().st_size > MOST_BYTES] == []
    assert [name for name in files if name.endswith((".whl", ".tar.gz", ".zip"))] == []
