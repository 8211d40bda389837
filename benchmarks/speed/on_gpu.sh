#!/bin/sh
# Builds the engine for CUDA GPUs, checks it, times it, and prints one table, in at most eight minutes on a machine with
# a GPU. Nothing is installed: the library is left in the sources, the build in build/on_gpu.
#
#   [PYTHON=python3] benchmarks/speed/on_gpu.sh [--small] [folder for table.txt, rows.jsonl and logs]
#
# It needs nvcc, CMake, a C++ compiler, compute-sanitizer if there is one, and in Python a JAX with CUDA, the dependencies
# of pyproject.toml, pytest and hypothesis. Checks run side by side, timings alone, what matters most first; each part has
# a limit of seconds. --small tries all of it on a CPU, on small scenes without the limits.
#
# Exit code: 1 if something failed (a test, the sanitizer, a bound, a part), else 2 if a part was stopped at its limit.
set -u
END=$(($(date +%s) + 470)) SMALL=
if [ "${1:-}" = --small ]; then SMALL=--small; shift; END=$((END + 3600)); fi
PYTHON=$("${PYTHON:-python3}" -c 'import sys; print(sys.executable)') || exit 1
cd "$(dirname "$0")/../.." || exit 1
mkdir -p "${1:-out/on_gpu}" && OUT=$(cd "${1:-out/on_gpu}" && pwd) || exit 1
rm -f "$OUT"/*.log "$OUT/rows.jsonl" "$OUT/table.txt"
export PATH="$PATH:${CUDA_HOME:-/usr/local/cuda}/bin" PYTHONPATH="$PWD${PYTHONPATH:+:$PYTHONPATH}" PYTHONUNBUFFERED=1 TF_CPP_MIN_LOG_LEVEL=3 XLA_FLAGS=
CARD=$(nvidia-smi --query-gpu=name,driver_version --format=csv,noheader 2>&1) || [ -n "$SMALL" ] || { echo "$CARD"; exit 1; }
"$PYTHON" - <<'CHECK' || exit 1
import importlib.metadata, re, sys, tomllib
names = [re.match(r"[\w-]+", each)[0] for each in tomllib.load(open("pyproject.toml", "rb"))["project"]["dependencies"]]
found = {each.name.lower().replace("_", "-") for each in importlib.metadata.distributions()}
lacking = [each for each in (*names, "pytest", "hypothesis") if each.lower().replace("_", "-") not in found]
sys.exit(f"install {' '.join(lacking)} for {sys.executable}" if lacking else 0)
CHECK

# part NAME LIMIT LOG COMMAND ...: run it within its limit and what is left, and add a row that tells how it ended.
part() {
  name=$1 limit=$2 log=$OUT/$3.log begun=$(date +%s) result=pass
  shift 3
  left=$((END - begun))
  [ -z "$SMALL" ] || limit=$left
  [ "$limit" -le "$left" ] || limit=$left
  if [ "$limit" -gt 0 ]; then timeout -k 5 "$limit" "$@" >>"$log" 2>&1; else false; fi
  case $? in 0) ;; 124 | 137) result=stopped ;; *) [ "$limit" -gt 0 ] && result=fail || result=stopped ;; esac
  printf '{"what": "part: %s", "unit": "s", "ours": %d, "result": "%s"}\n' "$name" $(($(date +%s) - begun)) "$result" |
    tee -a "$OUT/rows.jsonl"
  [ "$result" = pass ] || { [ ! -f "$log" ] || tail -n 5 "$log"; false; }
}
rows() { part "$1" "$2" "$3" "$PYTHON" -m benchmarks.speed.on_gpu "$1" "$OUT/rows.jsonl" $SMALL; }
sanitize() {
  if command -v compute-sanitizer >/dev/null; then
    part "compute-sanitizer, $1" 100 sanitizer env XLA_PYTHON_CLIENT_ALLOCATOR=platform compute-sanitizer --tool "$@" \
      --error-exitcode 9 "$PYTHON" -m benchmarks.speed.on_gpu_calls
  else
    part "the sanitizer's calls without it, no $1" 100 sanitizer "$PYTHON" -m benchmarks.speed.on_gpu_calls
  fi
}

CUDA=on
[ -z "$SMALL" ] || CUDA=off
part configure 30 build cmake -S . -B build/on_gpu -DCMAKE_BUILD_TYPE=Release "-DPython_EXECUTABLE=$PYTHON" \
  -DJAXMPM_INSTRUCTIONS=native -DJAXMPM_CUDA=$CUDA &&
  part build 170 build cmake --build build/on_gpu --parallel || { tail -40 "$OUT/build.log"; exit 1; }
install build/on_gpu/libjaxmpm_*.so jaxmpm/transfer/native/ # not cp, which would write into a library that runs

export XLA_PYTHON_CLIENT_PREALLOCATE=false # several processes use the card
rows accuracy 110 checks &
rows repeats 110 checks &
rows memory 110 checks &
part doctor 110 doctor "$PYTHON" -m cooperative doctor &
# Each primitive, shape function, dimension and dtype once, lanes, nodes near soil, and positions beyond the grid.
part tests 110 tests "$PYTHON" -m pytest -vv --tb=short -p no:cacheprovider -m "slow or not slow" tests/jaxmpm/step/test_cuda.py \
  -k "(agrees_with_xla or cell_sums or repeat_bit or few_lanes or near_soil or beyond or once or refuse) and not any_column" &
# XLA calls functions of the driver that answer with an error which it expects; the kernels tell of theirs themselves.
sanitize memcheck --padding 32 --report-api-errors no &
sanitize racecheck --kernel-regex kns=jaxmpm &
wait
unset XLA_PYTHON_CLIENT_PREALLOCATE

rows gradients 70 timings
rows steps 120 timings
rows transfers 60 timings
rows campaign 60 timings
export XLA_FLAGS="--xla_gpu_enable_command_buffer=+WHILE,+CONDITIONAL --xla_gpu_graph_min_graph_size=1"
rows graphs 40 timings

grep -hE "PASSED|FAILED|ERROR" "$OUT/tests.log"
{ echo "$CARD"; cat "$OUT/doctor.log"; "$PYTHON" -m benchmarks.speed.on_gpu_rows "$OUT/rows.jsonl"; } >"$OUT/table.txt"
CODE=$?
cat "$OUT/table.txt"
exit $CODE
