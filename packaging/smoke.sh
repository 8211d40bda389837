#!/usr/bin/env bash
# Installs one built file (a wheel or an sdist) into a clean environment, and from an empty folder outside the checkout runs
# the doctor and a small campaign to its report: `packaging/smoke.sh dist/FILE [PYTHON]`. With WITHOUT_COMPILER=1 no C++
# compiler is on the path.
set -euo pipefail
built=$(realpath "$1")
place=$(mktemp -d)
trap 'rm -rf "$place"' EXIT
python=$("${2:-python3}" -c 'import sys; print(sys.executable)')
if [ -n "${WITHOUT_COMPILER-}" ]; then
    mkdir "$place/bin"
    for tool in /usr/bin/* /bin/*; do
        case ${tool##*/} in
            *c++* | *g++* | *gcc* | *clang* | cc | c89* | c99*) ;;
            *) ln -sf "$tool" "$place/bin/" ;;
        esac
    done
    PATH="$place/bin"
fi
"$python" -m venv "$place/venv"
"$place/venv/bin/pip" install --quiet "$built"
cd "$place"
PATH="$place/venv/bin:$PATH"
jaxmpm --version
jaxmpm doctor | tee doctor.txt
test -z "${WITHOUT_COMPILER-}" || grep -q "C++ compiler: *none on the path" doctor.txt
jaxmpm example demo
test -s scene.schema.json
# Cells of twice the size and ten samples instead of forty: seconds, not minutes.
sed -e 's/cell = 2.0/cell = 4.0/; s/cell = 1.0/cell = 2.0/; s/\[1.0, 1.0\]/[2.0, 2.0]/; s/\[0.5, 0.5\]/[1.0, 1.0]/' \
    -e 's/samples = 40/samples = 10\nrefined_runs = 10/; s/t_end = 20.0/t_end = 4.0/' demo.toml > small.toml
jaxmpm run small.toml --out out/small 2> run.txt || { cat run.txt; exit 1; }
cat run.txt
# Where the transfers were not compiled that is said, and only once.
slow=$(grep -c "transfers on CPU: *on XLA" doctor.txt || true)
test "$(grep -c "was not built" run.txt || true)" = "$slow"
test -s out/small/report.html
jaxmpm report out/small > summary.txt
grep -q "failure" summary.txt
grep -q "jaxmpm resume" out/small/README.txt
echo "$(basename "$built"): installed, sound, and a campaign reported"
