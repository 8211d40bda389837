"""Error against run time, throughput and stability: `python -m benchmarks NAME --json`."""
