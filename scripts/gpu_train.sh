#!/usr/bin/env bash
# Trainings side by side on one GPU for a given time, and beside them others on the CPU cores that are left.
# Usage: scripts/gpu_train.sh OUT SECONDS [first core for the CPU] < list
# where each line of the list is: NAME gpu|cpu OPTIONS OF train.py
# OUT gets, of each training, its newest checkpoint, its configuration, the end of its log and TensorBoard's file:
# cat OUT/trainings.tar.gz.part-* | tar xz
set -uo pipefail
cd "$(dirname "$0")/.."
out=${1:?give a folder for the results} seconds=${2:?give a time in seconds}
core=${3:-4}
runs=${RUNS:-$(mktemp -d)} # a folder that is there is kept: train.py goes into no other run's
mkdir -p "$out" "$runs"
out=$(realpath "$out")

while read -r name place options; do
    [ -n "$name" ] || continue
    mine=() device=(--device "${DEVICE:-cuda:0}" --engine newton)
    if [ "$place" = cpu ]; then
        mine=(env OMP_NUM_THREADS=1 taskset -c "$core")
        device=(--device cpu --engine mujoco)
        core=$((core + 1))
    fi
    # SIGTERM makes a training save itself; a minute later nothing can be helped any more.
    # shellcheck disable=SC2086
    "${mine[@]}" timeout -k 60 "$seconds" python train.py "${device[@]}" --no-demonstrate --run-dir "$runs/$name" $options \
        >"$runs/$name.log" 2>&1 &
done
wait

cd "$runs"
kept=()
for log in *.log; do
    name=${log%.log}
    newest=$(ls -t "$name"/model_*.pt 2>/dev/null | head -n 1)
    echo "== $name: ${newest:-no checkpoint}"
    grep -E "rror|Mean (reward|episode)|Computation|Total steps|Stopped|Iteration time" "$log" | tail -n 6 | cut -c 1-200
    tail -n 200 "$log" >"$name.tail" && mv "$name.tail" "$log"
    kept+=("$log")
    for each in $newest "$name"/config.yaml "$name"/events.*; do [ -e "$each" ] && kept+=("$each"); done
done
# In parts: what takes them home may have a limit for a file.
tar -cz "${kept[@]}" | split -b 15M -d - "$out/trainings.tar.gz.part-"
ls -l "$out"
