#!/bin/bash
#SBATCH --cpus-per-task=4
#SBATCH --mem-per-cpu=1G
#SBATCH --time=01:00:00
# Trains a table on a Slurm cluster with many times the frames of scenes.toml. Run this script in the folder of the recipes. All nodes
# must see this folder and have l3 on their PATH:
#   ./slurm.sh 16                submit everything: arrays of 16 tasks simulate, then train; each step waits for the one before
#   tail -n 3 slurm/16/log/*     show progress
# Existing outputs are not made again. After a failure, repeat the call. After a change of a recipe, remove slurm/16 first. The table
# has the same bytes as from a single l3 train with all training sets. It has one set of transforms for all illuminants, because
# tasks that each read a part of the frames cannot learn a set for each: the line "lights" of classes.toml is left out. sbatch reads
# options from its SBATCH_ variables. The Makefile makes the camera, from CAMERA and MEASUREMENTS in the environment.
set -euo pipefail

step=${1:?"number of tasks, such as: ./slurm.sh 16"}
tasks=${2:-$step}
[[ $tasks =~ ^[1-9][0-9]*$ ]] || { echo "slurm.sh: $tasks is not a number of tasks" >&2; exit 2; }
folder=slurm/$tasks
shard=$(printf %04d "${SLURM_ARRAY_TASK_ID:-0}")
jobs=${SLURM_CPUS_PER_TASK:-1}
camera=${CAMERA:-camera.h5}
# Each pass reads the table of the previous one: the errors of the first pass set the weights of the second, and every [[layer]] in
# classes.toml is a further pass. If classes.toml says first_draws = 0, there is no first pass; then remove "first" here.
passes=(first second)
layers=$(grep -Ec '^ *\[\[ *layer *\]\]' classes.toml) || true # grep fails if there is none
for ((layer = 2; layer <= layers + 1; layer++)); do passes+=("layer$layer"); done
last_pass=${passes[-1]}

submit() { # STEP OPTIONS…: submit a step that waits for all tasks of the step before
  last=$(sbatch --parsable --job-name="l3-$1" --output="$folder/log/%x-%A-%a.txt" --kill-on-invalid-dep=yes \
    ${last:+--dependency="afterok:${last%%;*}"} "${@:2}" slurm.sh "$1" "$tasks")
  echo "$1: job ${last%%;*}"
}

make_of() { # OUTPUT COMMAND…: run the command unless the output exists
  [[ -e $1 ]] || "${@:2}" -o "$1"
}

learn() { # PASS: compute the partial sums of this task's frames
  local pass before=
  for pass in "${passes[@]}"; do
    [[ $pass != "$1" ]] || break
    before=$folder/$pass.h5
  done
  make_of "$folder/$1_$shard.h5" l3 train "$folder"/training_*.h5 --classes "$folder/classes.toml" \
    --shard "$SLURM_ARRAY_TASK_ID/$tasks" --jobs "$jobs" ${before:+--first "$before"}
}

case $step in
  camera) make inputs JOBS="$jobs" ;;
  # The number of a task is its seed, so that every task draws different scenes.
  simulate)
    make_of "$folder/training_$shard.h5" l3 simulate scenes.toml --camera "$camera" --seed "$SLURM_ARRAY_TASK_ID" \
      --resume --jobs "$jobs"
    ;;
  first | second | layer[0-9]) learn "$step" ;;
  merge-*) make_of "$folder/${step#merge-}.h5" l3 train --merge "$folder/${step#merge-}"_*.h5 ;;
  finish)
    make_of "$folder/table.h5" l3 train --merge "$folder/${last_pass}"_*.h5
    make_of "$folder/picture.png" l3 render "$folder/table.h5" unseen/00000_*_raw.tif
    shown=("$folder/table.h5" unseen.h5)
    [[ $camera == *.h5 ]] && shown+=("$camera")
    make_of "$folder/report.html" l3 report "${shown[@]}"
    l3 evaluate "$folder/table.h5" unseen.h5
    ;;
  "$tasks")
    make -n inputs >/dev/null # fails here, before anything is queued, if make cannot make the inputs
    mkdir -p "$folder/log"
    sed '/^lights = /d' classes.toml >"$folder/classes.toml"
    submit camera
    submit simulate --array="1-$tasks"
    for pass in "${passes[@]}"; do
      submit "$pass" --array="1-$tasks"
      [[ $pass == "$last_pass" ]] || submit "merge-$pass"
    done
    submit finish
    ;;
  *) echo "slurm.sh: no step $step" >&2; exit 2 ;;
esac
