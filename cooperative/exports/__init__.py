"""What a campaign is to other programs: tables, netCDF, GeoTIFF, GeoPackage, VTKHDF."""

from cooperative.exports._export import export, export_sample
from cooperative.exports._tables import write_table

__all__ = ["export", "export_sample", "write_table"]
