"""GeoPackages of a few pages, as tests need them."""

import sqlite3
from contextlib import closing

import shapely

UTM33 = (32633, "EPSG", 32633, "undefined")
"""Number of a coordinate system, who gave it, its number there, and its text."""


def blob(shape, srs=32633):
    """A geometry as a GeoPackage has it, with an empty box."""
    data = shape if isinstance(shape, bytes) else shapely.to_wkb(shape)
    return b"GP\0\1" + srs.to_bytes(4, "little") + data


def write(path, layers, *, srs=UTM33, kinds=None, also=()):
    """Write layers of features (name, geometry); `kinds` are other entries, `also` further statements."""
    path.unlink(missing_ok=True)
    with closing(sqlite3.connect(path)) as database:
        for setting in ("page_size = 512", "synchronous = OFF", "journal_mode = MEMORY"):
            database.execute(f"PRAGMA {setting}")
        for table in (
            "gpkg_contents (table_name, data_type, srs_id)",
            "gpkg_geometry_columns (table_name, column_name, srs_id)",
            "gpkg_spatial_ref_sys (srs_id, organization, organization_coordsys_id, definition)",
        ):
            database.execute(f"CREATE TABLE {table}")
        database.execute("INSERT INTO gpkg_spatial_ref_sys VALUES (?, ?, ?, ?)", srs)
        for layer, features in layers.items():
            database.execute(f'CREATE TABLE "{layer}" (fid INTEGER PRIMARY KEY, geom, name)')
            database.execute("INSERT INTO gpkg_geometry_columns VALUES (?, 'geom', ?)", (layer, srs[0]))
            for name, shape in features:
                value = None if shape is None else shape if isinstance(shape, bytes) else blob(shape)
                database.execute(f'INSERT INTO "{layer}" (geom, name) VALUES (?, ?)', (value, name))
        for entry, kind in {**dict.fromkeys(layers, "features"), **(kinds or {})}.items():
            database.execute("INSERT INTO gpkg_contents VALUES (?, ?, ?)", (entry, kind, srs[0]))
        for statement in also:
            database.execute(statement)
        database.commit()
    return path
