"""Files that nobody should trust: damaged by chance, and made by hand to be read for what they are not.

`damaged` gives flipped, cut and overwritten copies of a file. `hand_made` makes a campaign's folder lie: a database
with other tables or rows whose checksums are right and whose values are not, journals that name other files, files of
fields that refer elsewhere, links, folders, pipes. Each has to be noticed, hang nothing, and lead nowhere: baits lie
outside the campaign's folder, and nothing may read or change them.
"""

from __future__ import annotations

import hashlib
import io
import os
import re
import socket
import sqlite3
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import h5py
import numpy as np

from cooperative.store import DATABASE, fields_path, read_store
from cooperative.store._database import OF_SUPER_JOURNAL, checksum, columns_of
from jaxmpm.support import hdf5

BAIT = 31337.0
"""The number that the baits are full of: where it turns up, something outside was read."""

Change = Callable[[h5py.File], None]
Maker = Callable[[Path], None]
"""Has the folder of a campaign lie."""


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


def lie(folder: Path, **values: object) -> None:
    """Change the row of rough run 1, whose checksum is right again: what anyone can do who knows the format."""
    digest = read_store(folder).digest
    with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as database:
        columns = columns_of(database)
        changed = ", ".join(f'"{name}" = ?' for name in values)
        database.execute(
            f"UPDATE run SET {changed}, sha256 = '' WHERE grid = 'rough' AND sample = 1", tuple(values.values())
        )
        row = database.execute("SELECT * FROM run WHERE sha256 = ''").fetchone()
        right = checksum(digest, dict(zip(columns, row, strict=True)))
        database.execute("UPDATE run SET sha256 = ? WHERE sha256 = ''", (right,))


def by_sql(*statements: str) -> Maker:
    """Has SQLite change the database of a campaign."""

    def change(folder: Path) -> None:
        with closing(sqlite3.connect(folder / DATABASE, isolation_level=None)) as database:
            for statement in statements:
                database.execute(statement)

    return change


def _rows_that_lie() -> dict[str, Maker]:
    values: dict[str, dict[str, object]] = {
        "text for a number": {"displacement": "far"},
        "infinite": {"displacement": np.inf},
        "negative": {"displacement": -1.0},
        "without displacement": {"displacement": None},
        "without broke_off": {"broke_off": None},
        "text for a flag": {"broke_off": "no"},
        "text for a measure": {"runout": "long"},
        "number for a text": {"mode": b"deep"},
        "lines in a text": {"mode": "deep\nprobability of failure 0"},
        "escape sequence in a text": {"mode": "\x1b]0;title\x07deep"},
        "lines in a status": {"status": "FINISHED\nP_f = 0"},
        "blob for a status": {"status": b"\xff"},
        "text for steps": {"steps": "many"},
        "text for seconds": {"seconds": "long"},
        "number for coefficients": {"coefficients": 1.5},
        "half a coefficient": {"coefficients": b"1234567"},
        "no coefficients": {"coefficients": None},
        "versions that are no JSON": {"versions": "jaxmpm 1"},
        "versions nested without end": {"versions": "[" * 60_000},
        "versions that are a list": {"versions": '["jaxmpm"]'},
        "of no grid": {"grid": "finest"},
        "fields of another": {"fields_sha256": "0" * 64},
        "fields elsewhere": {"fields_sha256": "/../../../outside/bait"},
        "fields by a number": {"fields_sha256": 7},
    }

    def row(changes: dict[str, object]) -> Maker:
        return lambda folder: lie(folder, **changes)  # type: ignore[arg-type]

    return {f"row: {name}": row(changes) for name, changes in values.items()} | {
        "row: changed": by_sql("UPDATE run SET displacement = 1e-3 WHERE sample = 1"),
        "row: of another sample": by_sql(
            "DELETE FROM run WHERE sample = 1", "UPDATE run SET sample = 1 WHERE sample = 2"
        ),
    }


SCHEMAS = {
    "view": ["CREATE VIEW more AS SELECT * FROM run"],
    "view for a table": ["ALTER TABLE run RENAME TO runs", "CREATE VIEW run AS SELECT * FROM runs"],
    "trigger": ["CREATE TRIGGER more AFTER DELETE ON run BEGIN DELETE FROM campaign; END"],
    "index": ["CREATE INDEX more ON run (displacement)"],
    "third table": ["CREATE TABLE more (name TEXT)"],
    "virtual table": ["CREATE VIRTUAL TABLE more USING rtree (a, b, c)"],
    "generated column": ["ALTER TABLE run ADD COLUMN more REAL AS (abs(displacement))"],
    "default": ["ALTER TABLE run ADD COLUMN more REAL DEFAULT 1.0"],
    "check": ["ALTER TABLE run ADD COLUMN more REAL CHECK (abs(more) < 1)"],
    "column of no type": ["ALTER TABLE run ADD COLUMN more"],
    "name that a terminal obeys": ['ALTER TABLE run ADD COLUMN "\x1b[2J" REAL'],
    "column less": ["ALTER TABLE run DROP COLUMN runout"],
    "no runs": ["DROP TABLE run"],
    "no scene": ["DELETE FROM campaign"],
    "another scene": ["UPDATE campaign SET value = replace(value, '0.3', '0.4')"],
    "another program": ["PRAGMA application_id = 7"],
    "another version": ["PRAGMA user_version = 7"],
    "write-ahead log": ["PRAGMA journal_mode = wal"],
}
"""What a database of a campaign never has."""


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
    """Everything made by hand that a campaign's folder may hold: name -> makes it of a folder whose rough run 1 has
    fields."""

    def database(make: Callable[[Path], None], folder: Path) -> None:
        (folder / DATABASE).unlink()
        make(folder / DATABASE)

    def journal(make: Callable[[Path], None], folder: Path) -> None:
        make(folder / f"{DATABASE}-journal")

    def super_journal(path: Path) -> None:
        name = str(baits.numbers).encode()
        head = bytes.fromhex("d9d505f920a163d7") + bytes(504)
        ending = len(name).to_bytes(4) + sum(name).to_bytes(4) + OF_SUPER_JOURNAL
        path.write_bytes(head + bytes(4) + name + ending)

    def fields(make: Callable[[Path], None], folder: Path) -> None:
        (path,) = (folder / "fields").glob("rough-000001-*.h5")
        path.unlink()
        make(path)

    def elsewhere(folder: Path) -> None:
        (folder / "fields").rename(folder.parent / "moved")
        (folder / "fields").symlink_to(folder.parent / "moved")

    def contents(change: Change, folder: Path) -> None:
        (path,) = (folder / "fields").glob("rough-000001-*.h5")
        image = io.BytesIO(path.read_bytes())
        with h5py.File(image, "r+") as file:
            change(file)
        other(image.getvalue(), folder)

    def other(content: bytes, folder: Path) -> None:
        sha256 = hashlib.sha256(content).hexdigest()
        fields_path(folder, "rough", 1, sha256).write_bytes(content)
        lie(folder, fields_sha256=sha256)

    def many_names(file: h5py.File) -> None:
        file["shared"] = np.zeros(10_000)
        for number in range(2_000):
            file[f"shared_{number}"] = file["shared"]

    changes = replacements_of("displacement", baits)
    del changes["displacement: missing"]  # a run may have no such field
    changes |= {"many names of one array": many_names}
    changes |= {"escape sequence in a name": lambda file: file.__setitem__("\x1b[31mred", np.zeros(3))}
    parts: dict[str, tuple[Callable[[Callable[[Path], None], Path], None], Mapping[str, Callable[[Path], None]]]] = {
        "database": (database, no_files(baits) | _no_databases()),
        "journal": (journal, no_files(baits) | {"that names another": super_journal}),
        "fields": (fields, no_files(baits) | {"a terabyte of nothing": _sparse}),
    }
    return {
        **_rows_that_lie(),
        **{f"schema: {name}": by_sql(*statements) for name, statements in SCHEMAS.items()},
        **{
            f"{part}: {name}": partial(put, make)
            for part, (put, makes) in parts.items()
            for name, make in makes.items()
        },
        **{f"fields: {name}": partial(contents, change) for name, change in changes.items()},
        "fields: no HDF5": partial(other, b"no HDF5" * 100),
        "fields: nothing": partial(other, b""),
        "fields: folder elsewhere": elsewhere,
    }


def _no_databases() -> dict[str, Callable[[Path], None]]:
    def holding(content: bytes, path: Path) -> None:
        path.write_bytes(content)

    return {
        "nothing": lambda path: path.touch(),
        "text": partial(holding, b"no SQLite " * 100),
        "header alone": partial(holding, b"SQLite format 3\0" + bytes(84)),
        "a terabyte of nothing": _sparse,
    }


def _sparse(path: Path) -> None:
    path.touch()
    os.truncate(path, 2**40)


def _bait() -> np.ndarray:
    return np.full(1000, BAIT)


def _bait_file() -> bytes:
    image = io.BytesIO()
    with h5py.File(image, "w") as file:
        for name in ("coefficients", "displacement", "plastic_strain", "index"):
            file[name] = _bait()
        file.attrs.update(displacement=BAIT, broke_off=False, depth=BAIT, runout=BAIT, volume=BAIT, area=BAIT)
    return image.getvalue()
