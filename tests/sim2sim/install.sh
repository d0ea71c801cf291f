#!/usr/bin/env bash
# Installs MuJoCo, ONNX Runtime and what the comparison needs into tests/sim2sim/.venv.
set -euo pipefail
cd "$(dirname "$0")"
[ -x .venv/bin/python ] || "${PYTHON:-python3}" -m venv .venv
.venv/bin/pip install --quiet --disable-pip-version-check --requirement requirements.txt
