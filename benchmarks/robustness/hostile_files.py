"""Files that nobody should trust: damaged by chance, and made by hand to be read for what they are not.

`damaged` gives flipped, cut and overwritten copies of a file. `hand_made` puts things where a sample file is expected:
files with a seal that is right and contents that lie, links, folders, pipes. Each has to be noticed as damaged, hang
nothing, and lead nowhere: baits lie outside the campaign's folder, and nothing may read or change them.
"""

from __future__ import annotations

import io
import os
import re
import socket
import struct
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from jaxmpm.support import hdf5

BAIT = 31337.0
"""The number that the baits are full of: where it turns up, something outside was read."""

Change = Callable[[h5py.File], None]
Maker = Callable[[Path, bytes], None]


@dataclass(frozen=True)
class Baits:
    """Files outside the campaign's folder. numbers: raw float64. hdf5: with an array of each usual name."""

    numbers: Path
    hdf5: Path

    def untouched(self) -> bool:
        """Whether both are as they were made."""
        return self.numbers.read_bytes() == _bait().tobytes() and self.hdf5.read_bytes() == _bait_file()


def lay_baits(folder: Path) -> Baits:
    """Make the baits in a folder, which is made too."""
    folder.mkdir(parents=True, exist_ok=True)
    baits = Baits(folder / "bait.bin", folder / "bait.h5")
    baits.numbers.write_bytes(_bait().tobytes())
    baits.hdf5.write_bytes(_bait_file())
    return baits


def damaged(data: bytes, count: int, *, seed: int = 0) -> Iterator[tuple[str, bytes]]:
    """So many damaged copies of a file and what was done to each: in turn a flipped bit, a cut, a zeroed and an
    overwritten piece, bytes too many."""
    draw = np.random.default_rng(seed)
    for number in range(count):
        at, way = int(draw.integers(len(data))), number % 5
        end = min(at + int(draw.integers(1, 512)), len(data))
        piece = draw.integers(0, 256, end - at, dtype=np.uint8).tobytes()
        name, made = (
            ("flipped", data[:at] + bytes([data[at] ^ (1 << int(draw.integers(8)))]) + data[at + 1 :]),
            ("cut", data[:at]),
            ("zeroed", data[:at] + bytes(end - at) + data[end:]),
            ("overwritten", data[:at] + piece + data[end:]),
            ("longer", data + piece),
        )[way]
        if made != data:
            yield f"{name} at {at}", made
        else:
            yield f"cut at {at}", data[:at]


def resealed(data: bytes, change: Change) -> bytes:
    """A sealed file, changed within and sealed anew: what anyone can do who knows the format."""
    image = io.BytesIO(data)
    with h5py.File(image, "r+") as file:
        change(file)
    return sealed_anew(image.getvalue())


def sealed_anew(data: bytes) -> bytes:
    """The same file with a seal that is right again."""
    head = re.match(rb"(.*), schema (\d+), SHA-256", data)
    if head is None:
        raise ValueError("the file has no seal: give the bytes of a sample or a restart point")
    content = data[hdf5.USER_BLOCK :]
    return hdf5.seal(head[1].decode(), int(head[2]), content) + content


def replacements_of(name: str, baits: Baits) -> dict[str, Change]:
    """What may stand in a file where the array `name` is expected, each of it no array that lies there."""

    def put(make: Callable[[h5py.File], object], file: h5py.File) -> None:
        if name in file:
            del file[name]
        made = make(file)
        if made is not None:
            file[name] = made

    def virtual(file: h5py.File) -> None:
        layout = h5py.VirtualLayout((20,), "f8")
        layout[:] = h5py.VirtualSource(str(baits.hdf5), "coefficients", shape=(20,))
        file.create_virtual_dataset(name, layout)

    def external(file: h5py.File) -> None:
        file.create_dataset(name, (20,), "f8", external=[(str(baits.numbers), 0, 160)])

    def huge(file: h5py.File, **how: object) -> None:
        file.create_dataset(name, (10**13,), "f8", **how)

    pairs = np.zeros(3, [("a", "f8"), ("b", "i4")])
    makes: dict[str, Callable[[h5py.File], object]] = {
        "storage elsewhere": external,
        "virtual array": virtual,
        "soft link": lambda file: h5py.SoftLink("/row"),
        "soft link to nothing": lambda file: h5py.SoftLink("/nowhere"),
        "soft link to itself": lambda file: h5py.SoftLink(f"/{name}"),
        "link to another file": lambda file: h5py.ExternalLink(str(baits.hdf5), "coefficients"),
        "group": lambda file: file.create_group(name) and None,
        "group that holds itself": lambda file: file["/"],
        "huge shape": huge,
        "huge shape in chunks": partial(huge, chunks=(1000,)),
        "compressed": lambda file: file.create_dataset(name, data=np.zeros(10**6), compression="gzip") and None,
        "text": lambda file: "seven",
        "texts": lambda file: np.array([b"one", b"two"]),
        "complex numbers": lambda file: np.zeros(20, complex),
        "pairs": lambda file: pairs,
        "references": lambda file: file.create_dataset(name, data=[file.ref] * 3, dtype=h5py.ref_dtype) and None,
        "no shape": lambda file: h5py.Empty("f8"),
        "named type": lambda file: np.dtype("f8"),
        "missing": lambda file: None,
    }
    return {f"{name}: {how}": partial(put, make) for how, make in makes.items()}


def _sample_lies(baits: Baits) -> dict[str, Change]:
    """What only a sample file can misstate: its row, its groups, its own description."""

    def row(**values: object) -> Change:
        return lambda file: file["row"].attrs.update(values)

    def about(**values: object) -> Change:
        return lambda file: file.attrs.update(values)

    def without(*path: str) -> Change:
        return lambda file: file[path[0]].attrs.__delitem__(path[1])

    def replaced(name: str, value: object) -> Change:
        def change(file: h5py.File) -> None:
            del file[name]
            if value is not None:
                file[name] = value

        return change

    def many_names(file: h5py.File) -> None:
        file["fields/shared"] = np.zeros(10_000)
        for number in range(2_000):
            file[f"fields/shared_{number}"] = file["fields/shared"]

    return {
        "row: text for a number": row(displacement="far"),
        "row: not a number": row(displacement=np.nan),
        "row: infinite": row(displacement=np.inf),
        "row: negative": row(displacement=-1.0),
        "row: number for a flag": row(broke_off=0),
        "row: array for a number": row(displacement=np.zeros(3)),
        "row: text for a measure": row(runout="14.17", broke_off=False),
        "row: reference": lambda file: file["row"].attrs.create("displacement", file.ref, dtype=h5py.ref_dtype),
        "row: without displacement": without("row", "displacement"),
        "row: without broke_off": without("row", "broke_off"),
        "row: escape sequence in a name": lambda file: file["row"].attrs.__setitem__("\x1b[2Jname", 1.0),
        "row: lines in a text": row(mode="deep\nprobability of failure 0"),
        "row: escape sequence in a text": row(mode="\x1b]0;title\x07deep"),
        "row: missing": replaced("row", None),
        "row: array": replaced("row", np.zeros(3)),
        "row: link to another file": replaced("row", h5py.ExternalLink(str(baits.hdf5), "/")),
        "fields: missing": replaced("fields", None),
        "fields: array": replaced("fields", np.zeros(3)),
        "fields: link to another file": replaced("fields", h5py.ExternalLink(str(baits.hdf5), "/")),
        "fields: escape sequence in a name": lambda file: file["fields"].__setitem__("\x1b[31mred", np.zeros(3)),
        "fields: many names of one array": many_names,
        "coefficients: two-dimensional": replaced("coefficients", np.zeros((2, 3))),
        "coefficients: whole numbers": replaced("coefficients", np.arange(5)),
        "number for a status": about(status=7),
        "lines in a status": about(status="FINISHED\nP_f = 0"),
        "text for steps": about(steps="many"),
        "texts for one text": about(device=np.array([b"cpu", b"gpu"])),
        "number of another sample": about(sample=999_999),
        "text for its number": about(sample="1"),
        "another grid": about(grid="finest"),
        "another scene": about(scene="0" * 64),
        "versions that are no JSON": about(versions="jaxmpm 1"),
        "versions nested without end": about(versions="[" * 60_000),
        "versions that are numbers": about(versions='{"jaxmpm": 1}'),
        "without versions": lambda file: file.attrs.__delitem__("versions"),
    }


def no_files(baits: Baits) -> dict[str, Callable[[Path], None]]:
    """What may stand under a file's name without being a file: each takes the path where nothing is yet."""

    def bound(path: Path) -> None:
        # A socket's name may be short only: it is bound in place.
        here = os.getcwd()
        os.chdir(path.parent)
        try:
            with socket.socket(socket.AF_UNIX) as end:
                end.bind(path.name)
        finally:
            os.chdir(here)

    return {
        "folder": lambda path: path.mkdir(),
        "link to a bait": lambda path: path.symlink_to(baits.hdf5),
        "link to nothing": lambda path: path.symlink_to(path.with_name("nowhere")),
        "link to itself": lambda path: path.symlink_to(path),
        "link to a folder": lambda path: path.symlink_to(baits.hdf5.parent),
        "link to a device": lambda path: path.symlink_to("/dev/zero"),
        "pipe": lambda path: os.mkfifo(path),
        "socket": bound,
    }


def hand_made(baits: Baits) -> Mapping[str, Maker]:
    """Everything made by hand that a sample file may be: name -> puts it at a path where nothing is, given the bytes of
    the true file."""

    def sealed(change: Change, path: Path, whole: bytes) -> None:
        path.write_bytes(resealed(whole, change))

    def sparse(path: Path, whole: bytes) -> None:
        path.write_bytes(whole)
        os.truncate(path, 2**40)

    def unsealed(path: Path, whole: bytes) -> None:
        path.write_bytes(whole[hdf5.USER_BLOCK :])

    def nothing_sealed(content: bytes, path: Path, whole: bytes) -> None:
        path.write_bytes(sealed_anew(whole[: hdf5.USER_BLOCK] + content))

    def beyond_its_end(path: Path, whole: bytes) -> None:
        # The superblock's end of file (version 2 and 3: 4th address) far behind the bytes that there are.
        changed = bytearray(whole)
        changed[hdf5.USER_BLOCK + 28 : hdf5.USER_BLOCK + 36] = struct.pack("<Q", 2**40)
        path.write_bytes(sealed_anew(bytes(changed)))

    lies = {
        **replacements_of("coefficients", baits),
        **replacements_of("fields/displacement", baits),
        **_sample_lies(baits),
    }
    # A sample may have no fields: one that is missing is no lie.
    del lies["fields/displacement: missing"]
    return {
        **{name: partial(sealed, change) for name, change in lies.items()},
        **{name: partial(_without_content, make) for name, make in no_files(baits).items()},
        "a terabyte of nothing": sparse,
        "no seal": unsealed,
        "seal around nothing": partial(nothing_sealed, b""),
        "seal around text": partial(nothing_sealed, b"no HDF5" * 100),
        "end of file behind its end": beyond_its_end,
    }


def _without_content(make: Callable[[Path], None], path: Path, _: bytes) -> None:
    make(path)


def _bait() -> np.ndarray:
    return np.full(1000, BAIT)


def _bait_file() -> bytes:
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        for name in ("coefficients", "displacement", "plastic_strain", "index"):
            file[name] = _bait()
        file.attrs.update(displacement=BAIT, broke_off=False, depth=BAIT, runout=BAIT, volume=BAIT, area=BAIT)
    return image.getvalue()
