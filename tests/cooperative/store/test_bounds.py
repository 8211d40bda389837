"""Scenes and what stands beside them have a limit of size and depth, which their messages name."""

import json
import os

import pytest

from cooperative.laboratory import read_rows
from cooperative.scene import parse
from cooperative.store import Source
from cooperative.store._source import MOST_ENTRIES, check_bounds, source_from
from cooperative.tools.soundings import read_files
from jaxmpm import read_line, read_motion, read_raster
from tests.cooperative.campaign.test_campaign import TINY

BOMBS = {
    "long key": f"[{'k' * 400_000}]\na = [{'1,' * 200_000}]",
    "deep lists": f"[x]\na = {'[' * 300}{']' * 300}",
    "deep tables": f"[{'.'.join('abc' * 30)}]\na = 1",
}


@pytest.mark.parametrize("bomb", BOMBS.values(), ids=BOMBS.keys())
def test_a_scene_that_would_take_gigabytes_is_refused(bomb):
    with pytest.raises(ValueError, match=r"whose keys together have more than|deep, the limit is 64: write it flat"):
        parse(f"{TINY}\n{bomb}\n")
    assert Source(TINY).digest


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (f'{{"files": {{"{"k" * 2000}": [{"[1]," * 30_000}1]}}}}', "keys together have more than"),
        (f'{{"a": [{"1," * MOST_ENTRIES}1]}}', f"it has more than {MOST_ENTRIES} values"),
        ('{"a": ' + "[" * 90 + "]" * 90 + "}", "deep, the limit is 64"),
    ],
)  # fmt: skip
def test_tables_beside_a_scene_that_would_take_gigabytes_are_refused(content, reason):
    with pytest.raises(ValueError, match=rf"there is damaged \(.*{reason}"):
        source_from(TINY, content, "there")


def test_bounds_count_every_list_and_let_large_tables_of_measurements_be():
    rows = [[1.0, 2.0, 3.0, None]] * 20_000
    check_bounds("it", {"files": {"boreholes of the site.csv": rows}})
    json.dumps(rows)


@pytest.mark.parametrize(
    ("name", "read"),
    [
        ("a.csv", read_line),
        ("a.dxf", read_line),
        ("a.csv", read_motion),
        ("a.asc", read_raster),
        ("a.tif", read_raster),
        ("a.csv", read_rows),
        *((f"a.{end}", lambda path: read_files([path])) for end in ("gef", "xml", "ags", "csv")),
    ],
)
def test_a_file_of_thirty_gigabytes_is_refused_by_its_size(name, read, tmp_path):
    path = tmp_path / name
    path.touch()
    os.truncate(path, 30 * 10**9)
    with pytest.raises(ValueError, match=r"has 30000000000 bytes"):
        read(path)


ENTITIES = '<!DOCTYPE a [<!ENTITY b "{}">{}]>\n<a>&b9;</a>'
LAUGHS = ENTITIES.format("ha" * 9, "".join(f'<!ENTITY b{k} "{f"&b{k - 1};" * 9}">' for k in range(1, 10)))


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "latin-1"])
@pytest.mark.parametrize(
    "text",
    [LAUGHS, '<!DOCTYPE a SYSTEM "http://[::1]:9/a"><a/>', '<!DOCTYPE a [<!ENTITY b SYSTEM "a.xml">]><a>&b;</a>'],
)  # fmt: skip
def test_xml_with_entities_is_refused_before_it_is_expanded(text, encoding, tmp_path):
    path = tmp_path / "cpt.xml"
    path.write_bytes(f'<?xml version="1.0" encoding="{encoding}"?>\n{text}'.encode(encoding))
    with pytest.raises(ValueError, match=r"cpt.xml declares a document type or entities"):
        read_files([path])
