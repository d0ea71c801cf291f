#!/usr/bin/env bash
# Installs the peers into tests/peers/.venv and .venv-reverb and builds what is better built here; tells what failed.
#
# usage: install.sh [--without-torch]      (PyTorch's wheel brings CUDA's libraries: 5 GB on disk)
set -uo pipefail
cd "$(dirname "$0")"
case "${1-}" in
    --without-torch) torch=no ;;
    "") torch=yes ;;
    *) sed -n '2,4s/^# \{0,1\}//p' "$0"; exit 2 ;;
esac
python=${PYTHON:-python3}
failures=()

# One package a line, so that one that does not install takes no other with it.
install() {
    local venv=$1
    shift
    "$venv/bin/pip" install --quiet --disable-pip-version-check "$@" || failures+=("$*")
}

[ -x .venv/bin/python ] || "$python" -m venv .venv || exit 1
install .venv --upgrade pip setuptools wheel
# HPIPM and BLASFEO, as libraries with their headers, come with acados; qpOASES with cmeel.
install .venv numpy scipy
for package in daqp quadprog osqp piqp proxsuite clarabel cmeel-qpoases comma-deps-acados jax mujoco pybullet cpprb; do
    install .venv "$package"
done
if [ "$torch" = yes ]; then
    install .venv torch
    install .venv stable-baselines3
    install .venv torchrl
fi

# Reverb wants an old TensorFlow, which wants an old numpy.
[ -x .venv-reverb/bin/python ] || "$python" -m venv .venv-reverb || exit 1
install .venv-reverb "dm-reverb[tensorflow]"

# Wheels are compiled for any x86-64; herd picks its instructions at run time. So these two are built for this one too.
mkdir -p .native
CFLAGS="-O3 -march=native" .venv/bin/pip install --quiet --disable-pip-version-check --no-deps --upgrade \
    --no-binary daqp,quadprog --target .native daqp quadprog || failures+=("daqp, quadprog from source")

shim() {
    local name=$1
    shift
    g++ -Wall -O3 -march=native -shared -fPIC -std=c++17 native/qp_shim.cpp -o ".native/${name}_shim.so" \
        -Wl,--disable-new-dtags "$@" || failures+=("$name shim")
}
site=$(.venv/bin/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
cmeel=$site/cmeel.prefix acados=$site/acados/install
shim qpoases -DWITH_QPOASES -I"$cmeel/include" -L"$cmeel/lib" -lqpOASES -Wl,-rpath,"$cmeel/lib"
shim hpipm -DWITH_HPIPM -I"$acados/include/hpipm/include" -I"$acados/include/blasfeo/include" \
    -L"$acados/lib" -lhpipm -lblasfeo -Wl,-rpath,"$acados/lib"

for failure in "${failures[@]}"; do
    echo "not installed: $failure" >&2
done
[ ${#failures[@]} -eq 0 ] || echo "the table will say so" >&2
