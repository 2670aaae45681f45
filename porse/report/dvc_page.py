"""The page that `dvc plots show` and `diff` fill, with Vega inside: `python -m porse.report.dvc_page FOLDER`.

DVC's own page loads Vega from a server and stays blank without a network. `.dvc/config` names this one in its place
(`plots.html_template`). It is committed: DVC refuses to draw where the file is missing. To make it again, for a newer Vega:

    npm pack vega@5.33.1 vega-lite@5.23.0 vega-embed@6.29.0 --pack-destination FOLDER
    python -m porse.report.dvc_page FOLDER
"""

import tarfile
from pathlib import Path

import click

from porse.errors import PorseError

PAGE = Path(".dvc/plots/page.html")
PACKAGES = {"vega": "5.33.1", "vega-lite": "5.23.0", "vega-embed": "6.29.0"}
"""The latest of the major versions that DVC's own page and its templates are written for."""

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
{refresh_tag}
<title>DVC plots</title>
<!-- Made by python -m porse.report.dvc_page of %s, all under the BSD 3-Clause License,
copyright University of Washington Interactive Data Lab and Vega contributors. -->
%s
<style>body { font-family: sans-serif; } table { border-spacing: 15px; }</style>
</head>
<body>
{plot_divs}
</body>
</html>
"""


def dvc_page(folder: Path) -> str:
    """Returns the page, with DVC's placeholders for the plots, of the packages in `folder` as npm packs them.

    Raises:
        PorseError: a package is missing, or its script would end the page's.
    """
    scripts = []
    for name, version in PACKAGES.items():
        path = folder / f"{name}-{version}.tgz"
        try:
            with tarfile.open(path) as archive:
                script = archive.extractfile(f"package/build/{name}.min.js")
                text = script.read().decode("utf-8").strip() if script else ""
        except (OSError, KeyError, tarfile.TarError) as error:
            raise PorseError(
                f"expected {path} with package/build/{name}.min.js in it, found {error}; run `npm pack {name}@{version} "
                f"--pack-destination {folder}`"
            ) from error
        if "</script" in text or any(f"{{{word}}}" in text for word in ("plot_divs", "refresh_tag", "scripts")):
            raise PorseError(
                f"expected a script of {path} that can stand in a page, found </script or DVC's placeholder"
            )
        scripts.append(f"<script>{text}</script>")
    words = ", ".join(f"{name} {version}" for name, version in PACKAGES.items())
    return _PAGE % (words, "\n".join(scripts))


@click.command()
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
def main(folder: Path) -> None:
    """Write the page of the packages in FOLDER."""
    PAGE.parent.mkdir(parents=True, exist_ok=True)
    PAGE.write_text(dvc_page(folder), encoding="utf-8")


if __name__ == "__main__":
    main()
