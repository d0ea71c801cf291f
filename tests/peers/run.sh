#!/usr/bin/env bash
# Installs the peers, runs every comparison and writes one table; options are those of run.py (see --help).
#
# usage: run.sh [--no-install] [options of run.py]
set -euo pipefail
here=$(dirname "$0")
if [ "${1-}" = --no-install ]; then
    shift
elif [[ " $* " != *" --help "* && " $* " != *" -h "* ]]; then
    "$here/install.sh"
fi
python=$here/.venv/bin/python
[ -x "$python" ] || python=python3
exec "$python" "$here/run.py" "$@"
