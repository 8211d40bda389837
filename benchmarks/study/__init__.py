"""The published study, run and held against its tables and figures."""
