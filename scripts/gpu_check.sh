#!/usr/bin/env bash
# The first minutes on a GPU that has never been tried: what is there, is it right, how fast is it, does it train.
# Usage: scripts/gpu_check.sh [folder for the results]; about eight minutes at the default sizes.
# On another device or smaller: DEVICE=cpu SIZES="4 8" SECONDS_EACH=0.2 TRAIN_ENVS=8 TRAIN_MINUTES=0.1 scripts/gpu_check.sh
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-gpu_check}
device=${DEVICE:-cuda:0}
sizes=${SIZES:-1024 2048 4096 8192 16384}
mkdir -p "$out"

step() { # name, command...: says what it does, keeps the output, goes on where something fails
    local name=$1 began=$SECONDS
    shift
    echo "== $name: $*"
    if "$@" >"$out/$name.txt" 2>&1; then
        cat "$out/$name.txt"
        echo "== $name: $((SECONDS - began)) s"
    else
        tail -n 20 "$out/$name.txt"
        echo "== $name: FAILED after $((SECONDS - began)) s"
        failed="${failed:-} $name"
    fi
}

step versions python scripts/gpu_check.py versions --device "$device"
if [ -n "${failed:-}" ]; then
    echo "Nothing else can be tried."
    exit 1
fi
step captured python scripts/gpu_check.py captured --device "$device"
step parity python scripts/gpu_check.py parity --device "$device"
# shellcheck disable=SC2086
step benchmark python -m aicpg_newton.benchmark --device "$device" --engines newton --tasks flat uneven --num-envs $sizes \
    --seconds "${SECONDS_EACH:-3}" --iterations "${ITERATIONS:-3}" --json "$out/benchmark.json"
step profile python scripts/gpu_check.py profile --device "$device" --num-envs "${PROFILE_ENVS:-4096}"
step first_iteration python train.py --device "$device" --engine newton --num-envs "${TRAIN_ENVS:-8192}" \
    --max-iterations 1 --run-dir "$out/first_iteration"
step training python train.py --device "$device" --engine newton --num-envs "${TRAIN_ENVS:-8192}" \
    --max-minutes "${TRAIN_MINUTES:-1}" --learning.save-interval 5 --run-dir "$out/training"

if [ -n "${failed:-}" ]; then
    echo "Failed:$failed; their output is in $out"
    exit 1
fi
echo "All done; results in $out"
