"""What a wheel carries besides modules."""

import tomllib


def test_the_package_says_that_it_is_typed(root):
    carried = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    assert "py.typed" in carried["porse"]
    assert (root / "porse" / "py.typed").is_file()
