#!/usr/bin/env bash
# Installs one built file (a wheel or an sdist) into a clean environment, and from an empty folder outside the checkout runs
# the doctor and a small campaign to its report: `packaging/smoke.sh dist/FILE [PYTHON]`.
set -euo pipefail
built=$(realpath "$1")
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
"${2:-python3}" -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet "$built"
cd "$place"
PATH="$place/venv/bin:$PATH"
jaxmpm --version
jaxmpm doctor
jaxmpm example demo
# Cells of twice the size and ten samples instead of forty: seconds, not minutes.
sed -e 's/cell = 2.0/cell = 4.0/; s/cell = 1.0/cell = 2.0/; s/\[1.0, 1.0\]/[2.0, 2.0]/; s/\[0.5, 0.5\]/[1.0, 1.0]/' \
    -e 's/samples = 40/samples = 10\nrefined_runs = 10/; s/t_end = 20.0/t_end = 4.0/' demo.toml > small.toml
jaxmpm run small.toml --out out/small
test -s out/small/report.html
jaxmpm report out/small > summary.txt
grep -q "failure" summary.txt
echo "$(basename "$built"): installed, sound, and a campaign reported"
