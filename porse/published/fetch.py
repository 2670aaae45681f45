"""A run from elsewhere, a folder or an address, copied to a folder of ours: file by file, each bounded and held to its hash."""

import asyncio
import hashlib
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING
from urllib.parse import quote

from porse.errors import PorseError
from porse.published.manifest import (
    FOLDER,
    MANIFEST,
    MOST_MANIFEST_BYTES,
    NAME,
    File,
    Manifest,
    check_files,
    open_plain,
    parse_manifest,
    read_manifest,
    refused,
)

if TYPE_CHECKING:
    from httpx2 import AsyncClient, Response

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
        with open_plain(folder / name, name) as file, _Writer(name, manifest.files[name], target) as writer:
            while (block := file.read(_CHUNK)) and writer.add(block):
                pass
    return manifest


def _download(address: str, target: Path) -> Manifest:
    import httpx2

    try:
        return asyncio.run(_within(address, target))
    except TimeoutError:
        raise refused(address, f"a run that comes within {SECONDS} s", "a slower one") from None
    except (httpx2.HTTPError, httpx2.InvalidURL) as error:
        raise PorseError(
            f"expected a published run at {address}, found no answer ({type(error).__name__}: {error}); check the address"
        ) from None


async def _within(address: str, target: Path) -> Manifest:
    """Copies a run from an address, as `_download` does.

    Raises:
        TimeoutError: the time for all of it is over, whatever it waits for: a connection, the next header, the next byte.
    """
    import httpx2

    async with asyncio.timeout(SECONDS), httpx2.AsyncClient(timeout=_TIMEOUT_S, follow_redirects=False) as client:
        data = bytearray()
        async with _streamed(client, f"{address}/{MANIFEST}") as response:
            async for block in response.aiter_raw():
                data += block
                if len(data) > MOST_MANIFEST_BYTES:
                    raise refused(f"{address}/{MANIFEST}", f"at most {MOST_MANIFEST_BYTES} bytes", "more")
        manifest = parse_manifest(bytes(data), f"{address}/{MANIFEST}")
        for name, file in manifest.files.items():
            with _Writer(name, file, target) as writer:
                async with _streamed(client, f"{address}/{quote(name)}") as response:
                    async for block in response.aiter_raw():
                        if not writer.add(block):
                            break
    return manifest


@asynccontextmanager
async def _streamed(client: "AsyncClient", address: str) -> AsyncIterator["Response"]:
    """Yields the answer of an address, its body unread.

    Raises:
        PorseError: it is no file as it is.
    """
    # Identity: what is packed could unpack to any size.
    async with client.stream("GET", address, headers={"Accept-Encoding": "identity"}) as response:
        if response.status_code != 200:
            raise PorseError(
                f"expected {address} to answer with 200, found {response.status_code}; check the address, which is that of the "
                "folder that manifest.json is in"
            )
        if response.headers.get("Content-Encoding", "identity") != "identity":
            raise refused(address, "bytes as they are", "packed ones")
        yield response


class _Writer:
    """A file of a run that comes in blocks, as a context manager: at its end, the file is what the manifest says.

    Args:
        name: of the file.
        wanted: what the manifest says of it.
        target: the folder of the run.
    """

    def __init__(self, name: str, wanted: File, target: Path) -> None:
        self._name, self._wanted, self._path = name, wanted, target / name
        self._digest, self._size = hashlib.sha256(), 0

    def __enter__(self) -> "_Writer":
        self._path.parent.mkdir(parents=True, exist_ok=True)
        self._file = self._path.open("xb")
        return self

    def add(self, block: bytes) -> bool:
        """Writes a block, and returns whether more may come; one that is too much is not written."""
        self._size += len(block)
        if self._size > self._wanted.size:
            return False
        self._digest.update(block)
        self._file.write(block)
        return True

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._file.close()
        if kind is None and File(self._digest.hexdigest(), self._size) != self._wanted:
            raise refused(self._name, "the bytes that were published", "others")
