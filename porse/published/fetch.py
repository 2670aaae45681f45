"""A run from elsewhere, a folder or an address, copied to a folder of ours: file by file, each bounded and held to its hash."""

import functools
import hashlib
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from porse.errors import PorseError
from porse.published.manifest import (
    FOLDER,
    MANIFEST,
    MOST_MANIFEST_BYTES,
    NAME,
    Manifest,
    check_files,
    open_plain,
    parse_manifest,
    read_manifest,
    refused,
)

if TYPE_CHECKING:
    from httpx2 import Client

SECONDS = 600
"""So long may a run take to come."""

_TIMEOUT_S = 30
_CHUNK = 2**16


def is_address(source: str) -> bool:
    """Returns whether a source is an address on a network."""
    return source.startswith(("http://", "https://"))


def is_name(source: str) -> bool:
    """Returns whether a source is the name of a run that is published here, and no path and no address."""
    return NAME.fullmatch(source) is not None


def find(root: Path, name: str) -> Path:
    """Returns the folder of the run of that name that the project at `root` publishes, its files checked.

    Raises:
        PorseError: there is none, or a file is not what was published; it is named.
    """
    folder = root / FOLDER / name
    if not is_name(name) or not folder.is_dir():
        others = ", ".join(path.name for path in published_folders(root)) or "none"
        raise PorseError(f"expected the name of a published run, found {name!r}; published here: {others}")
    check_files(folder, read_manifest(folder))
    return folder


def published_folders(root: Path) -> list[Path]:
    """Returns the folders of the runs that the project at `root` publishes, by name."""
    folder = root / FOLDER
    found = sorted(folder.iterdir()) if folder.is_dir() else []
    return [path for path in found if is_name(path.name) and (path / MANIFEST).is_file()]


def receive(source: str, target: Path) -> Manifest:
    """Copies the published run at a path or an address to the new folder `target`, and returns its manifest.

    Nothing of it is opened but to be copied, and nothing is copied that the manifest does not name.

    Raises:
        PorseError: there is no such run, a name in it is no name of a file of such a run, or a file is not what was published.
    """
    target.mkdir(parents=True)
    manifest = _download(source.rstrip("/"), target) if is_address(source) else _copy(source, target)
    (target / MANIFEST).write_bytes(manifest.render())
    check_files(target, manifest)
    return manifest


def _copy(source: str, target: Path) -> Manifest:
    folder = Path(source)
    if not folder.is_dir():
        raise PorseError(
            f"expected the name, the folder or the address of a published run, found {source!r}; `porse published` lists those here"
        )
    manifest = read_manifest(folder)
    check_files(folder, manifest)
    for name in manifest.files:
        with open_plain(folder / name, name) as file:
            _write(iter(functools.partial(file.read, _CHUNK), b""), name, manifest, target)
    return manifest


def _download(address: str, target: Path) -> Manifest:
    import httpx2

    deadline = time.monotonic() + SECONDS
    try:
        with httpx2.Client(timeout=_TIMEOUT_S, follow_redirects=False, trust_env=True) as client:
            with _streamed(client, f"{address}/{MANIFEST}", deadline) as blocks:
                data = bytearray()
                for block in blocks:
                    data += block
                    if len(data) > MOST_MANIFEST_BYTES:
                        raise refused(f"{address}/{MANIFEST}", f"at most {MOST_MANIFEST_BYTES} bytes", "more")
            manifest = parse_manifest(bytes(data), f"{address}/{MANIFEST}")
            for name in manifest.files:
                with _streamed(client, f"{address}/{quote(name)}", deadline) as blocks:
                    _write(blocks, name, manifest, target)
    except (httpx2.HTTPError, httpx2.InvalidURL) as error:
        raise PorseError(
            f"expected a published run at {address}, found no answer ({type(error).__name__}: {error}); check the address"
        ) from None
    return manifest


@contextmanager
def _streamed(client: "Client", address: str, deadline: float) -> Iterator[Iterator[bytes]]:
    # Identity: what is packed could unpack to any size.
    headers = {"Accept-Encoding": "identity"}
    with client.stream("GET", address, headers=headers) as response:
        if response.status_code != 200:
            raise PorseError(
                f"expected {address} to answer with 200, found {response.status_code}; check the address, which is that of the "
                "folder that manifest.json is in"
            )
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise refused(address, "bytes as they are", "packed ones")

        def blocks() -> Iterator[bytes]:
            for block in response.iter_raw():
                if time.monotonic() > deadline:
                    raise refused(address, f"a run that comes within {SECONDS} s", "a slower one")
                yield block

        yield blocks()


def _write(blocks: Iterator[bytes], name: str, manifest: Manifest, target: Path) -> None:
    """Writes a file that comes in blocks, and stops where it is larger than the manifest says."""
    wanted, digest, size = manifest.files[name], hashlib.sha256(), 0
    path = target / name
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("xb") as file:
        for block in blocks:
            size += len(block)
            if size > wanted.size:
                break
            digest.update(block)
            file.write(block)
    if size != wanted.size or digest.hexdigest() != wanted.sha256:
        raise refused(name, "the bytes that were published", "others")
