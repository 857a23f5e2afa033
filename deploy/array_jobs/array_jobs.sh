#!/bin/sh
# A study by Slurm array jobs, or by processes where there is no Slurm.
#
#     array_jobs.sh FOLDER [TASKS]
#
# Every round asks the study, simulates the answer in TASKS parts, and ends when nothing is asked.
# The folder must be on a disk that all nodes share. What a killed task has not told is asked again,
# also by another call of this script after a kill of its own. Adapt study.py beside it.
set -eu
folder=$1 tasks=${2:-8}
python=${PYTHON:-python3}
study=$(cd "$(dirname "$0")" && pwd)/study.py

told() { wc -c 2> /dev/null < "$folder/results.csv" || echo 0; }
while pending=$("$python" "$study" ask "$folder") && [ "$pending" -gt 0 ]; do
    echo "$pending simulations"
    before=$(told)
    if command -v sbatch > /dev/null; then
        sbatch --quiet --wait --array="1-$tasks" --output="$folder/task-%a.log" \
            --wrap "exec '$python' '$study' simulate '$folder' \$SLURM_ARRAY_TASK_ID $tasks" \
            || echo "tasks failed; what is missing is asked again"
    else
        for task in $(seq "$tasks"); do
            "$python" "$study" simulate "$folder" "$task" "$tasks" > "$folder/task-$task.log" 2>&1 &
        done
        wait
    fi
    [ "$(told)" -gt "$before" ] || { echo "no task told anything: see $folder/task-*.log" >&2; exit 1; }
done
"$python" "$study" design "$folder"
