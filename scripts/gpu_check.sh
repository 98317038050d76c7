#!/usr/bin/env bash
# The first minutes on a GPU that has never been tried: what is there, is it right, how fast is it, does it train.
# Usage: scripts/gpu_check.sh [folder for the results]; three to five minutes at the default sizes.
# What is not timed runs side by side, as it waits for compilers most of the time; what is timed runs alone.
# On another device or smaller: DEVICE=cpu SIZES="4 8" SECONDS_EACH=0.2 COMPILED_ENVS=8 scripts/gpu_check.sh
set -uo pipefail
cd "$(dirname "$0")/.."
out=${1:-gpu_check}
device=${DEVICE:-cuda:0}
sizes=${SIZES:-2048 4096 8192 16384}
compiled=${COMPILED_ENVS:-4096}
limit=${LIMIT:-150}
rates=(python -m aicpg_newton.benchmark --device "$device" --engines newton --seconds "${SECONDS_EACH:-1}"
    --iterations "${ITERATIONS:-2}")
mkdir -p "$out"

step() { # name, command...: keeps the output and how it went
    local name=$1 began=$SECONDS status
    shift
    timeout "$limit" "$@" >"$out/$name.txt" 2>&1
    status=$?
    echo "== $name: exit status $status after $((SECONDS - began)) s: $*" >>"$out/$name.txt"
    if [ "$status" -ne 0 ]; then touch "$out/$name.failed"; fi
}

show() { # name...: what the steps said, their last lines where that is much
    for name in "$@"; do
        grep -v "^Module\|^Warp CUDA" "$out/$name.txt" | tail -n "${LINES_EACH:-16}" | cut -c 1-400
    done
}

rm -f "$out"/*.failed
step versions python scripts/gpu_check.py versions --device "$device"
show versions
if [ -e "$out/versions.failed" ]; then
    echo "Nothing else can be tried."
    exit 1
fi
step captured python scripts/gpu_check.py captured --device "$device" &
step parity python scripts/gpu_check.py parity --device "$device" &
for task in flat robust; do
    step "training_$task" python train.py --task "$task" --device "$device" --engine newton --num-envs "$compiled" \
        --max-iterations 3 --no-demonstrate --run-dir "$out/run_$task" &
done
wait
show captured parity training_flat training_robust
# shellcheck disable=SC2086
step plain "${rates[@]}" --tasks flat uneven --num-envs $sizes --compile off --json "$out/plain.json"
show plain
step compiled "${rates[@]}" --tasks flat --num-envs "$compiled" --compile on --json "$out/compiled.json"
show compiled
step profile python scripts/gpu_check.py profile --device "$device" --num-envs "$compiled"
LINES_EACH=34 show profile

if compgen -G "$out/*.failed" >/dev/null; then
    echo "Failed: $(cd "$out" && echo *.failed); see $out"
    exit 1
fi
echo "All done; results in $out"
