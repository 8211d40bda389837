#!/bin/sh
# Builds the engine for CUDA GPUs, tests it against XLA and float64, times it, and prints one table: at most eight minutes
# on a machine with a GPU, nvcc, CMake and a JAX with CUDA. Nothing is installed: the library is left in the sources.
#
#   benchmarks/speed/on_gpu.sh [folder for the rows and logs [arguments of benchmarks.speed.on_gpu ...]]
set -u
cd "$(dirname "$0")/../.." || exit 1
OUT=${1:-out/on_gpu}
[ $# -eq 0 ] || shift
PYTHON=${PYTHON:-python3}
mkdir -p "$OUT"
export PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}" PYTHONUNBUFFERED=1 TF_CPP_MIN_LOG_LEVEL=3
nvidia-smi --query-gpu=name,driver_version --format=csv,noheader || exit 1

START=$(date +%s)
rm -rf "$OUT/build"
cmake -S . -B "$OUT/build" -DCMAKE_BUILD_TYPE=Release -DPython_EXECUTABLE="$(command -v "$PYTHON")" \
  -DJAXMPM_INSTRUCTIONS=native -DJAXMPM_CUDA=on >"$OUT/build.log" 2>&1 &&
  cmake --build "$OUT/build" --parallel >>"$OUT/build.log" 2>&1 || { tail -40 "$OUT/build.log"; exit 1; }
cp "$OUT"/build/libjaxmpm_*.so jaxmpm/transfer/native/
echo "built in $(($(date +%s) - START)) s"

XLA_FLAGS= timeout 150 "$PYTHON" -m pytest -q -n 0 -p no:cacheprovider tests/jaxmpm/step/test_cuda.py >"$OUT/tests.log" 2>&1
tail -15 "$OUT/tests.log"
if command -v compute-sanitizer >/dev/null; then
  XLA_FLAGS= XLA_PYTHON_CLIENT_PREALLOCATE=false timeout 45 compute-sanitizer "$PYTHON" -m pytest -q -n 0 -p no:cacheprovider \
    tests/jaxmpm/step/test_cuda.py -k "near_soil or cell_sums" >"$OUT/sanitizer.log" 2>&1
  grep "ERROR SUMMARY" "$OUT/sanitizer.log" || echo "compute-sanitizer did not end"
fi

rm -f "$OUT/rows.jsonl"
timeout 240 "$PYTHON" -m benchmarks.speed.on_gpu --out "$OUT/rows.jsonl" "$@" >"$OUT/timing.log" 2>&1 || tail -20 "$OUT/timing.log"
"$PYTHON" -c '
import json, sys
for line in open(sys.argv[1]):
    print("  ".join(f"{k}={v}" for k, v in json.loads(line).items()))
' "$OUT/rows.jsonl"
